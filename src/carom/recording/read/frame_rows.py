"""Single frames of a recording: positions, paths, rows of any entity, and the frames that a resumed run copies."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from carom.arrays import FloatArray, IntArray, SingleArray
from carom.errors import DamageError, RecordingError
from carom.recording.read.entities import EVENTS, centres_of, flat, plain, reading
from carom.recording.read.recorded_impacts import RecordedImpacts, count_at, impacts_until
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk, Entry
from carom.recording.schema import paths
from carom.recording.schema.header import TimeScale
from carom.recording.schema.paths import CLOSING
from carom.recording.timelines import IMPACT, STEP
from carom.state.checkpoint import Checkpoint

_KEPT = 3  # largest number of an entity's chunks in memory; neighbouring frames may be in different chunks


class RecordedRows:
    """The rows of a recording by entity and step; a few chunks of each entity are kept in memory."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._entries: dict[str, list[Entry]] = {}
        for entry in recording.store.entries:
            if entry.first_step is not None:
                self._entries.setdefault(entry.entity_path, []).append(entry)
        self._chunks: dict[str, OrderedDict[int, tuple[Chunk, IntArray]]] = {p: OrderedDict() for p in self._entries}

    def at(self, path: str, step: int) -> list[Chunk]:
        """Return an entity's rows at a step, each as a separate chunk; an intact recording has one row."""
        found = []
        with reading(self._recording.path):
            for entry in self._entries.get(path, ()):
                if entry.overlaps(step, step):
                    chunk, steps = self._chunk(entry)
                    found += [Chunk(path, chunk.batch.slice(int(row), 1)) for row in np.flatnonzero(steps == step)]
        return found

    def _chunk(self, entry: Entry) -> tuple[Chunk, IntArray]:
        kept = self._chunks[entry.entity_path]
        if entry.offset not in kept:
            (chunk,) = self._recording.chunks([entry])
            kept[entry.offset] = chunk, np.array(chunk.batch[STEP].to_numpy())
            if len(kept) > _KEPT:
                kept.popitem(last=False)
        return kept[entry.offset]


