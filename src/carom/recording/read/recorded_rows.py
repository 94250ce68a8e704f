"""The recorded rows of single frames."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from carom.recording.read.damage import reading
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.timelines import STEP

_KEPT = 2  # chunks of an entity in memory
BY_EVENT = (paths.PHASE, paths.DT_LIMIT, paths.EVENTS, paths.IMPACTS)  # entities without one row for every frame


class RecordedRows:
    """The rows of a recording by entity and step; a few chunks are kept in memory."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        entries = [entry for entry in recording.store.entries if entry.first_step is not None]
        self._entries = {
            path: [e for e in entries if e.entity_path == path] for path in {e.entity_path for e in entries}
        }
        self._chunks: dict[str, OrderedDict[int, tuple[Chunk, NDArray[np.int64]]]] = {
            path: OrderedDict() for path in self._entries
        }

    @property
    def entities(self) -> list[str]:
        """Entities with rows of frames, by name."""
        return sorted(set(self._entries) - set(BY_EVENT))

    def at(self, path: str, step: int) -> list[Chunk]:
        """Return an entity's rows of a step, each as a chunk of its own: one, if all is well."""
        found = []
        with reading(self._recording.path):
            for number, entry in enumerate(self._entries.get(path, ())):
                if entry.holds(step):
                    chunk, steps = self._chunk(path, number)
                    found += [Chunk(path, chunk.batch.slice(int(row), 1)) for row in np.flatnonzero(steps == step)]
        return found

    def block(self, path: str, wanted: NDArray[np.int64]) -> Chunk | None:
        """Return an entity's rows of some rising steps, if they follow each other in one chunk and nowhere else."""
        first, last = int(wanted[0]), int(wanted[-1])
        entries = enumerate(self._entries.get(path, ()))
        there = [number for number, e in entries if (e.first_step or 0) <= last and (e.last_step or 0) >= first]
        if len(there) != 1:
            return None
        with reading(self._recording.path):
            chunk, steps = self._chunk(path, there[0])
        begin = int(np.searchsorted(steps, first))
        is_block = np.array_equal(steps[begin : begin + len(wanted)], wanted) and not np.any(np.diff(steps) <= 0)
        return Chunk(path, chunk.batch.slice(begin, len(wanted))) if is_block else None

    def steps(self, path: str) -> Iterator[NDArray[np.int64]]:
        """Return the steps that an entity has rows of, chunk by chunk."""
        with reading(self._recording.path):
            for number in range(len(self._entries.get(path, ()))):
                yield self._chunk(path, number)[1]

    def _chunk(self, path: str, number: int) -> tuple[Chunk, NDArray[np.int64]]:
        kept = self._chunks[path]
        if number not in kept:
            (chunk,) = self._recording.chunks([self._entries[path][number]])
            kept[number] = chunk, np.array(chunk.batch[STEP].to_numpy())
            if len(kept) > _KEPT:
                kept.popitem(last=False)
        return kept[number]
