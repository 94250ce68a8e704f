"""The messages of an .rrd file: chunks of rows and the stores they belong to, decoded and checked.

Rerun's own reader trusts a file. With one wrong byte it may abort the process, or request more memory than exists (one
file in sixty with a few changed bytes). Recordings may come from strangers and damaged disks, so carom decodes messages
itself, and checks everything before use.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
from dataclasses import dataclass, field
from typing import BinaryIO

import pyarrow as pa
import pyarrow.compute as pc

from carom.arrow_claims import Claims, claims
from carom.errors import DamageError
from carom.recording.rrd.framing import Message
from carom.recording.timelines import SIM_TIME, STEP

# The sizes that an Arrow IPC stream claims are checked before memory is allocated. In some Arrow types, a hundred bytes
# can represent 10⁸ rows: nulls, run-end encoding, fixed-size lists, views, dictionaries. Buffers can also be compressed
# a second time, or shared. carom writes no such data, and refuses them.

LARGEST = 1 << 31  # bytes, largest chunk; carom writes about 4 MB, or 1.3 GB for the state of 10⁷ spinning bodies

_LARGE = 50_000_000  # bytes; memory is returned to the system if Arrow has ever allocated more than this

_NOT_COMPRESSED, _LZ4 = (0, 1), 2
_LZ4_RATIO, _LZ4_SLACK = 255, 64  # largest compression by LZ4
# bytes to which a chunk of any file may unpack; batches have 4 MB, and cutting a clip takes memory for six chunks
_ROOMY = 1 << 26
# bytes to which a larger chunk may unpack, relative to the size of its file: 1.3 GB in 200 MB for 10⁷ spinning bodies
# at rest on a lattice
_MOST_TIMES = 8
# smallest number of bytes per row in a file; a run of 20 000 equal steps has 18, mostly for identity and time
_LEAST_ROW = 8
_DEEPEST = 8  # largest number of levels of nested types; Rerun's layouts have five
_WIDEST = 16  # largest number of values in a list of fixed size: a quaternion has 4, an identifier 16
_MOST_COLUMNS = 10_000  # largest number of columns of an index, which has four for each component
_BITS = 8  # largest number of values per byte, since each takes at least one bit

_LEAVES = {
    *(pa.bool_(), pa.string(), pa.binary(16), pa.timestamp("ns"), pa.duration("ns"), pa.float32(), pa.float64()),
    *(pa.int8(), pa.int16(), pa.int32(), pa.int64(), pa.uint8(), pa.uint16(), pa.uint32(), pa.uint64()),
}


def record_batch(payload: memoryview, compression: int, size: int, stored: int = 0) -> pa.RecordBatch:
    """Decode one record batch of ``size`` bytes; ``compression``, as numbered by Rerun, is LZ4 or none.

    ``stored`` is the size of the file (bytes), which bounds the size of a batch above `_ROOMY`.

    Raises DamageError if the batch is incomplete, claims more than its bytes can hold, or has a type that is never
    written.
    """
    if compression == _LZ4:
        if size > min(LARGEST, _LZ4_RATIO * len(payload) + _LZ4_SLACK, max(_ROOMY, _MOST_TIMES * stored)):
            raise DamageError(f"a chunk that would have {size} bytes")
    elif compression not in _NOT_COMPRESSED:
        raise DamageError("a chunk in an unknown compression")
    try:
        packed = pa.py_buffer(payload)
        stream = pa.decompress(packed, size, codec="lz4_raw") if compression == _LZ4 else packed
        messages = pa.ipc.MessageReader.open_stream(stream)
        first = messages.read_next_message()
        if first.type != "schema":
            raise DamageError("a chunk without a schema")
        schema = pa.ipc.read_schema(first)
        if len(schema) > _MOST_COLUMNS:
            raise DamageError(f"a chunk of {len(schema)} columns")
        for column in schema:
            _admit(column)
        message = messages.read_next_message()
        if message.type != "record batch":
            raise DamageError(f"a chunk with a {message.type} instead of its rows")
        claimed = claims(message.metadata.to_pybytes())
        _believe(claimed, message.body)
        if claimed.rows > 1 + len(payload) // _LEAST_ROW:
            raise DamageError(f"a chunk of {claimed.rows} rows in {len(payload)} bytes")
        batch = pa.ipc.read_record_batch(message, schema)
        batch.validate(full=True)
        return batch
    except (pa.ArrowException, OSError, ValueError, StopIteration, EOFError) as error:
        reason = str(error).splitlines()[0] if str(error) else "nothing in it"
        raise DamageError(f"a chunk that cannot be decoded ({reason})") from error


def release_memory() -> None:
    """Return the memory of freed large chunks to the system: 400 MB for a recording of a million bodies."""
    pool = pa.default_memory_pool()
    if pool.max_memory() > _LARGE:
        pool.release_unused()
        with contextlib.suppress(OSError, AttributeError):  # the C library is not glibc
            ctypes.CDLL(None).malloc_trim(0)


def _believe(claimed: Claims, body: pa.Buffer | None) -> None:
    """Refuse a batch that claims more data than its body has."""
    size = 0 if body is None else body.size
    if claimed.compressed:
        raise DamageError("a chunk whose buffers are compressed a second time")
    if claimed.buffer_bytes > size:
        raise DamageError(f"a chunk that uses {claimed.buffer_bytes} of its {size} bytes")
    if max(claimed.rows, *claimed.lengths.tolist(), 0) > _BITS * size:
        raise DamageError(f"a chunk that claims {max(claimed.rows, *claimed.lengths.tolist())} values in {size} bytes")


def _admit(column: pa.Field, depth: int = 0) -> None:
    """Refuse types that carom never writes, and names that are not UTF-8, since Rerun would panic on them."""
    names = [column.name.encode(), *(word for pair in (column.metadata or {}).items() for word in pair)]
    for name in names:
        name.decode()
    kind = column.type
    if depth > _DEEPEST:
        raise DamageError("a chunk of too deeply nested types")
    if kind in _LEAVES or (depth and pa.types.is_null(kind)):  # the unions of a layout mark missing values by nulls
        return
    fixed = pa.types.is_fixed_size_list(kind) and 1 <= kind.list_size <= _WIDEST
    union = pa.types.is_union(kind) and kind.mode == "dense"
    if not (fixed or union or pa.types.is_list(kind) or pa.types.is_struct(kind)):
        raise DamageError(f"a column of type {str(kind)[:80]}, which carom does not write")
    for k in range(kind.num_fields):
        _admit(kind.field(k), depth + 1)


# Decodes the fields of Protocol Buffers in the messages of an .rrd.

Fields = dict[int, list["int | memoryview"]]

_LONGEST_VARINT = 64  # largest number of bits of an integer
_MOST_FIELDS = 1000  # largest number of fields in a message; messages of an .rrd have up to six


def fields(message: memoryview) -> Fields:
    """Decode the fields of a message; a field may occur more than once, and nested messages remain bytes."""
    found: Fields = {}
    at = count = 0
    while at < len(message):
        count += 1
        if count > _MOST_FIELDS:
            raise DamageError("a message of too many fields")
        tag, at = _varint(message, at)
        value: int | memoryview
        match tag & 7:
            case 0:
                value, at = _varint(message, at)
            case 1:
                value, at = _bytes(message, at, 8)
            case 2:
                length, at = _varint(message, at)
                value, at = _bytes(message, at, length)
            case 5:
                value, at = _bytes(message, at, 4)
            case _:
                raise DamageError("a field of unknown wire type")
        found.setdefault(tag >> 3, []).append(value)
    return found


def number(message: Fields, field: int) -> int:
    """Return an integer field; 0 if it is absent."""
    value = message.get(field, [0])[-1]
    if not isinstance(value, int):
        raise DamageError("bytes where a number should be")
    return value


def data(message: Fields, field: int) -> memoryview:
    """Return a bytes field or nested message; empty if it is absent."""
    value = message.get(field, [memoryview(b"")])[-1]
    if not isinstance(value, memoryview):
        raise DamageError("a number where bytes should be")
    return value


def text(message: Fields, field: int) -> str:
    """Return a text field."""
    try:
        return bytes(data(message, field)).decode()
    except UnicodeDecodeError as error:
        raise DamageError("a text that is not UTF-8") from error


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, _LONGEST_VARINT, 7):
        if at >= len(message):
            raise DamageError("a number that does not end")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise DamageError("a number that does not end")


def _bytes(message: memoryview, at: int, length: int) -> tuple[memoryview, int]:
    if length > len(message) - at:
        raise DamageError("a field longer than its message")
    return message[at : at + length], at + length


RECORDING, BLUEPRINT = 1, 2  # kinds of stores

_ARROW_IPC = 1


@dataclass(frozen=True, slots=True)
class Chunk:
    """Rows of one entity, decoded and checked."""

    entity_path: str  # path without the leading slash
    batch: pa.RecordBatch  # columns: row ids, timelines and components

    @property
    def is_static(self) -> bool:
        """Whether the chunk is static, that is, on no timeline."""
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
    first_step: int | None  # None for static chunks, and for chunks that are not on the timeline of steps
    last_step: int | None
    offset: int
    length: int

    @property
    def is_within_steps(self) -> bool:
        """Whether the chunk has rows, but none on the timeline of steps."""
        return self.rows > 0 and not self.is_static and self.first_step is None

    def overlaps(self, first: float, last: float) -> bool:
        """Return whether the chunk may have rows of the steps from first to last, both included."""
        return self.first_step is not None and self.first_step <= last and (self.last_step or 0) >= first


@dataclass(frozen=True, slots=True)
class Store:
    """A recording, or a blueprint."""

    kind: int
    application_id: str
    store_id: str
    entries: list[Entry] = field(default_factory=list)

    def frames_of(self, entity_path: str, first: float = -math.inf, last: float = math.inf) -> list[Entry]:
        """Return the entries of an entity that may have rows from the first step to the last, in the order of steps."""
        found = [e for e in self.entries if e.entity_path == entity_path and e.overlaps(first, last)]
        return sorted(found, key=lambda entry: entry.first_step or 0)


def read_body(file: BinaryIO, message: Message) -> bytes:
    """Read a message's body."""
    file.seek(message.offset)
    return file.read(message.length)