class RecordedPositions:
    """Positions (n, 3) in m: drawn positions, or exact positions at checkpoints; NaN for bodies that do not exist."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self._shown = recording, recording.shown
        self._rows = RecordedRows(recording)

    def drawn(self, step: int) -> FloatArray:
        """Return the drawn positions (float32) of the bodies that the recording shows."""
        with reading(self._recording.path):
            for chunk in self._rows.at(paths.BODIES, step):
                if (centres := centres_of(chunk)) is not None:
                    return _values(centres).reshape(len(self._shown), 3) + self._recording.origin
        raise RecordingError(f"{self._recording.path} has no positions at step {step}: part of the file is missing")

    def exact(self, step: int) -> FloatArray | None:
        """Return the exact positions of the bodies that the recording shows; None without a checkpoint."""
        with reading(self._recording.path):
            for chunk in self._rows.at(paths.CHECKPOINT, step):
                position = _values(chunk.batch["position"]).reshape(-1, 3)
                if self._recording.lives is not None and "present" in chunk.components:
                    existing, position = position, np.full((len(self._recording.lives), 3), np.nan)
                    position[_values(chunk.batch["present"]).astype(np.int64)] = existing
                return position[self._shown]
        return None


def _values(column: pa.Array) -> FloatArray:
    return np.asarray(plain(column).to_numpy(), dtype=np.float64)


def arrow_floors(recording: Recording, step: int) -> dict[str, float]:
    """Return the magnitudes below which arrows are not drawn in the frame of a step, by the entity of the arrows."""
    rows = RecordedRows(recording)
    with reading(recording.path):
        found = {path: chunk for path in paths.WITH_FLOOR for chunk in rows.at(path, step)}
        floors = {path: _values(c.batch[paths.FLOOR]) for path, c in found.items() if paths.FLOOR in c.components}
        return {path: float(values[0]) for path, values in floors.items() if len(values)}


class DrawnPaths(NamedTuple):
    """Drawn positions and orientations of some bodies in all frames."""

    steps: IntArray  # (k,)
    position: SingleArray  # (k, b, 3) m from the recording's origin
    orientation: SingleArray | None  # (k, b, 4) xyzw, orientations; None if none are recorded


def drawn_paths(recording: Recording, places: Sequence[int]) -> DrawnPaths:
    """Read the paths of selected bodies, given by their indices among the bodies that the recording shows."""
    steps, positions, turns = [], [], []
    n, chosen = len(recording.shown), list(places)
    with reading(recording.path):
        for chunk in recording.chunks(recording.store.frames_of(paths.BODIES)):
            rows, centres = chunk.batch.num_rows, centres_of(chunk)
            if centres is None:
                continue
            steps.append(chunk.batch[STEP].to_numpy())
            positions.append(_numbers(centres).reshape(rows, n, 3)[:, chosen])
            turned = next((name for name in chunk.components if name.endswith(":quaternions")), None)
            if turned is not None:
                turns.append(_numbers(chunk.batch[turned]).reshape(rows, n, 4)[:, chosen])
    if not steps:
        raise RecordingError(f"{recording.path} has no positions: part of the file is missing")
    oriented = np.concatenate(turns) if len(turns) == len(steps) else None
    return DrawnPaths(np.concatenate(steps), np.concatenate(positions), oriented)


def times_of(recording: Recording, steps: IntArray) -> FloatArray:
    """Return the times (s) of the frames of ascending steps."""
    table = recording.fingerprints()
    rows = np.searchsorted(table[STEP].to_numpy(), steps)
    return np.asarray(table["time"].to_numpy()[np.minimum(rows, table.num_rows - 1)])


def _numbers(column: pa.Array) -> SingleArray:
    column = plain(column)
    if column.type != pa.float32():
        raise DamageError(f"positions or orientations of type {column.type}")
    return np.asarray(column.to_numpy(), dtype=np.float32)


class Continuation:
    """The frames of an earlier run up to a step; a resumed run writes them before its own frames.

    ``reached`` is the exact state at this step, if the recording has no checkpoint there: it was computed by a run that
    repeated the earlier run and writes only new frames.
    """

    def __init__(self, recording: Recording, step: int, reached: Checkpoint | None = None) -> None:
        self.recording = recording
        self.step = step
        self._reached = reached
        steps = recording.fingerprints()[STEP].to_numpy()
        self.frames = 0 if reached else int(np.count_nonzero(steps <= step))
        self.origin = recording.origin  # (3,) m
        self.clock = TimeScale(float(recording.info["time_scale"]))
        self.arrow_references = {name: float(value) for name, value in recording.arrow_references.items()}
        self.last_state = recording.states_at(step)
        self.arrow_floors = arrow_floors(recording, step)

    @cached_property
    def impacts(self) -> RecordedImpacts:
        """The impacts up to this step."""
        if self._reached:
            return RecordedImpacts(left_out=count_at(self.recording, self.step))
        return impacts_until(self.recording, self.step)

    def last(self) -> Checkpoint:
        """Read the values on which the rows of the next frame depend."""
        found = self._reached or self.recording.checkpoint(self.step)
        held = found.contacts
        # some series are differences from the previous frame, and need its contacts
        counts = held is not None and (held.pistons is not None or held.release is not None)
        contacts = held if counts else None
        return replace(found, acceleration=found.acceleration[:0].copy(), contacts=contacts, integrator=None)

    def chunks(self) -> Iterator[Chunk]:
        """Yield all rows up to this step, without the events that closed the recording."""
        if self._reached:
            return
        for chunk in self.recording.temporal_chunks():
            batch = chunk.batch
            if STEP in batch.schema.names:
                kept = pc.less_equal(batch[STEP], self.step)
            else:
                kept = pc.less_equal(batch[IMPACT], self.impacts.count)
            if chunk.entity_path == paths.EVENTS:
                kinds = flat(chunk, "kind", EVENTS["kind"])
                kept = pc.and_(kept, pc.invert(pc.is_in(kinds, pa.array(sorted(CLOSING)))))
            if pc.all(kept).as_py():
                yield chunk
            elif pc.any(kept).as_py():
                yield Chunk(chunk.entity_path, batch.filter(kept))
