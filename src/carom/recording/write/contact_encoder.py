"""Encodes contacts and impacts: columns beside the edges, arrows, and a row for each impact."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rerun import ComponentColumnList

from carom.physics.aligned import joined, picked
from carom.physics.checkpoint import Checkpoint
from carom.physics.contact.contact_table import CONTACT_ROW
from carom.physics.frame import Frame
from carom.recording.schema.header import Header
from carom.recording.schema.impacts import RecordedImpacts
from carom.recording.schema.paths import IMPACT_ENERGY, IMPACTS
from carom.recording.view import arrows, impulse_scale
from carom.recording.write.contact_columns import BatchContacts, contact_columns, force_rows
from carom.recording.write.impact_frames import orientations_at, positions_at
from carom.recording.write.impact_plan import ImpactPlan, Kept
from carom.recording.write.impact_rows import impact_rows
from carom.recording.write.rows import Rows, any_column

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ROUND_OFF = 1e-12  # of J v_n: less energy than that is not lost but rounded


class ContactEncoder:
    """Turns the contacts and impacts of batches of frames into rows.

    Parameters
    ----------
    header
        Of the recording.
    origin
        (3,) m, of what is drawn.
    references
        Magnitudes in the middle of the scales; those not known yet are added when there is something to draw.
    before
        The impacts before the first frame.
    everything
        Whether nothing is left out, whatever the scene says: for a comparison with what was recorded.
    """

    def __init__(
        self,
        header: Header,
        origin: FloatArray,
        references: dict[str, float],
        before: RecordedImpacts,
        *,
        everything: bool,
    ) -> None:
        self._header = header
        self._origin = origin
        self._box = np.zeros(3) if header.box is None else np.asarray(header.box, dtype=np.float64)
        self._references = references
        self._plan = ImpactPlan(everything=everything or header.record_impacts == "all")
        self._count, self._recorded = before.count, before.recorded
        self._kept: list[Kept] = []
        self._shows_bodies = not everything

    @property
    def impacts(self) -> RecordedImpacts:
        """The impacts of all batches so far."""
        return RecordedImpacts(self._recorded, self._count - self._recorded)

    def columns(self, batch: Sequence[Frame], pairs: NDArray[np.int64]) -> tuple[ComponentColumnList, int]:
        """Return the columns beside the edges of a batch's frames, whose pairs these are, and their bytes."""
        for frame in batch:
            self._look(frame)
        self._kept = [self._plan.choose(frame) for frame in batch]
        self._contacts = BatchContacts.of(batch)
        columns, size = contact_columns(batch, self._contacts, pairs, self._header.radius)
        before = self._count
        counts = before + np.cumsum([_impacts(frame) for frame in batch])
        self._count = int(counts[-1])
        self._before = np.concatenate(([before], counts[:-1]))
        return ComponentColumnList([*columns, *any_column("impact_count", counts)]), size + counts.nbytes

    def rows(self, batch: Sequence[Frame]) -> Iterable[Rows]:
        """Return arrows and impacts of the batch whose columns were asked for last."""
        header, references = self._header, self._references
        drawn = [kept.arrows for kept in self._kept]
        longest = arrows.longest(header.radius, impulse_scale.REACH)
        # also where none is drawn, which clears those of the frame before
        yield from force_rows(batch, self._contacts, drawn, longest, self._origin, header.has_friction)
        impacts, numbers = self._chosen(batch)
        self._recorded += len(impacts)
        if len(impacts):
            yield impact_rows(impacts, numbers, references, header.radius, self._origin)

    def scenes(self, batch: Sequence[Frame], before: Frame | Checkpoint | None) -> tuple[IntArray, FloatArray, Any]:
        """Return numbers of impacts (k,), and positions (k, n, 3) m and orientations of all bodies at them.

        Parameters
        ----------
        batch
            The frames whose rows were asked for last.
        before
            The frame before them.
        """
        numbers, positions, turned = list[IntArray](), list[FloatArray](), list[FloatArray]()
        earlier = [before, *batch[:-1]]
        for frame, last, kept, count in zip(batch, earlier, self._kept, self._before, strict=True):
            if last is None or frame.impacts is None or not kept.scenes or frame.time <= last.time:
                continue
            chosen = kept.impacts[: kept.scenes]
            times = frame.impacts["time"][chosen]
            numbers.append(count + 1 + chosen)
            positions.append(positions_at(times, last, frame, frame.impacts, self._header.radius, self._box))
            if (orientation := orientations_at(times, last, frame)) is not None:
                turned.append(orientation)
        if not numbers or not self._shows_bodies:
            return np.empty(0, np.int64), np.empty((0, self._header.bodies, 3)), None
        return np.concatenate(numbers), np.concatenate(positions), np.concatenate(turned) if turned else None

    def _chosen(self, batch: Sequence[Frame]) -> tuple[NDArray[np.void], NDArray[np.int64]]:
        """Return the impacts that are recorded, and their numbers."""
        found, numbers = [], [np.empty(0, dtype=np.int64)]
        for frame, kept, before in zip(batch, self._kept, self._before, strict=True):
            if frame.impacts is not None and len(kept.impacts):
                found.append(picked(frame.impacts, kept.impacts))
                # where the tap left out some itself, numbers go to those that it kept
                numbers.append(before + 1 + kept.impacts)
        return joined(found, CONTACT_ROW), np.concatenate(numbers)

    def _look(self, frame: Frame) -> None:
        """Choose references by the first frame that has something to draw."""
        if frame.impacts is not None and len(frame.impacts):
            rows = frame.impacts
            if IMPACTS not in self._references:
                self._refer(IMPACTS, rows["normal_impulse"])
            if IMPACT_ENERGY not in self._references:
                lost = rows["restitution_loss"] + rows["friction_loss"]
                self._refer(IMPACT_ENERGY, lost[lost > _ROUND_OFF * rows["normal_impulse"] * rows["approach_speed"]])

    def _refer(self, name: str, values: FloatArray) -> None:
        positive = values[values > 0.0]
        if len(positive):
            self._references[name] = max(float(np.median(positive)), np.finfo(np.float64).tiny)


def _impacts(frame: Frame) -> int:
    """Count the impacts since the frame before."""
    return frame.impacts_left_out + (0 if frame.impacts is None else len(frame.impacts))
