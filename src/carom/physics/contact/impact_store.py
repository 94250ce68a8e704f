"""The impacts of a run between two frames, in bounded memory."""

from __future__ import annotations

import numpy as np

from carom.arrays import Records
from carom.contact_table import CONTACT_ROW, NO_ROWS
from carom.physics.aligned import joined, picked

MOST_IMPACTS = 100_000  # kept between two frames, 15 MB; beyond that the largest are kept and the others counted


class ImpactStore:
    """The impacts since the last frame, in bounded memory."""

    def __init__(self) -> None:
        self.left_out = 0
        self._count = 0
        self._parts: list[Records] = []

    def add(self, rows: Records) -> None:
        """Add impacts, all of them later than those before."""
        self._parts.append(rows)
        self._count += len(rows)
        if self._count > 2 * MOST_IMPACTS:
            self._leave_out()

    def rows(self) -> Records:
        """Return the impacts in order of time, at most `MOST_IMPACTS`."""
        if self._count > MOST_IMPACTS:
            self._leave_out()
        if len(self._parts) > 1:
            return joined(self._parts, CONTACT_ROW)
        return self._parts[0] if self._parts else NO_ROWS

    def _leave_out(self) -> None:
        """Keep those with the largest normal impulses; of equal ones the first."""
        rows = joined(self._parts, CONTACT_ROW)
        kept = np.sort(np.argsort(-rows["normal_impulse"], kind="stable")[:MOST_IMPACTS])
        self.left_out += len(rows) - len(kept)
        self._parts, self._count = [picked(rows, kept)], len(kept)
