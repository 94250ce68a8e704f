"""Frames as the chunks that they would be recorded as; a replay compares them with those of the file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pyarrow as pa

from carom.physics.frame import Frame
from carom.recording.read.frame_rows import BY_EVENT
from carom.recording.rrd.messages import Chunk
from carom.recording.schema.clock import Clock
from carom.recording.schema.paths import IMPACT, SIM_TIME, STEP
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.rows import Rows

_INDEX, _DATA = {b"rerun:kind": b"index"}, {b"rerun:kind": b"data"}


def rows_of(frames: Sequence[Frame], encoder: BatchEncoder, clock: Clock) -> Iterator[Chunk]:
    """Encode frames as the recorder does; a chunk for each entity that every frame has one row of."""
    for rows in encoder.rows(frames):
        if rows.path not in BY_EVENT and len(rows.steps):
            yield chunk_of(rows, clock)


def checkpoints_of(frames: Sequence[Frame], encoder: BatchEncoder, clock: Clock) -> Chunk:
    """Encode the exact state of frames."""
    return chunk_of(encoder.checkpoints(frames), clock)


def chunk_of(rows: Rows, clock: Clock) -> Chunk:
    """Return rows as a chunk, as if they had been recorded."""
    columns: dict[str, tuple[pa.Array, dict[bytes, bytes]]] = {}
    index = rows.index
    if len(index.impacts):
        columns[IMPACT] = pa.array(index.impacts, pa.int64()), _INDEX
    if len(index.steps):
        times = pa.array(clock.nanoseconds(index.times)).cast(pa.duration("ns"))
        columns |= {STEP: (pa.array(index.steps, pa.int64()), _INDEX), SIM_TIME: (times, _INDEX)}
    for column in rows.columns:
        columns[column.component_descriptor().component] = (column.as_arrow_array(), _DATA)
    fields = [pa.field(name, array.type, metadata=kind) for name, (array, kind) in columns.items()]
    return Chunk(rows.path, pa.record_batch([array for array, _ in columns.values()], schema=pa.schema(fields)))
