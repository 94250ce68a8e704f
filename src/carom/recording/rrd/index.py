"""The inside of an .rrd file: its stores, their chunks and where they lie. A chunk is read when it is asked for.

Rerun's own reader trusts a file: with one wrong byte it may end the process, or ask for more memory than there is
(about one file in sixty with a few bytes changed). Recordings come from strangers and from torn disks, so they are
decoded here, where everything is checked before it is believed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Self

import pyarrow as pa
import pyarrow.compute as pc

from carom.recording.errors import DamageError
from carom.recording.rrd import framing, protobuf
from carom.recording.rrd.arrow_stream import LARGEST, record_batch
from carom.recording.rrd.framing import Message
from carom.recording.schema.timelines import SIM_TIME, STEP

RECORDING, BLUEPRINT = 1, 2  # kinds of stores

_ARROW_IPC = 1
_SHORTEST = 100  # bytes of a chunk's message; its schema alone has more
_MANIFEST = {
    "chunk_entity_path": pa.string(),
    "chunk_is_static": pa.bool_(),
    "chunk_num_rows": pa.uint64(),
    "chunk_byte_offset": pa.uint64(),
    "chunk_byte_size": pa.uint64(),
}
_PATH = b"rerun:entity_path"
_KIND = b"rerun:kind"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Rows of one entity, read and checked."""

    entity_path: str  # without the slash in front
    batch: pa.RecordBatch  # columns: row ids, timelines and components

    @property
    def is_static(self) -> bool:
        """Whether it holds for all times."""
        return not any(_kind(column) == b"index" for column in self.batch.schema)

    @property
    def components(self) -> list[str]:
        """Names of what the rows hold: lists, one a row."""
        return [column.name for column in self.batch.schema if _kind(column) == b"data"]


@dataclass(frozen=True, slots=True)
class Entry:
    """Where a chunk lies, and what one knows of it without reading it."""

    entity_path: str
    is_static: bool
    rows: int
    first_step: int | None  # None: static, or not on the timeline of steps
    last_step: int | None
    offset: int
    length: int

    def holds(self, step: int) -> bool:
        """Tell whether a step may be in it."""
        return self.first_step is not None and self.last_step is not None and self.first_step <= step <= self.last_step


@dataclass(frozen=True, slots=True)
class Store:
    """A recording, or a blueprint."""

    kind: int
    application_id: str
    store_id: str
    entries: list[Entry] = field(default_factory=list)


class Container:
    """An .rrd file and the index of its chunks. The file is open only while chunks are read."""

    def __init__(self, path: Path, stores: list[Store], finished: bool) -> None:
        self.path = path
        self.stores = stores
        self.finished = finished  # it has its footer

    @classmethod
    def open(cls, path: Path) -> Self:
        """Index a file.

        Raises
        ------
        DamageError
            If a message of it, or its footer, is not whole.
        OSError
            If it cannot be read.
        """
        with path.open("rb") as file:
            if not framing.is_rrd(file):
                raise DamageError("it does not begin like one")
            footer = framing.read_footer(file)
            return cls(
                path, _scan(file) if footer is None else _manifests(footer, path.stat().st_size), footer is not None
            )

    def chunks(self, entries: Iterable[Entry]) -> Iterator[Chunk]:
        """Read chunks, one after the other. DamageError if one is not what the index says."""
        with self.path.open("rb") as file:
            for entry in entries:
                file.seek(entry.offset)
                _, chunk = decode(file.read(entry.length))
                if chunk.entity_path != entry.entity_path or chunk.batch.num_rows != entry.rows:
                    raise DamageError(f"at byte {entry.offset} is not the chunk of /{entry.entity_path} that should be")
                yield chunk


def read_body(file: BinaryIO, message: Message) -> bytes:
    """Read a message's body."""
    file.seek(message.offset)
    return file.read(message.length)


def store_of(body: bytes) -> Store:
    """Decode the message that begins a store."""
    info = protobuf.fields(protobuf.data(protobuf.fields(memoryview(body)), 2))
    return _store(protobuf.data(info, 2))


def activated_by(body: bytes) -> Store:
    """Decode the message that ends a layout: only then has all of it been sent."""
    return _store(protobuf.data(protobuf.fields(memoryview(body)), 1))


def decode(body: bytes) -> tuple[Store, Chunk]:
    """Decode and check a chunk; return it and the store that it belongs to, without its entries.

    Raises
    ------
    DamageError
        If anything about it is not as Rerun writes it.
    """
    message = protobuf.fields(memoryview(body))
    if protobuf.number(message, 4) != _ARROW_IPC:
        raise DamageError("a chunk in an unknown encoding")
    store = _store(protobuf.data(message, 1))
    batch = record_batch(protobuf.data(message, 5), protobuf.number(message, 2), protobuf.number(message, 3))
    chunk = Chunk(_entity_path(batch), batch)
    _check(chunk)
    return store, chunk


