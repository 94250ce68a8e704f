"""The chunks that record a run; a replay compares them with the chunks of the file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pyarrow as pa
import rerun as rr

from carom.arrays import FloatArray
from carom.physics.frame import Frame
from carom.recording.read.frame_rows import BY_EVENT
from carom.recording.rrd.messages import Chunk
from carom.recording.schema.header import Header
from carom.recording.schema.paths import IMPACT, SIM_TIME, STEP
from carom.recording.schema.time_scale import TimeScale
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.rows import Rows, any_values
from carom.recording.write.static_entities import identity, statics

IDENTITY = "__properties/carom"
_INDEX, _DATA = {b"rerun:kind": b"index"}, {b"rerun:kind": b"data"}


def rows_of(frames: Sequence[Frame], encoder: BatchEncoder, clock: TimeScale) -> Iterator[Chunk]:
    """Encode frames like the recorder; return a chunk for each entity with one row per frame."""
    for rows in encoder.rows(frames):
        if rows.path not in BY_EVENT and len(rows.steps):
            yield chunk_of(rows, clock)


def checkpoints_of(frames: Sequence[Frame], encoder: BatchEncoder, clock: TimeScale) -> Chunk:
    """Encode the exact state of frames."""
    return chunk_of(encoder.checkpoints(frames), clock)


def chunk_of(rows: Rows, clock: TimeScale) -> Chunk:
    """Return rows as a chunk, as if they had been recorded."""
    columns: dict[str, tuple[pa.Array, dict[bytes, bytes]]] = {}
    index = rows.index
    if len(index.impacts):
        columns[IMPACT] = pa.array(index.impacts, pa.int64()), _INDEX
    if len(index.steps):
        columns[STEP] = pa.array(index.steps, pa.int64()), _INDEX
    if len(index.times):
        columns[SIM_TIME] = pa.array(clock.within(index.times, index.ends)).cast(pa.duration("ns")), _INDEX
    for column in rows.columns:
        columns[column.component_descriptor().component] = (column.as_arrow_array(), _DATA)
    fields = [pa.field(name, array.type, metadata=kind) for name, (array, kind) in columns.items()]
    return Chunk(rows.path, pa.record_batch([array for array, _ in columns.values()], schema=pa.schema(fields)))


def statics_of(header: Header, clock: TimeScale, origin: FloatArray, reach: float, name: str) -> Iterator[Chunk]:
    """Encode the static data of a recording of this name; see `statics`."""
    archetypes: list[tuple[str, rr.AsComponents]] = [
        (IDENTITY, any_values(identity(header, clock, origin))),
        ("__properties", rr.archetypes.RecordingInfo(name=name)),
    ]
    for path, archetype in (*archetypes, *statics(header, clock, origin, reach)):
        rows = {}
        for batch in archetype.as_component_batches():
            values = batch.as_arrow_array()
            rows[batch.component_descriptor().component] = pa.ListArray.from_arrays([0, len(values)], values)
        fields = [pa.field(name, row.type, metadata=_DATA) for name, row in rows.items()]
        yield Chunk(path, pa.record_batch(list(rows.values()), schema=pa.schema(fields)))
