"""Arrays aligned to cache lines, so that each row or record occupies as few lines as possible."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.arrays import FloatArray, IntArray, RecordArray, Records

CACHE_LINE = 64  # bytes


def aligned_empty(count: int, dtype: Any = np.float64, columns: int | None = None) -> NDArray[Any]:
    """Return an uninitialised array, (count,) or (count, columns), aligned to a cache line."""
    kind = np.dtype(dtype)
    size = count * kind.itemsize * (1 if columns is None else columns)
    buffer = np.empty(size + CACHE_LINE, dtype=np.uint8)
    first = -buffer.ctypes.data % CACHE_LINE
    flat: NDArray[Any] = buffer[first : first + size].view(kind)
    return flat if columns is None else flat.reshape(count, columns)


class Buffer:
    """A buffer that is kept from step to step; freeing and allocating it again would cost page faults."""

    def __init__(self, dtype: Any = np.float64, columns: int | None = None) -> None:
        self._dtype = dtype
        self._columns = columns
        self._rows = aligned_empty(0, dtype, columns)
        self._taken = self._rows

    def take(self, count: int) -> NDArray[Any]:
        """Return `count` uninitialised rows; earlier views become invalid."""
        if count != len(self._taken):
            if count > len(self._rows):
                self._rows = aligned_empty(count + count // 4, self._dtype, self._columns)
            self._taken = self._rows[:count]
        return self._taken

    @property
    def whole(self) -> NDArray[Any]:
        """All rows that are allocated."""
        return self._rows

    def holds(self, taken: Any) -> bool:
        """Return whether rows are a view of this buffer."""
        return taken.base is self._rows.base


def raw(records: RecordArray[object]) -> Records:
    """Return contiguous records as bytes, without a copy.

    NumPy would copy fields one by one, which takes 100 times as long.
    """
    array: Records = np.asarray(records)
    return array.view(np.dtype((np.void, array.dtype.itemsize)))


def words(records: RecordArray[object]) -> IntArray:
    """Return a view of contiguous records as words of eight bytes."""
    return raw(records).view(np.int64)


def joined(parts: Iterable[RecordArray[object]], kind: np.dtype[np.void]) -> Records:
    """Return the concatenation of several arrays of contiguous records."""
    found: Records = np.concatenate([raw(np.empty(0, kind)), *map(raw, parts)]).view(kind)
    return found


def picked(records: RecordArray[object], places: IntArray) -> Records:
    """Return a copy of selected contiguous records."""
    return raw(records)[places].view(records.dtype)


def columns(records: RecordArray[object], names: tuple[str, ...]) -> FloatArray:
    """Return a view, (m, k), of numeric fields that are adjacent in a record."""
    kind, offset = _place_of(records.dtype, names)
    numbers: FloatArray = np.asarray(records).getfield(kind, offset)
    return numbers


@cache
def _place_of(kind: np.dtype[np.void], names: tuple[str, ...]) -> tuple[np.dtype[Any], int]:
    """Return one type that spans all these fields, and their offset (bytes) in a record."""
    assert kind.fields is not None and kind.names is not None
    first = kind.names.index(names[0])
    assert kind.names[first : first + len(names)] == names, "the fields are adjacent and in this order"
    return np.dtype((np.float64, len(names))), kind.fields[names[0]][1]
