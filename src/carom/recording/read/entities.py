"""The entities of a recording, read chunk by chunk from its file.

`reading` replaces every error by one sentence that names the file and the remedy. `join_rows` makes tables and checks
types and order. Only the requested columns are copied from a chunk, so a table needs no more memory than its rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from carom.errors import DamageError, RecordingError
from carom.recording.rrd.container import Container
from carom.recording.rrd.framing import looks_recorded
from carom.recording.rrd.messages import BLUEPRINT, Chunk, Entry, Store, release_memory
from carom.recording.schema import paths
from carom.recording.schema.properties import checked
from carom.recording.timelines import SIM_TIME, STEP
from carom.scene.wording import command

# Exceptions that wrong names, types or lengths in a file raise.
_SURPRISES = (
    *(LookupError, ValueError, TypeError, AttributeError, ArithmeticError, MemoryError, RecursionError),
    pa.ArrowException,
)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Replace the exceptions of the context by a RecordingError that names the file and the remedy."""
    try:
        yield
    except DamageError as error:
        raise RecordingError(_damaged(path, str(error))) from error
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    except _SURPRISES as error:
        raise RecordingError(_damaged(path, f"{type(error).__name__}: {error}".splitlines()[0])) from error


def _damaged(path: Path, reason: str) -> str:
    if not looks_recorded(path):
        if path.suffix == ".toml":
            return f"{path} is a scene, not a recording; `{command('run', path)}` records it"
        return f"{path} is not a recording ({reason})"
    advice = f"`{command('repair', path)}` recovers the readable data"
    return f"{path} is not a recording, or is damaged ({reason}); {advice}"


_MOST_TEXT = 1 << 26  # largest size of all texts in a table, in bytes; a run logs a few hundred lines


@dataclass(frozen=True, slots=True)
class Column:
    """Type of a component, and number of values in every row."""

    type: pa.DataType
    each: int = 1  # number of values in each row


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

_UNORDERED = (paths.EVENTS,)  # events logged at the end of a run belong to earlier steps


def join_rows(path: str, chunks: Iterable[Chunk], columns: Mapping[str, Column]) -> pa.Table:
    """Join the rows of an entity. Components with one value per row become plain columns.

    Chunks are in the order of their first steps. Raises DamageError if a row has wrong or missing values, or if rows
    are not in the order of their steps.
    """
    steps, times = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    found: dict[str, list[pa.Array]] = {name: [] for name in columns}
    last, text = -(2**63), 0
    for chunk in chunks:
        batch = chunk.batch
        own = np.array(batch[STEP].to_numpy())
        if path not in _UNORDERED and len(own):
            if own[0] <= last or np.any(np.diff(own) <= 0):
                raise DamageError(f"rows of /{path} that are not sorted by step")
            last = int(own[-1])
        steps.append(own)
        times.append(np.array(batch[SIM_TIME].cast(pa.int64()).to_numpy()))
        for name, column in columns.items():
            values = flat(chunk, name, column)
            text += values.nbytes if pa.types.is_string(column.type) else 0
            if text > _MOST_TEXT:
                raise DamageError(f"more than {_MOST_TEXT} bytes of text at /{path}")
            found[name].append(values)
    joined: dict[str, Any] = {
        STEP: pa.array(np.concatenate(steps)),
        SIM_TIME: pa.array(np.concatenate(times)).cast(pa.duration("ns")),
    }
    for name, column in columns.items():
        values = pa.chunked_array(found[name], column.type).combine_chunks()
        if column.each > 1:
            offsets = pa.array(np.arange(0, len(values) + 1, column.each, dtype=np.int32))
            values = pa.ListArray.from_arrays(offsets, values)
        joined[name] = values
    return pa.table(joined)


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


def plain(values: pa.Array) -> pa.Array:
    """Return the values of lists, or of lists of lists, one after another."""
    while pa.types.is_nested(values.type):
        values = values.flatten()
    return values


def centres_of(chunk: Chunk) -> pa.ListArray | None:
    """Return the centres of the drawn bodies, a list for each row; None if the chunk lacks them."""
    return next((chunk.batch[name] for name in paths.CENTRES if name in chunk.components), None)


Values = NDArray[Any] | list[str]


class Entities:
    """Reads the entities of a store: a recording in a container."""

    def __init__(self, container: Container, store: Store) -> None:
        self._container = container
        self._store = store

    def read(self, entries: Iterable[Entry]) -> Iterator[Chunk]:
        """Read chunks one by one, unchanged."""
        with reading(self._container.path):
            yield from self._container.chunks(entries)

    def below(self, root: str) -> dict[str, str]:
        """Return the paths of the temporal entities below an entity, by their last parts."""
        changing = {entry.entity_path for entry in self._store.entries if not entry.is_static}
        return {path.rsplit("/", 1)[1]: path for path in sorted(changing) if path.startswith(f"{root}/")}

    def layout(self) -> list[Chunk]:
        """Read the chunks of the layout with which the file opens; empty if there is none."""
        layouts = [store for store in self._container.stores if store.kind == BLUEPRINT and store.entries]
        return list(self.read(layouts[-1].entries)) if layouts else []

    def table(self, path: str, columns: Mapping[str, Column]) -> pa.Table:
        """Return the rows of an entity as a table of these columns."""
        return join_rows(path, self.chunks(path), columns)

    def chunks(self, path: str, component: str | None = None) -> Iterator[Chunk]:
        """Read an entity's chunks of steps in order; given a component, only the chunks that have it."""
        for chunk in self.read(self._store.frames_of(path)):
            if component is None or component in chunk.components:
                yield chunk

    def static(self, path: str, required: bool = True) -> dict[str, Values]:
        """Read the components of a static entity: arrays, or lists of texts."""
        found: dict[str, Values] = {}
        for chunk in self.read([e for e in self._store.entries if e.is_static and e.entity_path == path]):
            if chunk.batch.num_rows != 1:
                raise DamageError(f"{chunk.batch.num_rows} rows of /{path}, which is recorded once for all times")
            found |= {name: values_of(chunk.batch[name][0]) for name in chunk.components}
            del chunk
        release_memory()
        if not found and required:
            raise RecordingError(f"{self._container.path} has no /{path}: it ended before the first frame was written")
        return found

    def properties(self, name: str) -> dict[str, Any]:
        """Return a property of the recording, by the names of its values; empty if there is none."""
        stored = self.static(f"__properties/{name}", required=False)
        lists = {key: list(values) if isinstance(values, list) else values.tolist() for key, values in stored.items()}
        return checked(name, {key: values[0] if len(values) == 1 else values for key, values in lists.items()})


def values_of(row: pa.ListScalar) -> Values:
    """Copy one row of a component: an array, or a list of texts. DamageError if a value is missing."""
    values = row.values
    if values is None or values.null_count:
        raise DamageError("a row without its values")
    if pa.types.is_string(values.type):
        return list(values.to_pylist())
    return np.array(plain(values).to_numpy(zero_copy_only=False))
