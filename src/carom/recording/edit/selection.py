"""`Selection`: keeps the rows of some bodies in a chunk, and removes the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from carom.recording.read.recorded_contacts import join_some
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.paths import STEP

SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]

_ROUNDING = 8 * float(np.finfo(np.float32).eps)  # of a few float32 operations on a coordinate


class Selection:
    """Keeps the spheres and arrows of some bodies and the contacts among them.

    A contact is kept if both its bodies are, or its body is and the other side is a plane. Recordings before schema 3
    have no numbers of the bodies that it joins. There they are found from where its line ends, and the chunk with the
    centres has to come before that with the contacts.

    Parameters
    ----------
    numbers
        Of the bodies to keep.
    shown
        Numbers of the bodies that the source shows.
    box
        (3,) m, of a periodic domain.
    bodies
        How many bodies there are.
    """

    def __init__(
        self, numbers: Sequence[int], shown: Sequence[int], box: NDArray[np.float64] | None, bodies: int
    ) -> None:
        self._numbers = np.array(sorted(set(numbers)), dtype=np.int64)
        self._places = np.searchsorted(np.asarray(shown), self._numbers)  # among those that the source shows
        self._shown = len(shown)
        self._box = box
        self._bodies_in_all = bodies
        self._centres: dict[int, SingleArray] = {}  # of all bodies, by step, until the contacts of the step were seen

    def of(self, chunk: Chunk) -> Chunk:
        """Return a chunk without the rows' parts of other bodies."""
        match chunk.entity_path:
            case paths.BODIES:
                self._remember(chunk)
                return self._bodies(chunk)
            case paths.TORQUE | paths.ANGULAR_ACCELERATION if not chunk.is_static:
                return _masked(chunk, [np.isin(row, self._numbers) for row in _rows(chunk, "body")])
            case paths.CONTACTS | paths.FORCE_NORMAL | paths.FORCE_FRICTION if "bodies" in chunk.components:
                return _masked(chunk, [self._joins(row) for row in _rows(chunk, "bodies")])
            case paths.IMPACTS if "bodies" in chunk.components:
                kept = [bool(self._joins(row).all()) for row in _rows(chunk, "bodies")]
                return Chunk(chunk.entity_path, chunk.batch.filter(pa.array(kept, pa.bool_())))
            case paths.CONTACTS if not chunk.is_static:
                strips = [
                    np.asarray(row, np.float32).reshape(-1, 2, 3) for row in _vectors(chunk, "LineStrips3D:strips")
                ]
                steps = chunk.batch[STEP].to_pylist()
                return _masked(chunk, [self._among(k, lines) for k, lines in zip(steps, strips, strict=True)])
        return chunk

    def _joins(self, ends: IntArray) -> NDArray[np.bool_]:
        """Tell which contacts, whose ends (2m,) these are, join kept bodies, or a kept body and a plane."""
        return join_some(ends.reshape(-1, 2), self._numbers, self._bodies_in_all)

    def _bodies(self, chunk: Chunk) -> Chunk:
        """Keep some values of lists with one value per body, and other lists unchanged."""
        columns = {}
        for name in chunk.components:
            lengths = pc.list_value_length(chunk.batch[name])
            if self._shown > 1 and pc.all(pc.equal(lengths, self._shown)).as_py():
                taken = (np.arange(chunk.batch.num_rows)[:, None] * self._shown + self._places).ravel()
                columns[name] = _lists(chunk.batch[name], taken, np.full(chunk.batch.num_rows, len(self._places)))
        return _replaced(chunk, columns)

    def _remember(self, chunk: Chunk) -> None:
        for name in paths.CENTRES:
            if name in chunk.components and STEP in chunk.batch.schema.names:
                rows = _vectors(chunk, name)
                self._centres |= dict(zip(chunk.batch[STEP].to_pylist(), rows, strict=True))

    def _among(self, step: int, lines: SingleArray) -> NDArray[np.bool_]:
        """Tell which of a frame's lines (m, 2, 3) join kept bodies, or a kept body and a plane."""
        centres = self._centres.pop(step)
        kept = centres[self._places]
        begins = np.any(np.all(lines[:, 0, None] == kept, axis=2), axis=1)  # a line begins at a centre, to the bit
        ends = np.zeros(len(lines), dtype=np.bool_)
        for line in np.flatnonzero(begins):
            end = lines[line, 1]
            ends[line] = self._meets(end, kept) or not self._meets(end, centres)
        return np.asarray(begins & ends)

    def _meets(self, point: SingleArray, centres: SingleArray) -> bool:
        """Tell whether a point is one of the centres, in a periodic box any of its images."""
        apart = centres.astype(np.float64) - point
        size = float(np.max(np.abs(centres), initial=0.0))
        if self._box is not None:
            apart -= self._box * np.round(apart / self._box)  # the nearest image
            size += float(np.max(self._box))
        return bool(np.any(np.max(np.abs(apart), axis=1) <= _ROUNDING * size))


def _rows(chunk: Chunk, name: str) -> list[IntArray]:
    return [np.asarray(row.values.to_numpy(), dtype=np.int64) for row in chunk.batch[name]]


def _vectors(chunk: Chunk, name: str) -> list[SingleArray]:
    """Read each row's vectors, (k, 3), or of lists of them all that are in them."""
    found = []
    for row in chunk.batch[name]:
        values = row.values
        while not pa.types.is_floating(values.type):
            values = values.flatten()
        found.append(values.to_numpy().reshape(-1, 3))
    return found


def _masked(chunk: Chunk, masks: list[NDArray[np.bool_]]) -> Chunk:
    """Keep the same items of every component's lists."""
    mask = np.concatenate([np.zeros(0, dtype=np.bool_), *masks])
    each = np.array([np.count_nonzero(row) for row in masks], dtype=np.int64)
    lengths = [len(row) for row in masks]
    columns = {}
    for name in chunk.components:
        found = pc.list_value_length(chunk.batch[name]).to_pylist()
        if name == "impact_count":  # one value a row, however many contacts there are
            continue
        if found == lengths:
            columns[name] = _lists(chunk.batch[name], np.flatnonzero(mask), each)
        elif found == [2 * length for length in lengths]:  # pairs
            columns[name] = _lists(chunk.batch[name], np.flatnonzero(np.repeat(mask, 2)), 2 * each)
    return _replaced(chunk, columns)


def _lists(column: pa.ListArray, taken: IntArray, each: IntArray) -> pa.ListArray:
    """Return a column of lists with only some of its items."""
    offsets = pa.array(np.concatenate([[0], np.cumsum(each)]), pa.int32())
    return pa.ListArray.from_arrays(offsets, column.flatten().take(pa.array(taken)), type=column.type)


def _replaced(chunk: Chunk, columns: dict[str, pa.Array]) -> Chunk:
    batch = chunk.batch
    arrays = [columns.get(name, batch[name]) for name in batch.schema.names]
    return Chunk(chunk.entity_path, pa.record_batch(arrays, schema=batch.schema))
