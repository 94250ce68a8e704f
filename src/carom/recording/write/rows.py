"""`Rows`: one entity's part of a batch, as Rerun's `send_columns` takes it, and the size of its arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumnList

from carom.physics.frame import Frame

_INDEX_BYTES = 16  # a row's step and simulated time


@dataclass(frozen=True, slots=True)
class Rows:
    """One entity's rows of a batch."""

    path: str
    steps: Sequence[int]  # empty where the rows are on the timeline of impacts only
    times: Sequence[float]  # s
    columns: ComponentColumnList
    bytes: int  # of the arrays in it, indices included
    impacts: Sequence[int] = ()  # numbers of impacts, where the rows are on their timeline


def frame_rows(path: str, frames: Sequence[Frame], columns: ComponentColumnList, size: int) -> Rows:
    """Return one row for each frame."""
    steps, times = [frame.step for frame in frames], [frame.time for frame in frames]
    return Rows(path, steps, times, columns, size + _INDEX_BYTES * len(frames))


def any_column(name: str, array: NDArray[np.generic] | list[str]) -> ComponentColumnList:
    """Make a column of any type. As an Arrow array: a NumPy array would be walked value by value, in Python."""
    return rr.AnyValues.columns(True, **{name: pa.array(array)})


def single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Round to float32; what is too large for it becomes infinite, as where kernels cast positions."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def array_bytes(*arrays: NDArray[np.generic] | None) -> int:
    """Return the bytes of arrays, as far as there are any."""
    return sum(array.nbytes for array in arrays if array is not None)
