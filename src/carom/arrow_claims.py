"""Reads the claimed size of an Arrow record batch from its FlatBuffers metadata, before the batch is built."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from carom.arrays import IntArray

_HEADER = 2  # field of a Message: its RecordBatch
_DATA = 1  # field of a DictionaryBatch: its RecordBatch
_FIELDS = 1  # field of a Schema: its columns
_SIZE = 8  # number of bytes before a compressed buffer that state its uncompressed size
_LENGTH, _NODES, _BUFFERS, _COMPRESSION = 0, 1, 2, 3  # fields of a RecordBatch


@dataclass(frozen=True, slots=True)
class Claims:
    """The size that a record batch claims to have."""

    rows: int
    lengths: IntArray  # lengths of all arrays, including nested arrays
    buffer_bytes: int  # summed over all buffers
    compressed: bool  # whether each buffer is compressed and begins with its uncompressed size
    buffers: IntArray  # (b, 2) offset in the body, and length, of each buffer


def claims(message: bytes, dictionary: bool = False) -> Claims:
    """Read the metadata of an Arrow IPC message that contains a record batch, directly or within a dictionary.

    Raises ValueError if the metadata are incomplete.
    """
    try:
        batch = _table(message, _root(message), _HEADER)
        if batch is not None and dictionary:
            batch = _table(message, batch, _DATA)
        if batch is None:
            raise ValueError("a record batch without a header")
        rows, buffers = _field(message, batch, _LENGTH), _pairs(message, batch, _BUFFERS)
        return Claims(
            rows=0 if rows is None else struct.unpack_from("<q", message, rows)[0],
            lengths=_pairs(message, batch, _NODES)[:, 0],
            buffer_bytes=sum(buffers[:, 1].tolist()),
            compressed=_field(message, batch, _COMPRESSION) is not None,
            buffers=buffers,
        )
    except struct.error as error:
        raise ValueError("a record batch with an incomplete header") from error


def columns(message: bytes) -> int:
    """Return the number of columns in an Arrow IPC message with a schema; raises ValueError if it is incomplete."""
    try:
        schema = _table(message, _root(message), _HEADER)
        fields = None if schema is None else _table(message, schema, _FIELDS)
        return 0 if fields is None else int(struct.unpack_from("<I", message, fields)[0])
    except struct.error as error:
        raise ValueError("a schema with an incomplete header") from error


def unpacked_bytes(claimed: Claims, body: memoryview) -> int:
    """Return the size in memory (bytes) of a batch's buffers; a compressed buffer begins with its size.

    Raises ValueError if a buffer is not in the body.
    """
    total = 0
    for offset, length in claimed.buffers.tolist():
        if not 0 <= offset <= offset + length <= len(body):
            raise ValueError("a record batch that uses more than its bytes")
        size = struct.unpack_from("<q", body, offset)[0] if claimed.compressed and length >= _SIZE else -1
        total += length if size < 0 else size  # -1: not compressed
    return total


def _root(buffer: bytes) -> int:
    return int(struct.unpack_from("<I", buffer, 0)[0])


def _field(buffer: bytes, table: int, number: int) -> int | None:
    """Return the offset of a table's field; None if the field is absent."""
    vtable = table - struct.unpack_from("<i", buffer, table)[0]
    place = 4 + 2 * number
    if vtable < 0 or place >= struct.unpack_from("<H", buffer, vtable)[0]:
        return None
    offset = struct.unpack_from("<H", buffer, vtable + place)[0]
    return table + offset if offset else None


def _table(buffer: bytes, table: int, number: int) -> int | None:
    at = _field(buffer, table, number)
    return None if at is None else at + int(struct.unpack_from("<I", buffer, at)[0])


def _pairs(buffer: bytes, table: int, number: int) -> IntArray:
    """Read a vector of structs of two int64: (length, nulls) of nodes, (offset, length) of buffers."""
    at = _table(buffer, table, number)
    if at is None:
        return np.empty((0, 2), dtype=np.int64)
    count = struct.unpack_from("<I", buffer, at)[0]
    return np.frombuffer(buffer, dtype="<i8", count=2 * count, offset=at + 4).reshape(-1, 2)
