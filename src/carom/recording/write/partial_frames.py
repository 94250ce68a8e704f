"""Frames of a run in which bodies come and go, and the record of the frames in which each body exists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carom.arrays import IntArray
from carom.recording.schema.checkpoint_columns import PartialCheckpoint
from carom.state.checkpoint import fingerprint_of
from carom.state.frame import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class PartialFrame(Frame):
    """A frame with a place for each body of the run, including bodies that do not exist in it."""

    present: IntArray  # (k,) numbers of the bodies that exist

    @property
    def fingerprint(self) -> int:
        """A fingerprint of the exact state of the bodies that exist."""
        arrays = (self.position, self.velocity, self.orientation, self.angular_velocity)
        return fingerprint_of(self.time, [None if each is None else each[self.present] for each in arrays])

    @property
    def checkpoint(self) -> PartialCheckpoint:
        """The exact state, with NaN for bodies that do not exist."""
        return PartialCheckpoint.of(super(PartialFrame, self).checkpoint, self.present)


class Lives:
    """Records which bodies exist in the frames of a run."""

    def __init__(self, bodies: int) -> None:
        self.change = False  # whether a body has come or gone so far
        self._first, self._last = np.full((2, bodies), -1, dtype=np.int64)
        self._present: IntArray | None = None  # bodies that exist in the last frame

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
        """Return the recorded components: the first and the last step in which each body exists.

        For a body that exists in the last frame, the last step is -1; for a body without a frame, the first step is -1.
        """
        last = self._last.copy()
        last[self._present] = -1
        return {"first_step": self._first, "last_step": last}
