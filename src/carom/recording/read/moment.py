"""The default time to look at: the hardest impact of a run or, without any, the most contacts.

Of a run that was killed, neither is known: then the frame before which contacts took out most energy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.recording.errors import RecordingError
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording

_RELATIVE_TOLERANCE = 1e-8  # `carom inspect` prints nine digits of a time, which people type again


def moment(recording: Recording, at: float | None) -> float:
    """Return the simulated time (s) to look at; see `Recording.moment`."""
    recording.require_frames()
    times = _column(recording.fingerprints(), "time")
    if at is not None:
        between = np.inf if len(times) == 1 else (times[-1] - times[0]) / (len(times) - 1)  # a step may have no frame
        if not times[0] - between <= at <= times[-1] + between:
            raise RecordingError(
                f"{recording.path} goes from {recording.units.span(times[0], times[-1], TIME, '.9g')}, "
                f"{recording.units.text(at, TIME, '.9g')} is not in it"
            )
        return at
    if not recording.shows_all:
        return _moment_of_shown(recording, float(times[-1]))
    for name in ("impact", "contacts"):
        known = float(recording.closing.get(f"moments.{name}.time", np.nan))
        if times[0] <= known <= times[-1]:
            return known
    energy = recording.energy()
    if "restitution" in energy.column_names:
        taken = _column(energy, "restitution")
        taken = taken + (_column(energy, "friction") if "friction" in energy.column_names else 0.0)
        lost = np.diff(taken, prepend=taken[:1])
        if lost.max() > 0:
            return float(_column(energy, "time")[np.argmax(lost)])
    steps = recording.steps()
    if "contacts" in steps.column_names and _column(steps, "contacts").max() > 0:
        return float(_column(steps, "time")[np.argmax(_column(steps, "contacts"))])
    return float(times[-1])


def _moment_of_shown(recording: Recording, last: float) -> float:
    """Return the moment of a clip of some bodies: their impact of the largest impulse on record, or the last frame."""
    if not recording.records_contacts:
        return last
    found = recording.impacts()
    return float(found["time"][int(np.argmax(found["normal_impulse"].to_numpy()))].as_py()) if len(found) else last


def tolerance(time: float) -> float:
    """Return the error in s of a time that was printed and typed again."""
    return 0.0 if np.isinf(time) else _RELATIVE_TOLERANCE * abs(time)


def frame_of(recording: Recording, at: float) -> int | None:
    """Return the row of the frame at the end of the step that contains a time (s); None if that step has no frame.

    Times after the last frame belong to it, and times before the first one to that.
    """
    steps = recording.steps("dt")
    times, goal = _column(steps, "time"), at - tolerance(at)
    exact = int(np.searchsorted(times, at))
    if exact < len(times) and times[exact] == at:  # after 10⁸ steps the tolerance is longer than one
        return exact
    row = min(int(np.searchsorted(times, goal)), len(times) - 1)
    began = times[row] - _column(steps, "dt")[row]
    return row if row == 0 or goal > times[-1] or goal > began else None


def _column(table: pa.Table, name: str) -> NDArray[np.float64]:
    return np.asarray(table[name].to_numpy(), dtype=np.float64)
