"""`Lives`: the first and the last frame of each body, where bodies come and go."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from carom.arrays import IntArray
from carom.physics.frame import Frame
from carom.recording.source.population import PartialFrame


class Lives:
    """Records which bodies exist in the frames of a run.

    Attributes
    ----------
    change
        Whether a body has come or gone so far.
    """

    def __init__(self, bodies: int) -> None:
        self.change = False
        self._first, self._last = np.full((2, bodies), -1, dtype=np.int64)
        self._present: IntArray | None = None  # of the last frame

    def add(self, batch: Sequence[Frame]) -> bool:
        """Add frames; return whether bodies came or went in them."""
        changed = False
        for frame in batch:
            if not isinstance(frame, PartialFrame):
                continue
            if (new := len(frame.position) - len(self._first)) > 0:
                self._first, self._last = (np.append(each, np.full(new, -1)) for each in (self._first, self._last))
            if frame.present is not self._present:
                changed = changed or self._present is not None
                came = frame.present[self._first[frame.present] < 0]
                self._first[came] = frame.step
                self._present = frame.present
            self._last[frame.present] = frame.step
        self.change = self.change or changed
        return changed

    def columns(self) -> dict[str, IntArray]:
        """Return the components that are recorded: the first and the last step of each body.

        For a body that exists in the last frame, the last step is -1; for a body without a frame, the first step is -1.
        """
        last = self._last.copy()
        last[self._present] = -1
        return {"first_step": self._first, "last_step": last}
