"""Floors of arrows: a magnitude far below the largest so far is rounding noise and has no arrow."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rerun import ComponentColumn

from carom.arrays import FloatArray
from carom.recording.schema.header import Header
from carom.recording.schema.paths import FLOOR
from carom.recording.write.rows import any_column

_ROUNDING = 1e-9  # of the largest magnitude in the recorded frames so far


class ArrowFloors:
    """The magnitudes below which arrows of a recording are not drawn, by the entity of the arrows.

    The largest magnitude of a run is known only at its end, so floors rise with the largest so far. Each frame contains
    its floors. A replay or a resumed run that begins at a later frame thus has the floors of the whole run.

    Parameters
    ----------
    header
        Header of the recording; with version 1 of the rules of drawing, all arrows are drawn.
    before
        The floors before the first frame.
    """

    def __init__(self, header: Header, before: Mapping[str, float]) -> None:
        self._applies = header.drawing_rules > 1
        self._last = dict(before)

    def raised(self, path: str, largest: FloatArray) -> FloatArray:
        """Return the floors (frames,) after the largest magnitudes (frames,) of the next frames."""
        found = self.alone(largest)
        found[:1] = np.maximum(found[:1], self._last.get(path, 0.0))
        found = np.maximum.accumulate(found)
        self._last[path] = float(found[-1])
        return found

    def alone(self, largest: FloatArray) -> FloatArray:
        """Return the floors of frames that do not depend on earlier ones."""
        return _ROUNDING * largest if self._applies else np.zeros(len(largest))

    def columns(self, floors: FloatArray) -> list[ComponentColumn]:
        """Return the column of a batch's floors, if the recording has them."""
        return [any_column(FLOOR, floors)] if self._applies else []
