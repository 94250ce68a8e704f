"""Reads from FlatBuffers metadata how much data an Arrow record batch claims to hold, before it is built."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.recording.errors import DamageError

_HEADER = 2  # field of a Message: its RecordBatch
_LENGTH, _NODES, _BUFFERS, _COMPRESSION = 0, 1, 2, 3  # fields of a RecordBatch


@dataclass(frozen=True, slots=True)
class Claims:
    """The size that a record batch claims to have."""

    rows: int
    lengths: NDArray[np.int64]  # of each array and of each child of one
    buffer_bytes: int  # summed over all buffers
    compressed: bool  # its buffers are compressed and state their uncompressed sizes themselves


def claims(message: bytes) -> Claims:
    """Read the metadata of an Arrow IPC message that holds a record batch.

    Raises
    ------
    DamageError
        If the metadata are incomplete.
    """
    try:
        batch = _table(message, _root(message), _HEADER)
        if batch is None:
            raise DamageError("a record batch without a header")
        rows = _field(message, batch, _LENGTH)
        return Claims(
            rows=0 if rows is None else struct.unpack_from("<q", message, rows)[0],
            lengths=_pairs(message, batch, _NODES)[:, 0],
            buffer_bytes=sum(_pairs(message, batch, _BUFFERS)[:, 1].tolist()),
            compressed=_field(message, batch, _COMPRESSION) is not None,
        )
    except (struct.error, ValueError) as error:
        raise DamageError("a record batch with an incomplete header") from error


def _root(buffer: bytes) -> int:
    return int(struct.unpack_from("<I", buffer, 0)[0])


def _field(buffer: bytes, table: int, number: int) -> int | None:
    """Return the offset of a field of a table; None if it is absent."""
    vtable = table - struct.unpack_from("<i", buffer, table)[0]
    place = 4 + 2 * number
    if vtable < 0 or place >= struct.unpack_from("<H", buffer, vtable)[0]:
        return None
    offset = struct.unpack_from("<H", buffer, vtable + place)[0]
    return table + offset if offset else None


def _table(buffer: bytes, table: int, number: int) -> int | None:
    at = _field(buffer, table, number)
    return None if at is None else at + int(struct.unpack_from("<I", buffer, at)[0])


def _pairs(buffer: bytes, table: int, number: int) -> NDArray[np.int64]:
    """Read a vector of structs of two int64: (length, nulls) of nodes, (offset, length) of buffers."""
    at = _table(buffer, table, number)
    if at is None:
        return np.empty((0, 2), dtype=np.int64)
    count = struct.unpack_from("<I", buffer, at)[0]
    return np.frombuffer(buffer, dtype="<i8", count=2 * count, offset=at + 4).reshape(-1, 2)
