"""`RecordedPositions`: positions of the bodies of a recording, read frame by frame."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.errors import DamageError, RecordingError
from carom.recording.read.damage import reading
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk, Entry
from carom.recording.schema import paths
from carom.recording.schema.timelines import STEP

FloatArray = NDArray[np.float64]

_KEPT = 3  # chunks kept in memory; neighbouring frames may be in different ones


class RecordedPositions:
    """Positions in m, (n, 3): as they are drawn, or exact where there is a checkpoint."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        with reading(recording.path):
            self._origin = recording.origin
        self._shown = recording.shown
        self._drawn = _Rows(recording, paths.BODIES)
        self._exact = _Rows(recording, paths.CHECKPOINT)

    def drawn(self, step: int) -> FloatArray:
        """Return the drawn positions (float32) of the bodies that the recording shows."""
        with reading(self._recording.path):
            for name in paths.CENTRES:
                values = self._drawn.at(step, name)
                if values is not None:
                    return values.reshape(len(self._shown), 3) + self._origin
        raise RecordingError(f"{self._recording.path} has no positions at step {step}: a piece of it is missing")

    def exact(self, step: int) -> FloatArray | None:
        """Return exact positions of the bodies that the recording shows; None where there is no checkpoint."""
        with reading(self._recording.path):
            values = self._exact.at(step, "position")
            return None if values is None else values.reshape(-1, 3)[self._shown]


class _Rows:
    """Rows of one entity by their step."""

    def __init__(self, recording: Recording, path: str) -> None:
        self._recording = recording
        entries = [e for e in recording.store.entries if e.entity_path == path and e.first_step is not None]
        self._entries = sorted(entries, key=lambda entry: entry.first_step or 0)
        self._chunks: OrderedDict[int, Chunk] = OrderedDict()

    def at(self, step: int, component: str) -> FloatArray | None:
        """Return the numbers in a component, flat; None if there is no such row."""
        for entry in self._entries:
            if entry.holds(step):
                chunk = self._chunk(entry)
                rows = np.flatnonzero(chunk.batch[STEP].to_numpy() == step)
                if len(rows) and component in chunk.components:
                    values = chunk.batch[component][int(rows[-1])].values
                    while not pa.types.is_floating(values.type):
                        values = values.flatten()
                    return np.asarray(values.to_numpy(), dtype=np.float64)
        return None

    def _chunk(self, entry: Entry) -> Chunk:
        if entry.offset not in self._chunks:
            (self._chunks[entry.offset],) = self._recording.chunks([entry])
            if len(self._chunks) > _KEPT:
                self._chunks.popitem(last=False)
        return self._chunks[entry.offset]


class DrawnPaths(NamedTuple):
    """Where some bodies are drawn in all frames."""

    steps: NDArray[np.int64]  # (k,)
    position: NDArray[np.float32]  # (k, b, 3) m from the recording's origin
    orientation: NDArray[np.float32] | None  # (k, b, 4) xyzw; None where none are recorded


def drawn_paths(recording: Recording, places: Sequence[int]) -> DrawnPaths:
    """Read the paths of some bodies, given by their places among those that the recording shows."""
    steps, positions, turns = [], [], []
    n, chosen = len(recording.shown), list(places)
    entries = [e for e in recording.store.entries if e.entity_path == paths.BODIES and e.first_step is not None]
    with reading(recording.path):
        for chunk in recording.chunks(sorted(entries, key=lambda entry: entry.first_step or 0)):
            rows = chunk.batch.num_rows
            centres = next((name for name in paths.CENTRES if name in chunk.components), None)
            if centres is None:
                continue
            steps.append(chunk.batch[STEP].to_numpy())
            positions.append(_numbers(chunk.batch[centres]).reshape(rows, n, 3)[:, chosen])
            turned = next((name for name in chunk.components if name.endswith(":quaternions")), None)
            if turned is not None:
                turns.append(_numbers(chunk.batch[turned]).reshape(rows, n, 4)[:, chosen])
    if not steps:
        raise RecordingError(f"{recording.path} has no positions: a piece of it is missing")
    oriented = np.concatenate(turns) if len(turns) == len(steps) else None
    return DrawnPaths(np.concatenate(steps), np.concatenate(positions), oriented)


def _numbers(column: pa.Array) -> NDArray[np.float32]:
    while pa.types.is_nested(column.type):
        column = column.flatten()
    if column.type != pa.float32():
        raise DamageError(f"positions or orientations of type {column.type}")
    return np.asarray(column.to_numpy(), dtype=np.float32)
