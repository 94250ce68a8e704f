"""Repairs a recording that was truncated, lacks its footer, or has wrong bytes."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun.blueprint as rrb

from carom.errors import DamageError, RecordingError
from carom.recording.edit.widen import widen
from carom.recording.layout.blueprint import blueprint
from carom.recording.layout.camera import CameraFit
from carom.recording.read.entities import FINGERPRINTS, join_rows, reading
from carom.recording.read.frame_tables import rising
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.read.statics import UNFINISHED
from carom.recording.rrd.container import Container
from carom.recording.rrd.messages import BLUEPRINT, RECORDING, Entry, Store
from carom.recording.rrd.salvage import Salvage, salvage
from carom.recording.schema import paths
from carom.recording.schema.header import schema_version
from carom.recording.schema.paths import STEP
from carom.recording.write.rerun_compat import StoredLayout
from carom.recording.write.whole_file import Writer
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem

_LOOKS = 50  # number of frames to which the camera is fitted


def new_layout(recording: Recording) -> rrb.Blueprint:
    """Lay out a recording as the recorder would have done. Raises RecordingError if too little of it is left."""
    header = header_of_recording(recording)
    entries = recording.store.frames_of(paths.BODIES)
    entries = sorted(entries, key=lambda entry: entry.first_step or 0)
    some = [entries[k] for k in sorted(set(np.linspace(0, len(entries) - 1, _LOOKS).astype(int)))] if entries else []
    fit = None
    for chunk in recording.chunks(some):
        centres = next((chunk.batch[name] for name in paths.CENTRES if name in chunk.components), None)
        if centres is None:  # the component's name is damaged
            continue
        first, last = (centres[row].values.flatten().to_numpy().reshape(-1, 3) for row in (0, len(centres) - 1))
        fit = fit or CameraFit.of_scene(header, recording.origin, first)
        fit.look(last)
    if fit is None:
        fit = CameraFit.of_scene(header, recording.origin, np.zeros((len(header.radius), 3)))
    return blueprint(header, fit, recorded_curves(recording))


PROPERTY = "repair"


@dataclass(frozen=True, slots=True)
class Repaired:
    """Result of a repair."""

    path: Path | None  # None if there was nothing to repair
    size: int = 0  # bytes
    frames: int = 0
    last_step: int | None = None
    end: float | None = None  # s, of the last frame
    lost: list[str] = field(default_factory=list)
    added: list[str] = field(default_factory=list)


def repair(source: str | Path, out: str | Path) -> Repaired:
    """Write the readable parts of a recording to a new one, with a footer, a layout, and an outcome that says so.

    Raises
    ------
    RecordingError
        If there is no such file, it is not carom's, nothing in it is readable, or the new one cannot be written.
    """
    source, out = Path(source), Path(out)
    with reading(source):
        if not source.is_file():
            raise RecordingError(f"there is no recording at {source}")
        found = salvage(source)
        store = _recording(source, found)
        recording = Recording(Container(source, [store, *_layouts(found, store)], finished=False), store)
        if found.finished and _has_frames(recording):
            return Repaired(None)
        _refuse_unbegun(recording)
        return _rewrite(recording, out, found)


def _recording(source: Path, found: Salvage) -> Store:
    """Return the recording with the most chunks; wrong bytes may appear to start others."""
    stores = [store for store in found.stores if store.kind == RECORDING]
    store = max(stores, key=lambda store: len(store.entries), default=None)
    if store is None or not store.entries:
        raise RecordingError(f"nothing of {source} can be read as a recording")
    if schema_version(store.application_id) is None:
        raise RecordingError(f"{source} was not made by carom, but by {store.application_id!r}")
    return store


def _refuse_unbegun(recording: Recording) -> None:
    """Refuse a file without the static data that its frames require."""
    try:
        known = bool(recording.info)
    except RecordingError:
        known = False
    if not known:
        raise RecordingError(
            f"{recording.path} has nothing to save: its run ended before the first frame was written, or the data "
            "needed to read frames is lost"
        )


def _layouts(found: Salvage, store: Store) -> list[Store]:
    """Return the complete layouts."""
    return [
        layout
        for layout in found.stores
        if layout.kind == BLUEPRINT and layout.application_id == store.application_id and _is_whole(layout, found)
    ]


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
            except DamageError as error:  # carom or Rerun would not have written it
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
    _refuse_unreadable(out, recording.path)
    if recording.lives is not None:
        widen(out)
    return Repaired(out, out.stat().st_size, len(steps), step, end, lost, added)


def _has_frames(recording: Recording) -> bool:
    """Return whether the table of frames can be read, which everything else needs."""
    try:
        recording.fingerprints()
    except RecordingError:
        return False
    return True


def _refuse_unreadable(out: Path, source: Path) -> None:
    """Delete a repaired file whose frames cannot be read, since it would be useless."""
    try:
        Recording.open(out).fingerprints()
    except RecordingError as error:
        out.unlink()
        reason = error.__cause__ if isinstance(error.__cause__, DamageError) else error
        raise RecordingError(f"nothing of {source} can be recovered: its frames have {reason}") from error


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
