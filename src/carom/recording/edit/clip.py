"""Cuts frames out of a recording into a file that opens, inspects, renders and replays like the whole."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import rerun as rr
from numpy.typing import NDArray

from carom.errors import RecordingError
from carom.recording.edit.selection import Selection
from carom.recording.read.entities import reading
from carom.recording.read.moment import tolerance
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk, Entry
from carom.recording.schema import paths
from carom.recording.schema.header import Scalar
from carom.recording.schema.paths import IMPACT, SIM_TIME, STEP
from carom.recording.write.chunk_writer import Writer
from carom.recording.write.rerun_compat import StoredLayout
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import bodies_called

PROPERTY = "clip"

_STATES = (paths.PHASE, paths.DT_LIMIT)  # rows only where they change: the last row before the cut still applies
_PATH, _KIND, _COMPONENT = b"rerun:entity_path", b"rerun:kind", b"rerun:component"


@dataclass(frozen=True, slots=True)
class Clip:
    """Result of a cut."""

    path: Path
    size: int  # bytes
    frames: int
    first_step: int
    last_step: int
    start: float  # s, of the first frame
    end: float  # s, of the last frame
    replays_from: int | None  # the step of the exact state in /state/start; None: there is none
    bodies: list[int] | None  # that are shown; None: all


@dataclass(frozen=True, slots=True)
class _Cut:
    """The frames to keep."""

    first: int  # step
    last: int  # step
    first_shown: int  # ns on the timeline of simulated time
    start: float  # s
    end: float  # s
    frames: int


def clip(
    source: str | Path,
    out: str | Path,
    start: float = -np.inf,
    end: float = np.inf,
    bodies: Sequence[int] | None = None,
    exact: bool = True,
) -> Clip:
    """Cut the frames of an interval of simulated time out of a recording.

    Only the chunks that overlap the interval are read. The exact states and fingerprints stay those of all bodies, so
    that a clip of a few bodies replays, too.

    Parameters
    ----------
    source
        The recording.
    out
        The ``.rrd`` to write; one that exists is replaced when the clip is whole.
    start, end
        Simulated times in seconds, both included.
    bodies
        Numbers of the bodies to show; None shows all.
    exact
        Whether it has the exact states of all bodies. Without them it is smaller: it has nothing of the bodies that it
        does not show, and cannot be run again.

    Raises
    ------
    RecordingError
        If the source cannot be read, has no frame in the interval or no such body, or the clip cannot be written.
    """
    recording = Recording.open(source)
    with reading(recording.path):
        cut = _cut(recording, start, end)
        exact = exact and not recording.is_partial
        shown = list(recording.shown) if bodies is None else sorted(set(bodies))
        selection = None if bodies is None else _selection(recording, bodies)
        first = _start(recording, cut) if exact else None
        with Writer(Path(out), recording.store.application_id, str(uuid.uuid4())) as writer:
            for chunk in _static(recording, exact):
                writer.send(chunk if selection is None else selection.of(chunk))
            if first is not None:
                writer.send(first)
            if not exact:
                writer.log(paths.STATIC_STATE, rr.AnyValues(**_properties_of(recording, shown)))
            writer.send_property(PROPERTY, _identity(recording, cut, shown, exact))
            numbers = list[NDArray[np.int64]]()
            for chunk in _moving(recording, cut):
                if chunk.entity_path == paths.CHECKPOINT and not exact:
                    continue
                kept = chunk if selection is None else selection.of(chunk)
                if not kept.batch.num_rows:
                    continue
                writer.send(kept)
                if chunk.entity_path == paths.IMPACTS:
                    numbers.append(np.array(kept.batch[IMPACT].to_numpy()))
            for chunk in _at_impacts(recording, numbers):
                writer.send(chunk if selection is None else selection.of(chunk))
            if layout := recording.layout():
                writer.send_layout(StoredLayout(layout))
            writer.flush()
        few = None if len(shown) == recording.info["bodies"] else shown
    step = None if first is None else int(first.batch[STEP][0].as_py()[0])
    size = Path(out).stat().st_size
    return Clip(Path(out), size, cut.frames, cut.first, cut.last, cut.start, cut.end, step, few)


def _cut(recording: Recording, start: float, end: float) -> _Cut:
    prints = recording.fingerprints()
    times = prints["time"].to_numpy()
    inside = np.flatnonzero((times >= start - tolerance(start)) & (times <= end + tolerance(end)))
    recording.require_frames()
    if len(inside) == 0:
        nearest = times[np.argmin(np.abs(times - min(max(start, times[0]), end)))]
        units = recording.units
        raise RecordingError(
            f"{recording.path} has no frame {_between(start, end, units)}; "
            f"it goes from {units.span(times[0], times[-1], TIME, 'g')}, with {len(times)} frames, "
            f"the nearest at {units.text(nearest, TIME, 'g')}"
        )
    steps, shown = prints[STEP].to_numpy(), prints[SIM_TIME].cast(pa.int64()).to_numpy()
    first, last = inside[0], inside[-1]
    return _Cut(int(steps[first]), int(steps[last]), int(shown[first]), times[first], times[last], len(inside))


def _between(start: float, end: float, units: UnitSystem) -> str:
    """Name an interval of times, in s, of which one end may be infinite."""
    if end == np.inf:
        return f"from {units.text(start, TIME, 'g')} on"
    if start == -np.inf:
        return f"up to {units.text(end, TIME, 'g')}"
    return f"between {units.shown(start, TIME):g} and {units.text(end, TIME, 'g')}"


def _selection(recording: Recording, bodies: Sequence[int]) -> Selection:
    shown = recording.shown
    if missing := sorted(set(bodies) - set(shown)):
        whole = shown == list(range(len(shown)))
        which = f"bodies 0 to {len(shown) - 1}" if whole else bodies_called(shown, recording.bodies.name)
        raise RecordingError(f"{recording.path} has no body {missing[0]}: it shows {which}")
    box = recording.info.get("box")
    size = None if box is None else np.asarray(box, dtype=np.float64)
    return Selection(bodies, shown, size, int(recording.info["bodies"]))


def _properties_of(recording: Recording, shown: Sequence[int]) -> dict[str, Any]:
    """Return the static properties of the bodies that are shown."""
    table = recording.bodies
    numbers = np.asarray(shown)
    names = [table.name[body] for body in shown]
    values = {name: getattr(table, name)[numbers] for name in ("group", "mass", "radius", "inertia")}
    return {"name": names, **values}


def _identity(
    recording: Recording, cut: _Cut, shown: Sequence[int], exact: bool
) -> dict[str, Scalar | NDArray[np.int64]]:
    identity: dict[str, Scalar | NDArray[np.int64]] = {
        "source": recording.path.name,
        "recording_id": recording.store.store_id,
        "from": cut.start,
        "to": cut.end,
    }
    if not exact:
        identity["partial"] = True
    return identity if len(shown) == recording.info["bodies"] else identity | {"bodies": np.array(shown, np.int64)}


def _static(recording: Recording, exact: bool) -> Iterator[Chunk]:
    gone = [paths.START, f"__properties/{PROPERTY}", *(() if exact else (paths.STATIC_STATE, paths.GIVEN_STATE))]
    return recording.chunks(e for e in recording.store.entries if e.is_static and e.entity_path not in gone)


def _moving(recording: Recording, cut: _Cut) -> Iterator[Chunk]:
    """Read the chunks that overlap the cut, centres before the contacts that join them."""
    entries = [e for e in recording.store.entries if e.first_step is not None and _overlaps(e, cut)]
    last = {path: _last_before(recording.store.entries, path, cut.first) for path in _STATES}
    entries += [entry for entry in last.values() if entry is not None and entry not in entries]
    for chunk in recording.chunks(sorted(entries, key=_order)):
        rows = _within(chunk, cut)
        if rows.batch.num_rows:
            yield rows


def _at_impacts(recording: Recording, numbers: Sequence[NDArray[np.int64]]) -> Iterator[Chunk]:
    """Read the bodies at the moments of impacts that the clip has."""
    if not numbers:
        return
    kept = pa.array(np.concatenate(numbers))
    entries = [e for e in recording.store.entries if not e.is_static and e.first_step is None]
    for chunk in recording.chunks(entries):
        if IMPACT in chunk.batch.schema.names:
            rows = chunk.batch.filter(pc.is_in(chunk.batch[IMPACT], value_set=kept))
            if rows.num_rows:
                yield Chunk(chunk.entity_path, rows)


def _order(entry: Entry) -> tuple[int, bool]:
    is_contacts = entry.entity_path == paths.CONTACTS
    return (entry.last_step if is_contacts else entry.first_step) or 0, is_contacts


def _overlaps(entry: Entry, cut: _Cut) -> bool:
    return entry.first_step is not None and entry.first_step <= cut.last and (entry.last_step or 0) >= cut.first


def _last_before(entries: Iterable[Entry], path: str, step: int) -> Entry | None:
    """Find the chunk with an entity's last row at or before a step."""
    found = [e for e in entries if e.entity_path == path and e.first_step is not None and e.first_step <= step]
    return max(found, key=lambda entry: entry.first_step or 0, default=None)


