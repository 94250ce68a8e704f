"""The frames that a resumed run copies from its recording, up to its starting checkpoint."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from carom.arrays import FloatArray
from carom.recording.read.entities import EVENTS, flat, optional_text
from carom.recording.read.frame_rows import arrow_floors
from carom.recording.read.recorded_impacts import RecordedImpacts, impacts_until
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.paths import CLOSING, IMPACT, STEP, kind_of
from carom.recording.schema.time_scale import TimeScale

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint


class Continuation:
    """The frames of a recording up to a checkpoint, which a resumed run writes before its own frames.

    Parameters
    ----------
    recording
        The interrupted run; frames after the checkpoint are ignored.
    step
        Step of the checkpoint.
    """

    def __init__(self, recording: Recording, step: int) -> None:
        self.recording = recording
        self.step = step
        steps = recording.fingerprints()[STEP].to_numpy()
        self.frames = int(np.count_nonzero(steps <= step))
        self.origin = recording.origin  # (3,) m
        self.clock = TimeScale(float(recording.info["time_scale"]))
        self.arrow_references = {name: float(value) for name, value in recording.arrow_references.items()}
        self.last_state = recording.states_at(step)
        self.arrow_floors = arrow_floors(recording, step)

    @cached_property
    def impacts(self) -> RecordedImpacts:
        """The impacts up to the checkpoint."""
        return impacts_until(self.recording, self.step)

    def last(self) -> Checkpoint:
        """Read the values on which the rows of the next frame depend."""
        found = self.recording.checkpoint(self.step)
        return replace(found, acceleration=found.acceleration[:0].copy(), contacts=None, integrator=None)

    def first_position(self) -> FloatArray:
        """Positions of the bodies at the first checkpoint, (n, 3) m."""
        return self.recording.checkpoint(self.recording.checkpoint_steps[0]).position

    def _kept(self, batch: pa.RecordBatch) -> pa.BooleanArray:
        """Return a mask of the rows of steps and impacts up to the checkpoint."""
        if STEP in batch.schema.names:
            return pc.less_equal(batch[STEP], self.step)
        return pc.less_equal(batch[IMPACT], self.impacts.count)

    def chunks(self) -> Iterator[Chunk]:
        """Yield all rows up to the checkpoint, without the events that closed the recording."""
        for chunk in self.recording.temporal_chunks():
            batch = chunk.batch
            kept = self._kept(batch)
            if chunk.entity_path == paths.EVENTS:
                kept = pc.and_(kept, pc.invert(_closes(chunk)))
            if pc.all(kept).as_py():
                yield chunk
            elif pc.any(kept).as_py():
                yield Chunk(chunk.entity_path, batch.filter(kept))


def _closes(chunk: Chunk) -> pa.BooleanArray:
    """Return a mask of the events that were written because the run ended."""
    texts = flat(chunk, "TextLog:text", EVENTS["TextLog:text"]).to_pylist()
    kinds = optional_text(chunk, "kind").to_pylist()
    return pa.array([kind_of(kind, text) in CLOSING for kind, text in zip(kinds, texts, strict=True)], pa.bool_())