def store_of(body: bytes) -> Store:
    """Decode the message that begins a store."""
    info = fields(data(fields(memoryview(body)), 2))
    return store_named(data(info, 2))


def activated_by(body: bytes) -> Store:
    """Decode the message that ends a layout; without this message, a layout was not sent completely."""
    return store_named(data(fields(memoryview(body)), 1))


def decode(body: bytes, stored: int = 0) -> tuple[Store, Chunk]:
    """Decode and check a chunk of a file of ``stored`` bytes; return its store, without entries, and the chunk.

    Raises DamageError if the chunk is malformed.
    """
    message = fields(memoryview(body))
    if number(message, 4) != _ARROW_IPC:
        raise DamageError("a chunk in an unknown encoding")
    store = store_named(data(message, 1))
    batch = record_batch(data(message, 5), number(message, 2), number(message, 3), stored)
    try:
        path = (batch.schema.metadata or {}).get(b"rerun:entity_path", b"").decode()
    except UnicodeDecodeError as error:
        raise DamageError("a chunk of an entity without a name") from error
    chunk = Chunk(path.lstrip("/"), batch)
    _check(chunk)
    return store, chunk


def entry_of(chunk: Chunk, message: Message) -> Entry:
    """Make the index entry of a decoded chunk."""
    first = last = None
    # in the exact start of a clip, a component has the name of this timeline
    if STEP in chunk.timelines and chunk.batch.num_rows:
        ends = pc.min_max(chunk.batch[STEP])
        first, last = ends["min"].as_py(), ends["max"].as_py()
    return Entry(chunk.entity_path, chunk.is_static, chunk.batch.num_rows, first, last, message.offset, message.length)


def store_named(identity: memoryview) -> Store:
    """Decode the identity of a store."""
    parts = fields(identity)
    application, name = text(fields(data(parts, 3)), 1), text(parts, 2)
    if not (application and name):
        raise DamageError("a store without a name")
    return Store(number(parts, 1), application, name)


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
    return bytes((column.metadata or {}).get(b"rerun:kind", b""))
