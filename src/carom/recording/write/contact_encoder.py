"""Encodes contacts and impacts: columns beside the edges, arrows, and a row for each impact."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rerun import ComponentColumn

from carom.physics.checkpoint import Checkpoint
from carom.physics.frame import Frame
from carom.recording.read.impacts import RecordedImpacts
from carom.recording.schema.header import Header
from carom.recording.schema.paths import IMPACT_ENERGY, IMPACTS
from carom.recording.style import arrows, impulse_scale
from carom.recording.write.columns import any_column
from carom.recording.write.contact_columns import BatchContacts, contact_columns, force_rows
from carom.recording.write.impact_frames import orientations_at, positions_at
from carom.recording.write.impact_plan import ImpactPlan
from carom.recording.write.impact_rows import impact_rows
from carom.recording.write.rows import Index, Rows

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
        self._plan = ImpactPlan.of(header, everything=everything)
        self._count, self._recorded = before.count, before.recorded
        self._shows_bodies = not everything

    @property
    def impacts(self) -> RecordedImpacts:
        """The impacts of all batches so far."""
        return RecordedImpacts(self._recorded, self._count - self._recorded)

    def columns(
        self, batch: Sequence[Frame], contacts: BatchContacts, position: FloatArray
    ) -> tuple[list[ComponentColumn], int]:
        """Return the columns beside the edges of a batch's frames, and their bytes.

        Parameters
        ----------
        contacts
            Of the batch.
        position
            (frames, n, 3) m.
        """
        for frame in batch:
            self._look(frame)
        self._contacts, self._middle = contacts, contacts.middles()
        self._kept = self._plan.choose(position, contacts.edges, contacts.contacts, contacts.impacts)
        self._impacts, self._chosen = contacts.strongest_impacts(self._kept.impacts)
        columns, size = contact_columns(contacts, self._middle, self._header.radius)
        counts = self._count + np.cumsum(contacts.impacts + [frame.impacts_left_out for frame in batch])
        self._before = np.concatenate(([self._count], counts[:-1]))
        self._count = int(counts[-1])
        return [*columns, any_column("impact_count", counts)], size + counts.nbytes

    def rows(self, index: Index) -> Iterable[Rows]:
        """Return arrows and impacts of the batch whose columns were asked for last."""
        header, kept, impacts = self._header, self._kept, self._impacts
        longest = arrows.longest(header.radius, impulse_scale.REACH)
        # also where none is drawn, which clears those of the frame before
        yield from force_rows(
            index, self._contacts, self._middle, kept.arrows, longest, self._origin, header.has_friction
        )
        self._recorded += len(impacts)
        if len(impacts):
            # where the tap left out some itself, numbers go to those that it kept
            numbers = np.repeat(self._before, kept.impacts) + 1 + self._chosen
            yield impact_rows(impacts, numbers, self._references, header.radius, self._origin)

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
        first = np.cumsum(self._kept.impacts) - self._kept.impacts  # of each frame's chosen impacts
        for f in np.flatnonzero(self._kept.scenes).tolist():
            frame, last, count = batch[f], batch[f - 1] if f else before, self._before[f]
            if last is None or frame.impacts is None or frame.time <= last.time:
                continue
            chosen = self._chosen[first[f] : first[f] + self._kept.scenes[f]]
            times = frame.impacts["time"][chosen]
            numbers.append(count + 1 + chosen)
            positions.append(positions_at(times, last, frame, frame.impacts, self._header.radius, self._box))
            if (orientation := orientations_at(times, last, frame)) is not None:
                turned.append(orientation)
        if not numbers or not self._shows_bodies:
            return np.empty(0, np.int64), np.empty((0, self._header.bodies, 3)), None
        return np.concatenate(numbers), np.concatenate(positions), np.concatenate(turned) if turned else None

    def _look(self, frame: Frame) -> None:
        """Choose references by the first frame that has something to draw."""
        references, rows = self._references, frame.impacts
        if rows is not None and len(rows) and not (IMPACTS in references and IMPACT_ENERGY in references):
            if IMPACTS not in references:
                self._refer(IMPACTS, rows["normal_impulse"])
            if IMPACT_ENERGY not in references:
                lost = rows["restitution_loss"] + rows["friction_loss"]
                self._refer(IMPACT_ENERGY, lost[lost > _ROUND_OFF * rows["normal_impulse"] * rows["approach_speed"]])

    def _refer(self, name: str, values: FloatArray) -> None:
        positive = values[values > 0.0]
        if len(positive):
            self._references[name] = max(float(np.median(positive)), np.finfo(np.float64).tiny)
