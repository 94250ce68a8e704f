"""`Entities`: the entities of a recording, read chunk by chunk from its file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.errors import DamageError, RecordingError
from carom.recording.read import tables
from carom.recording.read.damage import reading
from carom.recording.read.tables import Column
from carom.recording.rrd.arrow_stream import release_memory
from carom.recording.rrd.index import Container
from carom.recording.rrd.messages import BLUEPRINT, Chunk, Entry, Store
from carom.recording.schema.properties import checked

Values = NDArray[Any] | list[str]

_PROPERTIES = "__properties"


class Entities:
    """Reads the entities of a store.

    Parameters
    ----------
    container
        The file.
    store
        One of its recordings.
    """

    def __init__(self, container: Container, store: Store) -> None:
        self._container = container
        self._store = store

    def read(self, entries: Iterable[Entry]) -> Iterator[Chunk]:
        """Read chunks one by one, unchanged."""
        with reading(self._container.path):
            yield from self._container.chunks(entries)

    def below(self, root: str) -> dict[str, str]:
        """Return the paths of what changes with time below an entity, by their last parts."""
        changing = {entry.entity_path for entry in self._store.entries if not entry.is_static}
        return {path.rsplit("/", 1)[1]: path for path in sorted(changing) if path.startswith(f"{root}/")}

    def layout(self) -> list[Chunk]:
        """Read the chunks of the layout that the file opens with; empty if there is none."""
        layouts = [store for store in self._container.stores if store.kind == BLUEPRINT and store.entries]
        return list(self.read(layouts[-1].entries)) if layouts else []

    def table(self, path: str, columns: Mapping[str, Column], optional: Sequence[str] = ()) -> pa.Table:
        """Return the rows of an entity as a table of these columns."""
        return tables.table(path, self.chunks(path), columns, optional)

    def chunks(self, path: str, component: str | None = None) -> Iterator[Chunk]:
        """Read an entity's chunks in order; with a component, those that have it."""
        found = [entry for entry in self._store.entries if not entry.is_static and entry.entity_path == path]
        for chunk in self.read(sorted(found, key=lambda entry: entry.first_step or 0)):
            if component is None or component in chunk.components:
                yield chunk

    def chunks_at(self, step: int, path: str) -> Iterator[Chunk]:
        """Read those chunks of an entity that a step may be in."""
        found = [entry for entry in self._store.entries if entry.entity_path == path and entry.holds(step)]
        return self.read(found)

    def static(self, path: str, required: bool = True) -> dict[str, Values]:
        """Read the components of a static entity: arrays, or lists of texts."""
        found: dict[str, Values] = {}
        for chunk in self.read([e for e in self._store.entries if e.is_static and e.entity_path == path]):
            if chunk.batch.num_rows != 1:
                raise DamageError(f"{chunk.batch.num_rows} rows of /{path}, which holds for all times")
            found |= {name: values_of(chunk.batch[name][0]) for name in chunk.components}
            del chunk
        release_memory()
        if not found and required:
            raise RecordingError(f"{self._container.path} has no /{path}: it ended before the first frame was written")
        return found

    def properties(self, name: str) -> dict[str, Any]:
        """Return a property of the recording, by the names of its values; empty if there is none."""
        stored = self.static(f"{_PROPERTIES}/{name}", required=False)
        lists = {key: list(values) if isinstance(values, list) else values.tolist() for key, values in stored.items()}
        return checked(name, {key: values[0] if len(values) == 1 else values for key, values in lists.items()})


def values_of(row: pa.ListScalar) -> Values:
    """Copy one row of a component: an array, or a list of texts. DamageError if a value is missing."""
    values = row.values
    if values is None or values.null_count:
        raise DamageError("a row without its values")
    if pa.types.is_string(values.type):
        return list(values.to_pylist())
    while pa.types.is_nested(values.type):
        values = values.flatten()
    return np.array(values.to_numpy(zero_copy_only=False))
