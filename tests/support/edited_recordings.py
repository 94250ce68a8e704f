"""Recordings taken apart and put together again with other rows in them, as a stranger might."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa
import xxhash

from carom.recording.rrd import framing, messages
from carom.recording.rrd.framing import CHUNK, END
from carom.recording.rrd.messages import RECORDING, decode, record_batch

Change = Callable[[pa.RecordBatch], pa.RecordBatch]

LZ4 = 2


def changed(
    source: Path,
    out: Path,
    entity: str,
    change: Change,
    *,
    static: bool = False,
    every: bool = True,
    footer: bool = True,
) -> Path:
    """Write a recording anew with the rows of one entity changed, all of its chunks or the last alone.

    Without its footer it is a run that was killed. With one, the index says what is there.
    """
    parts = [(message.kind, body) for message, body in _messages(source)]
    found = [k for k, (kind, body) in enumerate(parts) if kind == CHUNK and is_of(body, entity, static)]
    assert found, f"there is no /{entity} in {source}"
    for k in found if every else found[-1:]:
        parts[k] = (CHUNK, repacked(parts[k][1], stream(change(decode(parts[k][1])[1].batch))))
    return assembled(source, out, parts, footer)


def assembled(
    source: Path, out: Path, parts: list[tuple[int, bytes]], footer: bool = True, index: Change = lambda batch: batch
) -> Path:
    """Write messages one after the other; with a footer, its index is that of the source brought up to date.

    What is added after the messages of the source is not in the index. ``index`` may change each store's.
    """
    content = bytearray(source.read_bytes()[: framing.STREAM_HEADER])
    moved: dict[int, tuple[int, bytes]] = {}  # by where the message was: where it is, and what it is
    before = [found.offset for found, _ in _messages(source) if found.kind != END]
    for k, (kind, body) in enumerate(part for part in parts if part[0] != END):
        if k < len(before):
            moved[before[k]] = (len(content) + framing.MESSAGE_HEADER, body)
        content += kind.to_bytes(8, "little") + len(body).to_bytes(8, "little") + body
    if footer:
        body = _index(next(body for kind, body in messages_of(source) if kind == END), moved, index)
        content += END.to_bytes(8, "little") + len(body).to_bytes(8, "little")
        content += body + stream_footer(len(content), body)
    out.write_bytes(content)
    return out


def stream_footer(at: int, index: bytes) -> bytes:
    """Make the last 32 bytes of a file whose index lies at a place."""
    checksum = xxhash.xxh32(index, seed=7850921).intdigest()
    return (
        at.to_bytes(8, "little")
        + len(index).to_bytes(8, "little")
        + checksum.to_bytes(4, "little")
        + (b"RRF2FOOT" + (1).to_bytes(4, "little"))
    )


def stream(batch: pa.RecordBatch, options: pa.ipc.IpcWriteOptions | None = None) -> bytes:
    """Write a batch as an Arrow IPC stream."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema, options=options) as writer:
        writer.write_batch(batch)
    return bytes(sink.getvalue())


def repacked(body: bytes, payload: bytes, claimed: int | None = None) -> bytes:
    """Put another Arrow stream into the message of a chunk, packed by LZ4."""
    packed = pa.compress(payload, codec="lz4_raw", asbytes=True)
    values = _fields(memoryview(body))
    values |= {2: [LZ4], 3: [len(payload) if claimed is None else claimed], 5: [packed]}
    return message(values)


def message(fields: dict[int, list[int | bytes]]) -> bytes:
    """Encode a message of Protocol Buffers."""
    encoded = bytearray()
    for number, values in fields.items():
        for value in values:
            if isinstance(value, int):
                encoded += varint(number << 3) + varint(value)
            else:
                encoded += varint(number << 3 | 2) + varint(len(value)) + value
    return bytes(encoded)


def varint(value: int) -> bytes:
    """Encode a number seven bits at a time."""
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def with_column(batch: pa.RecordBatch, name: str, values: pa.Array) -> pa.RecordBatch:
    """Put other values, perhaps of another type, into a column; what the column is about stays."""
    place = batch.schema.get_field_index(name)
    field = pa.field(name, values.type, metadata=batch.schema.field(place).metadata)
    arrays = [values if k == place else batch.column(k) for k in range(batch.num_columns)]
    return pa.record_batch(arrays, schema=batch.schema.set(place, field))


def without_column(batch: pa.RecordBatch, name: str) -> pa.RecordBatch:
    """Leave a column out."""
    kept = [k for k, field in enumerate(batch.schema) if field.name != name]
    schema = pa.schema([batch.schema.field(k) for k in kept], metadata=batch.schema.metadata)
    return pa.record_batch([batch.column(k) for k in kept], schema=schema)


def mapped(name: str, each: Callable[[list[Any]], list[Any]]) -> Change:
    """Return a change of one component, row by row; its type stays."""

    def change(batch: pa.RecordBatch) -> pa.RecordBatch:
        rows = [each(row) for row in batch[name].to_pylist()]
        return with_column(batch, name, pa.array(rows, batch[name].type))

    return change


def retyped(name: str, rows: Callable[[int], pa.Array]) -> Change:
    """Return a change that puts other rows into a component, whatever their type."""
    return lambda batch: with_column(batch, name, rows(batch.num_rows))


def _messages(path: Path) -> Iterable[tuple[framing.Message, bytes]]:
    with path.open("rb") as file:
        for found in framing.messages(file):
            file.seek(found.offset)
            yield found, file.read(found.length)


def messages_of(path: Path) -> list[tuple[int, bytes]]:
    """Take a recording apart."""
    return [(found.kind, body) for found, body in _messages(path)]


def is_of(body: bytes, entity: str, static: bool = False) -> bool:
    """Tell whether a chunk has rows of an entity of the run."""
    store, chunk = decode(body)
    return store.kind == RECORDING and chunk.entity_path == entity and chunk.is_static == static


def _index(old: bytes, moved: dict[int, tuple[int, bytes]], change: Change) -> bytes:
    """Say in a footer where chunks lie now, and how many rows and bytes they have."""
    manifests: list[int | bytes] = []
    for manifest in messages.fields(memoryview(old))[1]:
        assert isinstance(manifest, memoryview)
        fields = _fields(manifest)
        packed = _fields(messages.data(messages.fields(manifest), 4))
        (payload,), (size,) = packed[2], packed[4]
        assert isinstance(payload, bytes) and isinstance(size, int)
        batch = record_batch(memoryview(payload), LZ4, size)
        chunks = [moved[offset] for offset in batch["chunk_byte_offset"].to_pylist()]
        rows = [decode(body, messages.LARGEST)[1].batch.num_rows for _, body in chunks]
        columns = {"offset": [at for at, _ in chunks], "size": [len(body) for _, body in chunks]}
        for name, values in columns.items():
            batch = with_column(batch, f"chunk_byte_{name}", pa.array(values, pa.uint64()))
        whole = stream(change(with_column(batch, "chunk_num_rows", pa.array(rows, pa.uint64()))))
        packed |= {2: [pa.compress(whole, codec="lz4_raw", asbytes=True)], 3: [LZ4], 4: [len(whole)]}
        manifests.append(message(fields | {4: [message(packed)]}))
    return message({1: manifests})


def _fields(encoded: memoryview) -> dict[int, list[int | bytes]]:
    found = messages.fields(encoded).items()
    return {number: [v if isinstance(v, int) else bytes(v) for v in values] for number, values in found}
