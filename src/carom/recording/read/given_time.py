"""Times that a caller asks for."""

from __future__ import annotations

import math
from numbers import Real

from carom.errors import RecordingError


def check_times(**times: object) -> None:
    """Raise a RecordingError if a time, by the name of its argument, is neither a number nor None."""
    for name, time in times.items():
        is_time = isinstance(time, Real) and not isinstance(time, bool) and not math.isnan(time)
        if time is not None and not is_time:
            raise RecordingError(f"{name} = {time!r}: a time is a number, in seconds")
