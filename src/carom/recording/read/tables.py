"""Reads the rows of an entity into a table, chunk by chunk, and checks their types and order.

Only the requested columns are copied out of a chunk, so a table takes no more memory than its rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from carom.errors import DamageError
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.timelines import SIM_TIME, STEP

_MOST_TEXT = 1 << 26  # bytes of all texts in a table; a run logs a few hundred lines


@dataclass(frozen=True, slots=True)
class Column:
    """Type of a component, and number of values in every row."""

    type: pa.DataType
    each: int = 1  # values


SCALARS = {"Scalars:scalars": Column(pa.float64())}
STATES = {"StateChange:state": Column(pa.string())}
EVENTS = {"TextLog:text": Column(pa.string()), "TextLog:level": Column(pa.string()), "kind": Column(pa.string())}
FINGERPRINTS = {"fingerprint": Column(pa.uint64()), "time": Column(pa.float64())}
CHECKPOINT_TIMES = {"time": Column(pa.float64())}
MOMENTA = {
    "momentum": Column(pa.float64(), 3),
    "momentum_error": Column(pa.float64()),
    "angular_momentum": Column(pa.float64(), 3),
    "angular_momentum_error": Column(pa.float64()),
}

_UNORDERED = (paths.EVENTS,)  # events logged at the end of a run are about earlier steps


def table(path: str, chunks: Iterable[Chunk], columns: Mapping[str, Column], optional: Sequence[str] = ()) -> pa.Table:
    """Join the rows of an entity. Components with one value a row become plain columns.

    Parameters
    ----------
    path
        The entity, whose chunks come in the order of their first steps.
    optional
        Columns that older recordings do not have: empty texts then.

    Raises
    ------
    DamageError
        If a row has wrong or missing values, or rows are not in the order of their steps.
    """
    steps: list[NDArray[np.int64]] = []
    times: list[NDArray[np.int64]] = []
    found: dict[str, list[pa.Array]] = {name: [] for name in columns}
    last, text = -(2**63), 0
    for chunk in chunks:
        batch = chunk.batch
        own = np.array(batch[STEP].to_numpy())
        if path not in _UNORDERED and len(own):
            if own[0] <= last or np.any(np.diff(own) <= 0):
                raise DamageError(f"rows of /{path} that are not in the order of their steps")
            last = int(own[-1])
        steps.append(own)
        times.append(np.array(batch[SIM_TIME].cast(pa.int64()).to_numpy()))
        for name, column in columns.items():
            values = optional_text(chunk, name) if name in optional else flat(chunk, name, column)
            text += values.nbytes if pa.types.is_string(column.type) else 0
            if text > _MOST_TEXT:
                raise DamageError(f"more than {_MOST_TEXT} bytes of text at /{path}")
            found[name].append(values)
    joined: dict[str, Any] = {
        STEP: pa.array(np.concatenate([np.empty(0, np.int64), *steps])),
        SIM_TIME: pa.array(np.concatenate([np.empty(0, np.int64), *times])).cast(pa.duration("ns")),
    }
    for name, column in columns.items():
        values = pa.chunked_array(found[name], column.type).combine_chunks()
        joined[name] = values if column.each == 1 else _lists(values, column.each)
    return pa.table(joined)


def optional_text(chunk: Chunk, name: str) -> pa.Array:
    """Copy the texts of a component, "" if older recordings lack it. Raises DamageError if they are not texts."""
    if name not in chunk.components:
        return pa.array([""] * chunk.batch.num_rows, pa.string())
    if chunk.batch[name].type.value_type != pa.string():
        raise DamageError(f"{name} of /{chunk.entity_path} of type {chunk.batch[name].type}")
    return pa.array([(row[0] or "") if row else "" for row in chunk.batch[name].to_pylist()], pa.string())


def flat(chunk: Chunk, name: str, column: Column) -> pa.Array:
    """Copy the values of a component, row after row. Raises DamageError if a row has wrong or missing values."""
    rows = chunk.batch[name]
    if rows.type.value_type != column.type:
        raise DamageError(f"{name} of /{chunk.entity_path} of type {rows.type}")
    values = pc.list_flatten(rows)
    lengths = pc.list_value_length(rows)
    if rows.null_count or values.null_count or pc.any(pc.not_equal(lengths, column.each)).as_py():
        raise DamageError(f"rows of /{chunk.entity_path} that do not have {column.each} values in {name}")
    return values.take(pa.array(np.arange(len(values))))


def _lists(values: pa.Array, each: int) -> pa.ListArray:
    offsets = np.arange(0, len(values) + 1, each, dtype=np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), values)
