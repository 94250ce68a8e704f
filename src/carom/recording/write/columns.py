"""Columns of a batch: the values of a component, row after row, and how many of them each row has.

Rerun's own columns copy their values, and make offsets for every single value before a column is partitioned. That took
most of the recorder's time, under the interpreter's lock. These wrap the arrays as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sized
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumn

Each = NDArray[np.int64] | int  # values of each row; a number if all have as many
Descriptor = rr.ComponentDescriptor

_VECTOR = pa.list_(pa.field("item", pa.float32(), nullable=False), 3)
_QUATERNION = pa.list_(pa.field("item", pa.float32(), nullable=False), 4)
_STRIP = pa.list_(pa.field("item", _VECTOR, nullable=False))


class Column(ComponentColumn):
    """A component's values; an Arrow array, cut into rows."""

    def __init__(self, descriptor: Descriptor, values: pa.Array, each: Each = 1) -> None:
        self.descriptor = descriptor
        self._rows = pa.ListArray.from_arrays(pa.array(_offsets(each, len(values))), values)

    @classmethod
    def of_rows(cls, descriptor: Descriptor, rows: pa.ListArray) -> Column:
        """Return a column of values that are cut into rows already."""
        column = cls.__new__(cls)
        column.descriptor, column._rows = descriptor, rows
        return column

    def as_arrow_array(self) -> pa.Array:
        """Return one list for each row."""
        return self._rows


def any_column(name: str, values: NDArray[Any] | list[str], each: Each = 1) -> Column:
    """Return a column of a component that Rerun does not know."""
    return Column(Descriptor(name), pa.array(values), each)


def any_values(values: Mapping[str, Any]) -> rr.AnyValues:
    """Return values under names that Rerun does not know; texts and lists that are empty are left out.

    Each gets its type here. Rerun keeps the first type that a name has in a process and refuses any other, so a sweep
    over 0.1 and "auto" would fail.
    """
    given = {name: value for name, value in values.items() if not (isinstance(value, Sized) and len(value) == 0)}
    many = list, tuple, np.ndarray
    arrays = {name: pa.array(value if isinstance(value, many) else [value]) for name, value in given.items()}
    return rr.AnyValues(True, **arrays)


def plain_column(descriptor: Descriptor, values: NDArray[Any], each: Each = 1) -> Column:
    """Return a column of plain numbers, such as colours, radii or scalars."""
    return Column(descriptor, pa.array(values), each)


def vector_column(descriptor: Descriptor, values: NDArray[np.float32], each: Each = 1) -> Column:
    """Return a column of vectors, (m, 3), or of quaternions, (m, 4)."""
    kind = _VECTOR if values.shape[1] == 3 else _QUATERNION
    return Column(descriptor, pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), type=kind), each)


def line_column(ends: NDArray[np.float32], each: Each) -> Column:
    """Return a column of lines by the coordinates of their ends, (m, 6). Rerun's own conversion is a loop in Python."""
    points = pa.FixedSizeListArray.from_arrays(pa.array(ends.ravel()), type=_VECTOR)
    strips = pa.ListArray.from_arrays(pa.array(_offsets(2, len(points))), points, type=_STRIP)
    return Column(rr.LineStrips3D.descriptor_strips(), strips, each)


def _offsets(each: Each, count: int) -> NDArray[np.int32]:
    """Return where each row begins, and the end of the last one."""
    if isinstance(each, int):
        return np.arange(0, count + 1, each, dtype=np.int32)
    found = np.zeros(len(each) + 1, dtype=np.int32)
    np.cumsum(each, out=found[1:])
    return found
