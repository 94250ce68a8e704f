"""The types of arrays, for annotations; comments at each use give the shapes.

A type of records is a Protocol with annotated fields, from which `dtype_of` makes NumPy's type. Kernels name the
Protocol in their annotations, so that mypy refuses a field that does not exist.
"""

from __future__ import annotations

from typing import Any, Protocol, SupportsIndex, TypeVar, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]  # drawn values
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
BoolArray = NDArray[np.bool_]
ColourArray = NDArray[np.uint32]  # 0xRRGGBBAA
Records = NDArray[np.void]  # structured arrays, with a row for each contact, plane or body

Record_co = TypeVar("Record_co", covariant=True)


class RecordArray(Protocol[Record_co]):
    """An array of records of one type, such as ``RecordArray[ContactRecord]``; Python may use columns by name."""

    @property
    def dtype(self) -> np.dtype[Any]: ...  # noqa: D102 - as of NumPy

    def __len__(self) -> int: ...

    @overload
    def __getitem__(self, row: SupportsIndex, /) -> Record_co: ...

    @overload
    def __getitem__(self, field: str, /) -> NDArray[Any]: ...

    def __setitem__(self, field: str, values: Any, /) -> None: ...


def dtype_of(record: type, size: int | None = None) -> np.dtype[np.void]:
    """Return the type of records whose fields are the annotations of a class, in their order.

    A field is a float, an int or a bool, or names another type of NumPy, as ``Annotated[int, np.uint8]`` does.

    Parameters
    ----------
    record
        A Protocol; the fields of its last base come first.
    size
        Bytes from one record to the next (default: as few as the fields need).
    """
    hints = get_type_hints(record, include_extras=True)
    packed = np.dtype([(name, getattr(kind, "__metadata__", (kind,))[0]) for name, kind in hints.items()], align=True)
    if size is None:
        return packed
    assert packed.fields is not None and packed.names is not None
    kinds, offsets = zip(*(packed.fields[name][:2] for name in packed.names), strict=True)
    return np.dtype({"names": packed.names, "formats": kinds, "offsets": offsets, "itemsize": size}, align=True)
