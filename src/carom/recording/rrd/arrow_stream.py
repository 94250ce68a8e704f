"""Decodes an Arrow IPC stream into a record batch; its claims are checked before memory is allocated.

In some Arrow types a hundred bytes can stand for 10⁸ rows: nulls, run-end encoding, fixed-size lists, views,
dictionaries. Buffers can be compressed a second time or shared. carom writes none of these and refuses them.
"""

from __future__ import annotations

import contextlib
import ctypes

import pyarrow as pa

from carom.arrow_claims import Claims, claims
from carom.errors import DamageError

LARGEST = 1 << 31  # bytes of a chunk; carom writes some 4 MB, and 1.3 GB for the state of 10⁷ bodies that spin

_LARGE = 50_000_000  # bytes that Arrow has had at once, from which on memory is given back

_NOT_COMPRESSED, _LZ4 = (0, 1), 2
_LZ4_RATIO, _LZ4_SLACK = 255, 64  # LZ4 cannot compress more
_DEEPEST = 8  # nested types; Rerun's layouts have five levels
_WIDEST = 16  # values of a list of fixed size: a quaternion has 4, an identifier 16
_MOST_COLUMNS = 10_000  # of an index: four a component
_BITS = 8  # no value takes less than one bit

_LEAVES = {
    *(pa.bool_(), pa.string(), pa.binary(16), pa.timestamp("ns"), pa.duration("ns"), pa.float32(), pa.float64()),
    *(pa.int8(), pa.int16(), pa.int32(), pa.int64(), pa.uint8(), pa.uint16(), pa.uint32(), pa.uint64()),
}


def record_batch(payload: memoryview, compression: int, size: int) -> pa.RecordBatch:
    """Unpack and decode one record batch.

    Parameters
    ----------
    compression
        As Rerun numbers it: LZ4, or none.
    size
        Bytes of the payload when it is unpacked.

    Raises
    ------
    DamageError
        If it is incomplete, claims more than its bytes can hold, or has a type that carom does not write.
    """
    if compression == _LZ4:
        if size > min(LARGEST, _LZ4_RATIO * len(payload) + _LZ4_SLACK):
            raise DamageError(f"a chunk that would have {size} bytes")
    elif compression not in _NOT_COMPRESSED:
        raise DamageError("a chunk in an unknown compression")
    try:
        packed = pa.py_buffer(payload)
        return _decoded(pa.decompress(packed, size, codec="lz4_raw") if compression == _LZ4 else packed)
    except (pa.ArrowException, OSError, ValueError, StopIteration, EOFError) as error:
        reason = str(error).splitlines()[0] if str(error) else "nothing in it"
        raise DamageError(f"a chunk that cannot be decoded ({reason})") from error


def release_memory() -> None:
    """Give the memory of large chunks that are gone back to the system: 400 MB for a recording of a million bodies."""
    pool = pa.default_memory_pool()
    if pool.max_memory() > _LARGE:
        pool.release_unused()
        with contextlib.suppress(OSError, AttributeError):  # another C library than glibc
            ctypes.CDLL(None).malloc_trim(0)


def _decoded(stream: pa.Buffer) -> pa.RecordBatch:
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
        raise DamageError(f"a chunk with a {message.type} in place of its rows")
    _believe(claims(message.metadata.to_pybytes()), message.body)
    batch = pa.ipc.read_record_batch(message, schema)
    batch.validate(full=True)
    return batch


def _believe(claimed: Claims, body: pa.Buffer | None) -> None:
    """Refuse a batch that claims more data than its body has."""
    size = 0 if body is None else body.size
    if claimed.compressed:
        raise DamageError("a chunk whose buffers are packed a second time")
    if claimed.buffer_bytes > size:
        raise DamageError(f"a chunk that uses {claimed.buffer_bytes} of its {size} bytes")
    if max(claimed.rows, *claimed.lengths.tolist(), 0) > _BITS * size:
        raise DamageError(f"a chunk that claims {max(claimed.rows, *claimed.lengths.tolist())} values in {size} bytes")


def _admit(column: pa.Field, depth: int = 0) -> None:
    """Refuse types that carom never writes, and names that are not UTF-8, on which Rerun would panic."""
    names = [column.name.encode(), *(word for pair in (column.metadata or {}).items() for word in pair)]
    for name in names:
        name.decode()
    kind = column.type
    if depth > _DEEPEST:
        raise DamageError("a chunk of types in types in types")
    if kind in _LEAVES or (depth and pa.types.is_null(kind)):  # a layout's unions mark with null what is left out
        return
    fixed = pa.types.is_fixed_size_list(kind) and 1 <= kind.list_size <= _WIDEST
    union = pa.types.is_union(kind) and kind.mode == "dense"
    if not (fixed or union or pa.types.is_list(kind) or pa.types.is_struct(kind)):
        raise DamageError(f"a column of type {str(kind)[:80]}, which carom does not write")
    for k in range(kind.num_fields):
        _admit(kind.field(k), depth + 1)
