"""The messages of an .rrd file: chunks of rows and the stores they belong to, decoded and checked.

Rerun's own reader trusts a file. With one wrong byte it may end the process, or request more memory than there is
(about one file in sixty with a few bytes changed). Recordings may come from strangers and damaged disks, so carom
decodes them itself and checks everything before use.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import BinaryIO

import pyarrow as pa
import pyarrow.compute as pc

from carom.errors import DamageError
from carom.recording.rrd import protobuf
from carom.recording.rrd.arrow_stream import record_batch
from carom.recording.rrd.framing import Message
from carom.recording.schema.paths import SIM_TIME, STEP

RECORDING, BLUEPRINT = 1, 2  # kinds of stores

_ARROW_IPC = 1
_PATH = b"rerun:entity_path"
_KIND = b"rerun:kind"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Rows of one entity, decoded and checked."""

    entity_path: str  # without the slash in front
    batch: pa.RecordBatch  # columns: row ids, timelines and components

    @property
    def is_static(self) -> bool:
        """Whether it is static: on no timeline."""
        return not self.timelines

    @property
    def timelines(self) -> list[str]:
        """Names of the timelines."""
        return [column.name for column in self.batch.schema if _kind(column) == b"index"]

    @property
    def components(self) -> list[str]:
        """Names of the components; each row holds a list of values."""
        return [column.name for column in self.batch.schema if _kind(column) == b"data"]


@dataclass(frozen=True, slots=True)
class Entry:
    """Position of a chunk in the file, and its data in the index."""

    entity_path: str
    is_static: bool
    rows: int
    first_step: int | None  # None: static, or not on the timeline of steps
    last_step: int | None
    offset: int
    length: int

    def holds(self, step: int) -> bool:
        """Tell whether the chunk may have rows of a step."""
        return self.first_step is not None and self.last_step is not None and self.first_step <= step <= self.last_step


@dataclass(frozen=True, slots=True)
class Store:
    """A recording, or a blueprint."""

    kind: int
    application_id: str
    store_id: str
    entries: list[Entry] = field(default_factory=list)


def read_body(file: BinaryIO, message: Message) -> bytes:
    """Read a message's body."""
    file.seek(message.offset)
    return file.read(message.length)


def store_of(body: bytes) -> Store:
    """Decode the message that begins a store."""
    info = protobuf.fields(protobuf.data(protobuf.fields(memoryview(body)), 2))
    return store_named(protobuf.data(info, 2))


def activated_by(body: bytes) -> Store:
    """Decode the message that ends a layout; a layout without it was not sent completely."""
    return store_named(protobuf.data(protobuf.fields(memoryview(body)), 1))


def decode(body: bytes) -> tuple[Store, Chunk]:
    """Decode and check a chunk; return its store, without entries, and the chunk.

    Raises
    ------
    DamageError
        If it is malformed.
    """
    message = protobuf.fields(memoryview(body))
    if protobuf.number(message, 4) != _ARROW_IPC:
        raise DamageError("a chunk in an unknown encoding")
    store = store_named(protobuf.data(message, 1))
    batch = record_batch(protobuf.data(message, 5), protobuf.number(message, 2), protobuf.number(message, 3))
    chunk = Chunk(_entity_path(batch), batch)
    _check(chunk)
    return store, chunk


def entry_of(chunk: Chunk, message: Message) -> Entry:
    """Make the index entry of a decoded chunk."""
    first = last = None
    if STEP in chunk.timelines and chunk.batch.num_rows:  # the exact start of a clip has a component of that name
        ends = pc.min_max(chunk.batch[STEP])
        first, last = ends["min"].as_py(), ends["max"].as_py()
    return Entry(chunk.entity_path, chunk.is_static, chunk.batch.num_rows, first, last, message.offset, message.length)


def store_named(identity: memoryview) -> Store:
    """Decode the identity of a store."""
    parts = protobuf.fields(identity)
    application, name = protobuf.text(protobuf.fields(protobuf.data(parts, 3)), 1), protobuf.text(parts, 2)
    if not (application and name):
        raise DamageError("a store without a name")
    return Store(protobuf.number(parts, 1), application, name)


def _entity_path(batch: pa.RecordBatch) -> str:
    path = (batch.schema.metadata or {}).get(_PATH, b"")
    try:
        return str(path.decode()).lstrip("/")
    except UnicodeDecodeError as error:
        raise DamageError("a chunk of an entity without a name") from error


def _check(chunk: Chunk) -> None:
    """Check the properties that readers of a chunk rely on."""
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
    if STEP in chunk.timelines and SIM_TIME not in chunk.timelines:
        raise DamageError(f"rows of /{chunk.entity_path} with steps, but without {SIM_TIME}")
    if len(set(batch.schema.names)) < len(batch.schema.names):
        raise DamageError(f"a component of /{chunk.entity_path} twice")


def _kind(column: pa.Field) -> bytes:
    return bytes((column.metadata or {}).get(_KIND, b""))
