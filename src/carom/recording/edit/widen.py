"""Gives each frame of a recording a place for each body of the run, if bodies came after the first frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from carom.arrays import IntArray
from carom.recording.layout.blueprint import blueprint
from carom.recording.layout.camera import CameraFit
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk, Entry
from carom.recording.schema import paths
from carom.recording.schema.paths import STEP
from carom.recording.write.whole_file import Writer

_WITH_ENDS = (paths.CONTACTS, paths.FORCE_NORMAL, paths.FORCE_FRICTION)


def widen(path: Path) -> None:
    """Rewrite a recording whose frames have a place only for each body that had come by then.

    Raises
    ------
    RecordingError
        If it cannot be read, or the new file cannot be written.
    """
    recording = Recording.open(path)
    n, header = int(recording.info["bodies"]), header_of_recording(recording)
    steps, counts = _places(recording)
    fit = None
    with Writer(path, recording.store.application_id, recording.store.store_id) as writer:
        for chunk in recording.chunks(_last_statics(recording)):
            writer.send(chunk)
        for chunk in recording.temporal_chunks():
            if chunk.entity_path == paths.BODIES:
                wide = _padded(chunk, n)
                for row in (0, wide.batch.num_rows - 1):
                    position = _positions(wide, row)
                    fit = fit or CameraFit.of_scene(header, recording.origin, position)
                    fit.look(position)
                writer.send(wide)
            elif chunk.entity_path in _WITH_ENDS and "bodies" in chunk.components:
                at = np.searchsorted(steps, chunk.batch[STEP].to_numpy(), side="right") - 1
                writer.send(_renumbered(chunk, counts[at], n))
            else:
                writer.send(chunk)
        if fit is not None:
            writer.send_layout(blueprint(header, fit, recorded_curves(recording)))
        writer.flush()


def _last_statics(recording: Recording) -> Iterator[Entry]:
    """Yield static chunks; for an entity that was sent more than once, the chunks of the last time."""
    entries = [entry for entry in recording.store.entries if entry.is_static]
    renewed = (paths.SCENE, paths.BODIES, paths.STATIC_STATE, paths.LIVES)
    last = {entry.entity_path: entry for entry in sorted(entries, key=lambda entry: entry.offset)}
    for entry in entries:
        if entry.entity_path not in renewed or last[entry.entity_path] is entry:
            yield entry


def _places(recording: Recording) -> tuple[IntArray, IntArray]:
    """Return the steps of all frames, ascending, and the number of places in each."""
    steps, counts = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    entries = recording.store.frames_of(paths.BODIES)
    for chunk in recording.chunks(entries):
        steps.append(chunk.batch[STEP].to_numpy())
        counts.append(pc.list_value_length(chunk.batch[_centres(chunk)]).to_numpy())
    order = np.argsort(np.concatenate(steps))
    return np.concatenate(steps)[order], np.concatenate(counts).astype(np.int64)[order]


def _centres(chunk: Chunk) -> str:
    return next(name for name in paths.CENTRES if name in chunk.components)


def _positions(chunk: Chunk, row: int) -> np.ndarray:
    return np.asarray(chunk.batch[_centres(chunk)][row].values.flatten().to_numpy()).reshape(-1, 3)


def _padded(chunk: Chunk, n: int) -> Chunk:
    """Return rows of drawn bodies with n values each: the positions of bodies that do not exist yet are NaN."""
    counts = pc.list_value_length(chunk.batch[_centres(chunk)]).to_numpy().astype(np.int64)
    rows = len(counts)
    arrays = []
    for name in chunk.batch.schema.names:
        column = chunk.batch[name]
        if name not in chunk.components:
            arrays.append(column)
            continue
        values = column.flatten()
        missing = np.full(3, np.nan) if name in paths.CENTRES else np.array([0.0, 0.0, 0.0, 1.0])
        flat = values.flatten() if pa.types.is_fixed_size_list(values.type) else values
        width = len(flat) // len(values)
        filling = missing if width > 1 else np.zeros(1)
        wide = np.tile(filling, (rows, n, 1)).astype(flat.to_numpy().dtype)
        wide[np.arange(n) < counts[:, None]] = flat.to_numpy().reshape(-1, width)
        inner = pa.array(wide.ravel(), flat.type)
        if width > 1:
            inner = pa.FixedSizeListArray.from_arrays(inner, type=values.type)
        offsets = pa.array(np.arange(rows + 1) * n, pa.int32())
        arrays.append(pa.ListArray.from_arrays(offsets, inner, type=column.type))
    return Chunk(chunk.entity_path, pa.record_batch(arrays, schema=chunk.batch.schema))


def _renumbered(chunk: Chunk, counts: IntArray, n: int) -> Chunk:
    """Return rows of contacts in which planes are numbered from n on, instead of from the count of each row."""
    column = chunk.batch["bodies"]
    ends = column.flatten().to_numpy().astype(np.int64)
    own = np.repeat(counts, pc.list_value_length(column).to_numpy())
    shifted = pa.array(np.where(ends >= own, ends + n - own, ends), pa.uint32())
    offsets = pa.array(np.concatenate(([0], np.cumsum(pc.list_value_length(column).to_numpy()))), pa.int32())
    new = pa.ListArray.from_arrays(offsets, shifted, type=column.type)
    arrays = [new if name == "bodies" else chunk.batch[name] for name in chunk.batch.schema.names]
    return Chunk(chunk.entity_path, pa.record_batch(arrays, schema=chunk.batch.schema))
