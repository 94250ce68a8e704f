"""Chooses which frames carry a checkpoint."""

from __future__ import annotations

from collections.abc import Sequence

from carom.physics.frame import Frame
from carom.recording.schema.checkpoint_columns import size


class CheckpointPlan:
    """Decides which frames carry a checkpoint, so that checkpoints take about a tenth of the recording.

    The first frame always carries one, and so does the frame before a warning, until warnings alone have used up
    another tenth. The choice depends on the frames alone, not on how they are batched, so that the same run always has
    the same checkpoints.

    Parameters
    ----------
    every_frame
        Whether every frame carries one: what cannot be run again has its exact states nowhere else.
    """

    _SHARE = 0.1
    _WARNINGS_AT_LEAST = 4

    def __init__(self, every_frame: bool = False) -> None:
        self._every_frame = every_frame
        self._others = 0  # bytes of all frames so far, without checkpoints
        self._regular = 0  # bytes of checkpoints
        self._warned = 0
        self._warnings = 0
        self._before: Frame | None = None
        self._last_kept = -1

    def chosen(self, batch: Sequence[Frame]) -> list[Frame]:
        """Return the frames of a batch that carry a checkpoint; the first may be the last frame of the batch before."""
        if self._every_frame:
            return list(batch)
        kept: list[Frame] = []
        for frame in batch:
            self._others += _bytes_of(frame)
            room, cost = self._SHARE * self._others, size(frame)
            before, self._before = self._before, frame
            if before and before.step != self._last_kept and self._may_warn(frame, before, room):
                kept.append(before)
                self._last_kept = before.step
            if self._last_kept < 0 or self._regular + cost <= room:
                self._regular += cost
                kept.append(frame)
                self._last_kept = frame.step
        return kept

    def _may_warn(self, frame: Frame, before: Frame, room: float) -> bool:
        if not any(event.level == "WARN" for event in frame.events):
            return False
        cost = size(before)
        if self._warnings >= self._WARNINGS_AT_LEAST and self._warned + cost > room:
            return False
        self._warnings += 1
        self._warned += cost
        return True


def _bytes_of(frame: Frame) -> int:
    """Estimate the bytes of a frame's row without its arrows: drawn bodies and contacts, and twenty scalars."""
    return len(frame.position) * (12 if frame.orientation is None else 28) + 28 * len(frame.contacts) + 20 * 24
