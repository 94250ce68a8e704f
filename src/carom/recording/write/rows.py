"""`Rows`: one entity's part of a batch, in the form that Rerun's `send_columns` accepts, and its columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Sized
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumn

from carom.arrays import FloatArray, Int32Array, IntArray, SingleArray
from carom.event import Event
from carom.recording.read.entities import plain
from carom.recording.schema import paths
from carom.recording.schema.header import TimeScale
from carom.recording.timelines import IMPACT, SIM_TIME, STEP
from carom.state.frame import Frame

# Columns of a batch: the values of a component, row after row, and their number in each row. The columns below wrap the
# arrays without a copy. Rerun's own columns copy their values, and compute an offset for every single value before a
# column is partitioned. That took most of the recorder's time, and held the interpreter lock.

Each = IntArray | int  # number of values in each row; a single number if it is the same for all rows
Descriptor = rr.ComponentDescriptor

_VECTOR = pa.list_(pa.field("item", pa.float32(), nullable=False), 3)
_QUATERNION = pa.list_(pa.field("item", pa.float32(), nullable=False), 4)
_STRIP = pa.list_(pa.field("item", _VECTOR, nullable=False))


class BatchColumn(ComponentColumn):
    """A component's values: an Arrow array, divided into rows."""

    def __init__(self, descriptor: Descriptor, values: pa.Array, each: Each = 1) -> None:
        self.descriptor = descriptor
        self._rows = pa.ListArray.from_arrays(pa.array(_offsets(each, len(values))), values)

    @classmethod
    def of_rows(cls, descriptor: Descriptor, rows: pa.ListArray) -> ComponentColumn:
        """Return a column of values that are already divided into rows."""
        column = cls.__new__(cls)
        column.descriptor, column._rows = descriptor, rows
        return column

    def as_arrow_array(self) -> pa.Array:
        """Return one list for each row."""
        return self._rows


def any_column(name: str, values: NDArray[Any] | list[str], each: Each = 1) -> ComponentColumn:
    """Return a column of a component that is unknown to Rerun."""
    return BatchColumn(Descriptor(name), pa.array(values), each)


def any_values(values: Mapping[str, Any]) -> rr.AnyValues:
    """Return values under names that Rerun does not know; empty texts and lists are left out.

    The type of each value is set here. Rerun keeps the first type that a name has in a process and refuses any other,
    so a sweep over the values 0.1 and "auto" would fail.
    """
    given = {name: value for name, value in values.items() if not (isinstance(value, Sized) and len(value) == 0)}
    many = list, tuple, np.ndarray
    arrays = {name: pa.array(value if isinstance(value, many) else [value]) for name, value in given.items()}
    return rr.AnyValues(True, **arrays)


def plain_column(descriptor: Descriptor, values: NDArray[Any], each: Each = 1) -> ComponentColumn:
    """Return a column of plain numbers, such as colours, radii or scalars."""
    return BatchColumn(descriptor, pa.array(values), each)


def vector_column(descriptor: Descriptor, values: SingleArray, each: Each = 1) -> ComponentColumn:
    """Return a column of vectors, (m, 3), or of quaternions, (m, 4)."""
    kind = _VECTOR if values.shape[1] == 3 else _QUATERNION
    return BatchColumn(descriptor, pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), type=kind), each)


def line_column(ends: SingleArray, each: Each) -> ComponentColumn:
    """Return a column of lines by the coordinates of their ends, (m, 6). Rerun's own conversion is a loop in Python."""
    points = pa.FixedSizeListArray.from_arrays(pa.array(ends.ravel()), type=_VECTOR)
    strips = pa.ListArray.from_arrays(pa.array(_offsets(2, len(points))), points, type=_STRIP)
    return BatchColumn(rr.LineStrips3D.descriptor_strips(), strips, each)


def _offsets(each: Each, count: int) -> Int32Array:
    """Return the index at which each row begins, and the end of the last row."""
    if isinstance(each, int):
        return np.arange(0, count + 1, each, dtype=np.int32)
    found = np.zeros(len(each) + 1, dtype=np.int32)
    np.cumsum(each, out=found[1:])
    return found


NO_STEPS, NO_TIMES = np.empty(0, dtype=np.int64), np.empty(0)