def _within(chunk: Chunk, cut: _Cut) -> Chunk:
    """Keep the rows of the cut; a state that began earlier starts at its first frame."""
    steps = chunk.batch[STEP].to_numpy()
    inside = (steps >= cut.first) & (steps <= cut.last)
    before = np.flatnonzero(steps < cut.first)
    if chunk.entity_path in _STATES and len(before) and not np.any(steps == cut.first):
        inside[before[-1]] = True
        return _moved(chunk.entity_path, chunk.batch.filter(pa.array(inside)), cut)
    return Chunk(chunk.entity_path, chunk.batch.filter(pa.array(inside)))


def _moved(path: str, batch: pa.RecordBatch, cut: _Cut) -> Chunk:
    """Move rows from before the cut to its first frame."""
    early = pc.less(batch[STEP], cut.first)
    shown = pa.scalar(cut.first_shown, pa.int64()).cast(pa.duration("ns"))
    moved = {STEP: pc.if_else(early, pa.scalar(cut.first), batch[STEP])}
    moved[SIM_TIME] = pc.if_else(early, shown, batch[SIM_TIME])
    return Chunk(path, pa.record_batch([moved.get(n, batch[n]) for n in batch.schema.names], schema=batch.schema))


def _start(recording: Recording, cut: _Cut) -> Chunk | None:
    """Find the exact state at or before the first frame, and store it as static data of the clip."""
    entry = _last_before(recording.store.entries, paths.CHECKPOINT, cut.first)
    if entry is None:
        carried = [e for e in recording.store.entries if e.is_static and e.entity_path == paths.START]
        return next(recording.chunks(carried[-1:]), None)
    (chunk,) = recording.chunks([entry])
    row = int(np.flatnonzero(chunk.batch[STEP].to_numpy() <= cut.first)[-1])
    kept = [field for field in chunk.batch.schema if (field.metadata or {}).get(_KIND) == b"data"]
    values = [chunk.batch[field.name].slice(row, 1) for field in kept]
    number = pa.field(STEP, pa.list_(pa.int64()), metadata={_KIND: b"data", _COMPONENT: STEP.encode()})
    step = pa.array([[chunk.batch[STEP][row].as_py()]], number.type)
    metadata = dict(chunk.batch.schema.metadata) | {_PATH: f"/{paths.START}".encode()}
    return Chunk(paths.START, pa.record_batch([*values, step], pa.schema([*kept, number], metadata)))
