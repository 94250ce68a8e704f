"""Repairs recordings that were truncated or damaged, and gives frames places for bodies that entered later."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import rerun.blueprint as rrb

from carom.arrays import IntArray
from carom.errors import DamageError, RecordingError
from carom.recording.layout import blueprint
from carom.recording.layout.camera import CameraFit
from carom.recording.read.entities import FINGERPRINTS, centres_of, join_rows, plain, reading
from carom.recording.read.recorded_data import rising
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.read.statics import UNFINISHED
from carom.recording.rrd.container import Container, Salvage, salvage
from carom.recording.rrd.messages import BLUEPRINT, RECORDING, Chunk, Entry, Store
from carom.recording.schema import paths
from carom.recording.timelines import STEP
from carom.recording.write.chunk_writer import Writer
from carom.recording.write.rerun_compat import StoredLayout
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem

_LOOKS = 50  # number of frames to which the camera is fitted


def new_layout(recording: Recording) -> rrb.Blueprint:
    """Lay out a recording as the recorder would have laid it out. Raises RecordingError if too little data are left."""
    header = header_of_recording(recording)
    entries = recording.store.frames_of(paths.BODIES)
    some = [entries[k] for k in sorted(set(np.linspace(0, len(entries) - 1, _LOOKS).astype(int)))] if entries else []
    fit = None
    for chunk in recording.chunks(some):
        centres = centres_of(chunk)
        if centres is None:  # the component's name is damaged
            continue
        first, last = (plain(centres[row].values).to_numpy().reshape(-1, 3) for row in (0, len(centres) - 1))
        fit = fit or CameraFit.of_scene(header, recording.origin, first)
        fit.look(last)
    if fit is None:
        fit = CameraFit.of_scene(header, recording.origin, np.zeros((len(header.radius), 3)))
    return blueprint(header, fit, recorded_curves(recording))


PROPERTY = "repair"


@dataclass(frozen=True, slots=True)
class Repaired:
    """Result of a repair."""

    path: Path | None  # path of the new file; None if there was nothing to repair
    size: int = 0  # bytes
    frames: int = 0
    last_step: int | None = None
    end: float | None = None  # s, time of the last frame
    lost: list[str] = field(default_factory=list)
    added: list[str] = field(default_factory=list)


def repair(source: str | Path, out: str | Path) -> Repaired:
    """Write the readable parts of a recording to a new one, with footer, layout, and an outcome that states the repair.

    Raises RecordingError if there is no such file, it is not a recording of carom, nothing in it is readable, or the
    new file cannot be written.
    """
    source, out = Path(source), Path(out)
    with reading(source):
        if not source.is_file():
            raise RecordingError(f"there is no recording at {source}")
        found = salvage(source)
        # repair the recording with the most chunks; wrong bytes may look like the start of another recording
        stores = [store for store in found.stores if store.kind == RECORDING]
        store = max(stores, key=lambda store: len(store.entries), default=None)
        if store is None or not store.entries:
            raise RecordingError(f"nothing of {source} can be read as a recording")
        own = [layout for layout in found.stores if layout.application_id == store.application_id]
        layouts = [layout for layout in own if layout.kind == BLUEPRINT and _is_whole(layout, found)]
        recording = Recording(Container(source, [store, *layouts], finished=False), store)
        recording.refuse_other_schema()
        if found.finished:
            with contextlib.suppress(RecordingError):
                recording.fingerprints()  # reads the table of frames, since everything else needs it
                return Repaired(None)
        try:  # refuses a file without the static data that its frames require
            known = bool(recording.info)
        except RecordingError:
            known = False
        if not known:
            raise RecordingError(
                f"{recording.path} has nothing to save: its run ended before the first frame was written, or the data "
                "needed to read frames is lost"
            )
        return _rewrite(recording, out, found)


def _is_whole(layout: Store, found: Salvage) -> bool:
    offsets = [entry.offset for entry in layout.entries]
    if not offsets:
        return False
    end = layout.entries[-1].offset + layout.entries[-1].length
    return not any(min(offsets) - 1000 < gap.offset <= end for gap in found.gaps)


def _rewrite(recording: Recording, out: Path, found: Salvage) -> Repaired:
    lost, added, kept = _lost(recording, found), ["footer"], list[pa.Table]()
    with Writer(out, recording.store.application_id, recording.store.store_id) as writer:
        for entry in recording.store.entries:
            try:
                for chunk in recording.chunks([entry]):
                    if chunk.entity_path == paths.FINGERPRINT:  # a wrong time would make all frames unreadable
                        kept.append(rising(join_rows(paths.FINGERPRINT, [chunk], FINGERPRINTS)))
                    writer.send(chunk)
            except DamageError as error:  # neither carom nor Rerun would have written this chunk
                lost.append(f"{_named(entry)} ({error})")
        steps, times = ([row for table in kept for row in table[name].to_pylist()] for name in (STEP, "time"))
        step, end = max(steps, default=None), max(times, default=None)
        until = "without a frame" if end is None else f"to t = {units_of(recording).text(end, TIME)} (step {step})"
        ended = recording.outcome
        ended = "unfinished: the run was killed, or its end is lost" if ended == UNFINISHED else ended
        outcome = f"{ended}; repaired, {until}"
        writer.send_property("outcome", {"outcome": outcome + _told(lost), "frames": len(steps)})
        writer.send_property(PROPERTY, {"source": recording.path.name, "lost": "\n".join(lost)})
        if layout := recording.layout():
            writer.send_layout(StoredLayout(layout))
        elif recording.lives is None:
            with contextlib.suppress(RecordingError):  # too little is left for a layout
                writer.send_layout(new_layout(recording))
                added.append("layout")
        writer.flush()
    try:
        Recording.open(out).fingerprints()
    except RecordingError as error:
        out.unlink()  # a file without frames is useless
        reason = error.__cause__ if isinstance(error.__cause__, DamageError) else error
        raise RecordingError(f"nothing of {recording.path} can be recovered: its frames have {reason}") from error
    if recording.lives is not None:
        widen(out)
    return Repaired(out, out.stat().st_size, len(steps), step, end, lost, added)


def units_of(recording: Recording) -> UnitSystem:
    """Return the units of a recording; SI if they are lost."""
    try:
        return recording.units
    except RecordingError:
        return SI


def _told(lost: list[str]) -> str:
    if not lost:
        return ""
    count = "1 piece" if len(lost) == 1 else f"{len(lost)} pieces"
    return f", {count} lost: {'; '.join(lost[:3])}" + ("; …" if len(lost) > 3 else "")


def _lost(recording: Recording, found: Salvage) -> list[str]:
    """Describe an unreadable part: by entity if the footer lists it, otherwise by its bytes."""
    if found.missing or found.layout_lost:
        return [_named(entry) for entry in found.missing] + (["the layout"] if found.layout_lost else [])
    size = recording.path.stat().st_size
    return [
        f"the last {gap.length} bytes ({gap.reason})"
        if gap.offset + gap.length == size
        else f"{gap.length} bytes at byte {gap.offset} ({gap.reason})"
        for gap in found.gaps
    ]


def _named(entry: Entry) -> str:
    if entry.first_step is None:
        return f"/{entry.entity_path}"
    if entry.first_step == entry.last_step:
        return f"/{entry.entity_path} of step {entry.first_step}"
    return f"/{entry.entity_path} of steps {entry.first_step} to {entry.last_step}"


_WITH_ENDS = (paths.CONTACTS, paths.FORCE_NORMAL, paths.FORCE_FRICTION)
_RENEWED = (paths.ABOUT, paths.SCENE, paths.BODIES, paths.STATIC_STATE, paths.LIVES)  # rewritten if bodies come or go


def widen(path: Path) -> None:
    """Give all frames of a recording places for bodies that entered later; may raise RecordingError."""
    recording = Recording.open(path)
    n, header = int(recording.info["bodies"]), header_of_recording(recording)
    steps, counts = _places(recording)
    fit = None
    with Writer(path, recording.store.application_id, recording.store.store_id) as writer:
        statics = sorted((e for e in recording.store.entries if e.is_static), key=lambda entry: entry.offset)
        last = {entry.entity_path: entry for entry in statics}  # for entities of `_RENEWED`, only the last row is sent
        kept = [entry for entry in statics if entry.entity_path not in _RENEWED or last[entry.entity_path] is entry]
        for chunk in recording.chunks(kept):
            writer.send(chunk)
        for chunk in recording.temporal_chunks():
            if chunk.entity_path == paths.BODIES:
                wide = _padded(chunk, n)
                for row in (0, wide.batch.num_rows - 1):
                    position = np.asarray(plain(_centres(wide)[row].values).to_numpy()).reshape(-1, 3)
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


def _places(recording: Recording) -> tuple[IntArray, IntArray]:
    """Return the steps of all frames, ascending, and the number of places in each."""
    steps, counts = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for chunk in recording.chunks(recording.store.frames_of(paths.BODIES)):
        steps.append(chunk.batch[STEP].to_numpy())
        counts.append(pc.list_value_length(_centres(chunk)).to_numpy())
    order = np.argsort(np.concatenate(steps))
    return np.concatenate(steps)[order], np.concatenate(counts).astype(np.int64)[order]


def _centres(chunk: Chunk) -> pa.ListArray:
    centres = centres_of(chunk)
    if centres is None:
        raise DamageError(f"rows of /{chunk.entity_path} without centres")
    return centres


def _padded(chunk: Chunk, n: int) -> Chunk:
    """Return rows of drawn bodies with n values each: the positions of bodies that do not exist yet are NaN."""
    counts = pc.list_value_length(_centres(chunk)).to_numpy().astype(np.int64)
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
    """Return rows of contacts with planes numbered from n, instead of from the number of bodies in each row."""
    column = chunk.batch["bodies"]
    ends = column.flatten().to_numpy().astype(np.int64)
    own = np.repeat(counts, pc.list_value_length(column).to_numpy())
    shifted = pa.array(np.where(ends >= own, ends + n - own, ends), pa.uint32())
    offsets = pa.array(np.concatenate(([0], np.cumsum(pc.list_value_length(column).to_numpy()))), pa.int32())
    new = pa.ListArray.from_arrays(offsets, shifted, type=column.type)
    arrays = [new if name == "bodies" else chunk.batch[name] for name in chunk.batch.schema.names]
    return Chunk(chunk.entity_path, pa.record_batch(arrays, schema=chunk.batch.schema))
