"""The index of an .rrd file: its stores, and the positions of their chunks. Chunks are read on demand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Self

import pyarrow as pa

from carom.errors import DamageError
from carom.recording.rrd import framing, messages
from carom.recording.rrd.framing import Message
from carom.recording.rrd.messages import (
    BLUEPRINT,
    LARGEST,
    Chunk,
    Entry,
    Store,
    activated_by,
    decode,
    entry_of,
    read_body,
    record_batch,
    store_named,
    store_of,
)
from carom.recording.schema.paths import STEP

_ZIP = b"PK\x03\x04"  # start of a zip file, such as a bug report's
_SHORTEST = 100  # bytes of a chunk's message, whose schema alone is longer
_MANIFEST = {
    "chunk_entity_path": pa.string(),
    "chunk_is_static": pa.bool_(),
    "chunk_num_rows": pa.uint64(),
    "chunk_byte_offset": pa.uint64(),
    "chunk_byte_size": pa.uint64(),
}


class Container:
    """An .rrd file and the index of its chunks. The file is open only while chunks are read."""

    def __init__(self, path: Path, stores: list[Store], finished: bool) -> None:
        self.path = path
        self.stores = stores
        self.finished = finished  # whether it has its footer

    @classmethod
    def open(cls, path: Path) -> Self:
        """Index a file.

        Raises
        ------
        DamageError
            If a message or the footer is incomplete.
        OSError
            If it cannot be read.
        """
        with path.open("rb") as file:
            if not framing.is_rrd(file):
                file.seek(0)
                packed = file.read(len(_ZIP)) == _ZIP
                if framing.is_newer(file):
                    raise DamageError("it is in a newer format of .rrd than RRF2: upgrade carom")
                raise DamageError("it is a zip: unpack it" if packed else "it does not begin with an .rrd header")
            footer = framing.read_footer(file)
            return cls(
                path, _scan(file) if footer is None else _manifests(footer, path.stat().st_size), footer is not None
            )

    def chunks(self, entries: Iterable[Entry]) -> Iterator[Chunk]:
        """Read chunks in order. Raises DamageError if one differs from the index."""
        with self.path.open("rb") as file:
            for entry in entries:
                file.seek(entry.offset)
                _, chunk = decode(file.read(entry.length))
                found = chunk.entity_path, chunk.is_static, chunk.batch.num_rows
                lacks_steps = entry.first_step is not None and STEP not in chunk.timelines
                if found != (entry.entity_path, entry.is_static, entry.rows) or lacks_steps:
                    raise DamageError(f"at byte {entry.offset} is not the expected chunk of /{entry.entity_path}")
                yield chunk


def _scan(file: BinaryIO) -> list[Store]:
    """Index a file without a footer by decoding every message."""
    index = ChunkIndex()
    for message in framing.messages(file):
        index.add(message, read_body(file, message))
    return index.stores()


class ChunkIndex:
    """An index built message by message, for files without a footer."""

    def __init__(self) -> None:
        self._stores: dict[tuple[int, str], Store] = {}
        self._activated: set[str] = set()

    def add(self, message: Message, body: bytes) -> None:
        """Add a message. Raises DamageError if it cannot be decoded."""
        match message.kind:
            case framing.STORE:
                self._known(store_of(body))
            case framing.ACTIVATION:
                self._activated.add(activated_by(body).store_id)
            case framing.CHUNK:
                store, chunk = decode(body)
                self._known(store).entries.append(entry_of(chunk, message))

    def stores(self) -> list[Store]:
        """Return the stores, without layouts that were not sent completely."""
        return [s for s in self._stores.values() if s.kind != BLUEPRINT or s.store_id in self._activated]

    def _known(self, store: Store) -> Store:
        return self._stores.setdefault((store.kind, store.store_id), store)


def _manifests(footer: bytes, size: int) -> list[Store]:
    """Read the footer's entries of each store's chunks, in the order of the file."""
    stores = []
    for manifest in messages.fields(memoryview(footer)).get(1, []):
        if not isinstance(manifest, memoryview):
            raise DamageError("malformed footer")
        parts = messages.fields(manifest)
        table = messages.fields(messages.data(parts, 4))
        batch = record_batch(messages.data(table, 2), messages.number(table, 3), messages.number(table, 4))
        store = store_named(messages.data(parts, 1))
        store.entries.extend(_entries(batch, size))
        stores.append(store)
    _refuse_overlap([entry for store in stores for entry in store.entries], size)
    return sorted(stores, key=lambda store: min((entry.offset for entry in store.entries), default=0))


def _entries(manifest: pa.RecordBatch, size: int) -> list[Entry]:
    if manifest.num_rows > size // _SHORTEST:
        raise DamageError(f"its footer lists {manifest.num_rows} chunks in {size} bytes")
    columns = [_manifest_column(manifest, name, kind) for name, kind in _MANIFEST.items()]
    if any(None in column for column in columns):
        raise DamageError("its footer describes chunks incompletely")
    for name in (f"{STEP}:start", f"{STEP}:end"):
        there = name in manifest.schema.names
        columns.append(_manifest_column(manifest, name, pa.int64()) if there else [None] * manifest.num_rows)
    listed = zip(*columns, strict=True)
    found = [
        Entry(path.lstrip("/"), static, rows, first, last, offset, length)
        for path, static, rows, offset, length, first, last in listed
    ]
    return sorted(found, key=lambda entry: entry.offset)


def _manifest_column(manifest: pa.RecordBatch, name: str, kind: pa.DataType) -> list[Any]:
    if name not in manifest.schema.names:
        raise DamageError(f"its footer has no {name}")
    if manifest[name].type != kind:
        raise DamageError(f"its footer has {name} of type {manifest[name].type}")
    return list(manifest[name].to_pylist())


def _refuse_overlap(entries: list[Entry], size: int) -> None:
    """Refuse an index in which chunks share bytes, since a small file could then claim any number of rows."""
    end = framing.STREAM_HEADER
    for entry in sorted(entries, key=lambda entry: entry.offset):
        if entry.length > LARGEST:
            raise DamageError(f"its footer lists a chunk of {entry.length} bytes")
        if entry.offset < end or entry.offset + entry.length > size:
            raise DamageError(f"its footer lists a chunk at byte {entry.offset}, where no chunk can be")
        end = entry.offset + entry.length
