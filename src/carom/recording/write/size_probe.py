"""Measures bytes and time per entity by writing one batch of frames to a temporary file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rerun as rr

from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.frame import Frame
from carom.recording.schema.header import Header
from carom.recording.schema.time_scale import TimeScale
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.recorder import CheckpointPlan
from carom.recording.write.static_entities import statics
from carom.recording.write.stream import BATCH_BYTES, Stream, frames_in_batch

BATCH_FRAMES = 200


@dataclass(frozen=True, slots=True)
class Taken:
    """The cost of one entity."""

    once: int  # bytes of static data
    bytes: float  # bytes of arrays per frame
    seconds: float  # s of the recorder's thread per frame


def probe(path: Path, header: Header, frames: Sequence[Frame]) -> dict[str, Taken]:
    """Write a batch of repeated frames to a temporary file, and measure the size of each entity.

    Returns
    -------
    taken
        The cost of each entity, in the order of writing.
    """
    rr.set_strict_mode(True)
    clock = TimeScale()
    origin = np.average(frames[0].position, axis=0, weights=header.mass)
    once = {
        entity: sum(batch.as_arrow_array().nbytes for batch in archetype.as_component_batches())
        for entity, archetype in statics(header, clock, origin, 1.0)
    }
    count = max(1, min(BATCH_FRAMES, frames_in_batch(header.bodies)))
    batch = [replace(frames[k % len(frames)], step=k, time=float(k), slot=None) for k in range(count)]
    stream = Stream(path, header, batch_bytes=BATCH_BYTES, live=None)
    try:
        _send(
            batch, stream, BatchEncoder(header, origin), clock
        )  # not measured: the first call loads libraries and kernels
        sizes, profile = _send(batch, stream, BatchEncoder(header, origin), clock)
    finally:
        stream.close()
    seconds = profile.seconds()
    return {
        entity: Taken(once.get(entity, 0), sizes[entity] / count, seconds.get(entity, 0.0) / count)
        for entity in dict.fromkeys([*once, *sizes])
    }


def _send(batch: list[Frame], stream: Stream, encoder: BatchEncoder, clock: TimeScale) -> tuple[Counter[str], Profile]:
    """Send a batch as the recorder does; return the bytes of each entity, and its time."""
    sizes, profile = Counter[str](), Profile()
    profile.start()
    for rows in encoder.rows(batch):
        stream.send(rows, clock)
        sizes[rows.path] += rows.bytes
        profile.mark(rows.path)
    kept = encoder.checkpoints(CheckpointPlan().chosen(batch))
    stream.send(kept, clock)
    sizes[kept.path] += kept.bytes
    profile.mark(kept.path)
    stream.flush()
    return sizes, profile