class Index(NamedTuple):
    """Positions of rows on the timelines; the entities of a batch share an index."""

    steps: IntArray  # steps of the rows; empty for rows within a step, and for rows on the timeline of impacts only
    times: FloatArray  # s
    impacts: IntArray = NO_STEPS  # numbers of impacts, if the rows are on the timeline of impacts
    # s, times of the next frames, for rows within a step; each row must lie at least a nanosecond before its frame
    ends: FloatArray = NO_TIMES

    @classmethod
    def of(cls, frames: Sequence[Frame]) -> Index:
        """Return an index with a row for each frame."""
        return cls(np.array([frame.step for frame in frames]), np.array([frame.time for frame in frames]))

    @classmethod
    def within_step(cls, time: float) -> Index:
        """Return an index of a single row at a time (s) within a step; the index has no step."""
        return cls(NO_STEPS, np.array([time]))


def time_columns(
    clock: TimeScale,
    steps: Sequence[int] | IntArray,
    times: Sequence[float] | FloatArray,
    impacts: Sequence[int] | IntArray = (),
    ends: FloatArray | None = None,
) -> list[rr.TimeColumn]:
    """Return the time columns of a batch: steps, times (s) and numbers of impacts, each if it is given; see `Index`."""
    columns = [rr.TimeColumn(STEP, sequence=steps)] if len(steps) else []
    if len(times):
        shown = clock.within(np.asarray(times), ends)
        columns.append(rr.TimeColumn(SIM_TIME, duration=shown.astype("timedelta64[ns]")))
    return [*columns, rr.TimeColumn(IMPACT, sequence=impacts)] if len(impacts) else columns


@dataclass(frozen=True, slots=True)
class Rows:
    """One entity's rows of a batch."""

    path: str
    index: Index
    columns: Iterable[ComponentColumn]

    @property
    def steps(self) -> IntArray:
        """The steps of the rows; empty if the rows are not on the timeline of steps."""
        return self.index.steps

    @property
    def bytes(self) -> int:
        """Bytes of all values, and of the positions of the rows on the timelines."""
        values: list[int] = [plain(column.as_arrow_array()).nbytes for column in self.columns]
        return self._bytes_of_positions + sum(values)

    @property
    def compressed_bytes(self) -> int:
        """Bytes that the rows take in a file, in which Rerun compresses the values."""
        size = self._bytes_of_positions
        for column in self.columns:
            for buffer in filter(None, plain(column.as_arrow_array()).buffers()):
                size += min(buffer.size, len(pa.compress(buffer, codec="lz4", asbytes=True)))
        return size

    @property
    def _bytes_of_positions(self) -> int:
        steps, times, impacts, _ = self.index
        return steps.nbytes + times.nbytes + impacts.nbytes


def kind_of(rows: Rows) -> tuple[str, bool, bool, bool, tuple[str, ...]]:
    """Return the properties that rows must share to be joined: entity, timelines and components."""
    names = tuple(str(column.component_descriptor()) for column in rows.columns)
    steps, times, impacts, _ = (len(values) > 0 for values in rows.index)
    return rows.path, steps, times, impacts, names


def joined(batches: Sequence[Rows]) -> Rows:
    """Join the rows of several batches of the same kind into one batch."""
    first = batches[0]
    if len(batches) == 1:
        return first
    columns = [
        BatchColumn.of_rows(same[0].component_descriptor(), pa.concat_arrays([one.as_arrow_array() for one in same]))
        for same in zip(*(rows.columns for rows in batches), strict=True)
    ]
    index = Index(*(np.concatenate(arrays) for arrays in zip(*(rows.index for rows in batches), strict=True)))
    return Rows(first.path, index, columns)


def state_rows(path: str, index: Index, states: Sequence[str]) -> Rows:
    """Return one row for each change of a state, such as the phase."""
    return Rows(path, index, list(rr.StateChange.columns(state=states)))


def event_rows(events: Sequence[Event]) -> Rows:
    """Return one row of the log for each event."""
    log = rr.TextLog.columns(text=[e.text for e in events], level=[e.level for e in events])
    columns = [*log, any_column("kind", [e.kind for e in events])]
    index = Index(np.array([e.step for e in events]), np.array([e.time for e in events]))
    return Rows(paths.EVENTS, index, columns)