def entry_of(chunk: Chunk, message: Message) -> Entry:
    """Index a chunk that was decoded."""
    first = last = None
    if STEP in chunk.batch.schema.names and chunk.batch.num_rows:
        ends = pc.min_max(chunk.batch[STEP])
        first, last = ends["min"].as_py(), ends["max"].as_py()
    return Entry(chunk.entity_path, chunk.is_static, chunk.batch.num_rows, first, last, message.offset, message.length)


def _scan(file: BinaryIO) -> list[Store]:
    """Index a file without a footer: look into every message."""
    index = Index()
    for message in framing.messages(file):
        index.add(message, read_body(file, message))
    return index.stores()


class Index:
    """Grows message by message, where there is no footer to read it from."""

    def __init__(self) -> None:
        self._stores: dict[tuple[int, str], Store] = {}
        self._activated: set[str] = set()

    def add(self, message: Message, body: bytes) -> None:
        """Take a message in. DamageError if it cannot be decoded."""
        match message.kind:
            case framing.STORE:
                self._known(store_of(body))
            case framing.ACTIVATION:
                self._activated.add(activated_by(body).store_id)
            case framing.CHUNK:
                store, chunk = decode(body)
                self._known(store).entries.append(entry_of(chunk, message))

    def stores(self) -> list[Store]:
        """Return what was found, without layouts that were not sent to their end."""
        return [s for s in self._stores.values() if s.kind != BLUEPRINT or s.store_id in self._activated]

    def _known(self, store: Store) -> Store:
        return self._stores.setdefault((store.kind, store.store_id), store)


def _store(identity: memoryview) -> Store:
    parts = protobuf.fields(identity)
    application, name = protobuf.text(protobuf.fields(protobuf.data(parts, 3)), 1), protobuf.text(parts, 2)
    if not (application and name):
        raise DamageError("a store without a name")
    return Store(protobuf.number(parts, 1), application, name)


def _manifests(footer: bytes, size: int) -> list[Store]:
    """Read what the footer says of each store's chunks, in the order in which they lie in the file of this size."""
    stores = []
    for manifest in protobuf.fields(memoryview(footer)).get(1, []):
        if not isinstance(manifest, memoryview):
            raise DamageError("its footer is none")
        parts = protobuf.fields(manifest)
        table = protobuf.fields(protobuf.data(parts, 4))
        batch = record_batch(protobuf.data(table, 2), protobuf.number(table, 3), protobuf.number(table, 4))
        store = _store(protobuf.data(parts, 1))
        store.entries.extend(_entries(batch, size))
        stores.append(store)
    _refuse_overlap([entry for store in stores for entry in store.entries], size)
    return sorted(stores, key=lambda store: min((entry.offset for entry in store.entries), default=0))


def _entries(manifest: pa.RecordBatch, size: int) -> list[Entry]:
    if manifest.num_rows > size // _SHORTEST:
        raise DamageError(f"its footer tells of {manifest.num_rows} chunks in {size} bytes")
    columns = [_manifest_column(manifest, name, kind) for name, kind in _MANIFEST.items()]
    if any(None in column for column in columns):
        raise DamageError("its footer leaves out what a chunk is")
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
    """Refuse an index in which chunks share bytes: a small file could stand for any amount of rows."""
    end = framing.STREAM_HEADER
    for entry in sorted(entries, key=lambda entry: entry.offset):
        if entry.length > LARGEST:
            raise DamageError(f"its footer tells of a chunk of {entry.length} bytes")
        if entry.offset < end or entry.offset + entry.length > size:
            raise DamageError(f"its footer tells of a chunk at byte {entry.offset}, where none can be")
        end = entry.offset + entry.length


def _entity_path(batch: pa.RecordBatch) -> str:
    path = (batch.schema.metadata or {}).get(_PATH, b"")
    try:
        return str(path.decode()).lstrip("/")
    except UnicodeDecodeError as error:
        raise DamageError("a chunk of an entity without a name") from error


def _check(chunk: Chunk) -> None:
    """Hold a chunk against what readers of carom's rely on."""
    batch = chunk.batch
    timelines = {STEP: pa.int64(), SIM_TIME: pa.duration("ns")}
    for column in batch.schema:
        kind = _kind(column)
        if kind == b"index" and batch[column.name].null_count:
            raise DamageError(f"rows of /{chunk.entity_path} without a time")
        if kind == b"index" and timelines.get(column.name, column.type) != column.type:
            raise DamageError(f"a timeline {column.name} of type {column.type}")
        if kind == b"data" and not pa.types.is_list(column.type):
            raise DamageError(f"a component of /{chunk.entity_path} of type {column.type}")
    if len(set(batch.schema.names)) < len(batch.schema.names):
        raise DamageError(f"a component of /{chunk.entity_path} twice")


def _kind(column: pa.Field) -> bytes:
    return bytes((column.metadata or {}).get(_KIND, b""))
