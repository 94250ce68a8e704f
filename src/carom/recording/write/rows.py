"""`Rows`: one entity's part of a batch, as Rerun's `send_columns` takes it, and the size of its arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rerun import ComponentColumn

from carom.physics.frame import Frame
from carom.recording.write.columns import Column

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_INDEX_BYTES = 16  # a row's step and simulated time
_NO_NUMBERS, _NO_TIMES = np.empty(0, dtype=np.int64), np.empty(0)


class Index(NamedTuple):
    """Where rows stand on the timelines. The entities of a batch share it."""

    steps: IntArray  # empty where the rows are within a step, or on the timeline of impacts only
    times: FloatArray  # s
    impacts: IntArray = _NO_NUMBERS  # numbers of impacts, where the rows are on their timeline

    @classmethod
    def of(cls, frames: Sequence[Frame]) -> Index:
        """Return an index with a row for each frame."""
        return cls(np.array([frame.step for frame in frames]), np.array([frame.time for frame in frames]))

    @classmethod
    def within_step(cls, time: float) -> Index:
        """Return an index of one row at a time (s) within a step, which is not on the timeline of steps."""
        return cls(_NO_NUMBERS, np.array([time]))

    @classmethod
    def of_impacts(cls, numbers: IntArray) -> Index:
        """Return an index of rows that are on the timeline of impacts only."""
        return cls(_NO_NUMBERS, _NO_TIMES, numbers)


@dataclass(frozen=True, slots=True)
class Rows:
    """One entity's rows of a batch."""

    path: str
    index: Index
    columns: Iterable[ComponentColumn]
    bytes: int  # of the arrays in it, indices included

    @property
    def steps(self) -> IntArray:
        """The steps of the rows; none where they are on the timeline of impacts only."""
        return self.index.steps


def frame_rows(path: str, index: Index, columns: Iterable[ComponentColumn], size: int) -> Rows:
    """Return one row for each frame."""
    return Rows(path, index, columns, size + _INDEX_BYTES * len(index.steps))


def kind_of(rows: Rows) -> tuple[str, bool, bool, tuple[str, ...]]:
    """Return what rows must have in common to be joined: entity, timelines and components."""
    names = tuple(str(column.component_descriptor()) for column in rows.columns)
    return rows.path, len(rows.index.steps) > 0, len(rows.index.impacts) > 0, names


def joined(batches: Sequence[Rows]) -> Rows:
    """Return the rows of several batches, which are of one kind, as one batch."""
    first = batches[0]
    if len(batches) == 1:
        return first
    columns = [
        Column.of_rows(same[0].component_descriptor(), pa.concat_arrays([one.as_arrow_array() for one in same]))
        for same in zip(*(rows.columns for rows in batches), strict=True)
    ]
    index = Index(*(np.concatenate(arrays) for arrays in zip(*(rows.index for rows in batches), strict=True)))
    return Rows(first.path, index, columns, sum(rows.bytes for rows in batches))


def array_bytes(*arrays: NDArray[np.generic] | None) -> int:
    """Return the bytes of arrays, as far as there are any."""
    return sum(array.nbytes for array in arrays if array is not None)
