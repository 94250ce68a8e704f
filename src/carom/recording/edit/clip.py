"""Cuts frames, and some bodies, out of a recording into a file that opens, inspects, renders and replays."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import rerun as rr

from carom.arrays import BoolArray, FloatArray, IntArray, SingleArray
from carom.errors import RecordingError
from carom.recording.read.entities import centres_of, plain, reading
from carom.recording.read.lookup import tolerance
from carom.recording.read.recorded_contacts import join_some
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk, Entry
from carom.recording.schema import paths
from carom.recording.schema.header import Scalar
from carom.recording.timelines import IMPACT, SIM_TIME, STEP
from carom.recording.write.chunk_writer import Writer
from carom.recording.write.rerun_compat import StoredLayout
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import bodies_called

_ROUNDING = 8 * float(np.finfo(np.float32).eps)  # relative error of a few float32 operations on a coordinate


class Selection:
    """Keeps the spheres and arrows of selected bodies, and the contacts among them.

    A contact is kept if both of its bodies are kept, or if one end is a kept body and the other end is a plane. With
    ``record.impacts = "none"``, a recording has the lines of contacts without the numbers of their bodies. The numbers
    are derived from the ends of a line, so the chunk with the centres must come before the chunk with the contacts.
    """

    def __init__(
        self,
        numbers: Sequence[int],  # numbers of the bodies to keep
        shown: Sequence[int],  # numbers of the bodies that the source shows
        box: FloatArray | None,  # (3,) m, size of a periodic domain
        bodies: int,  # number of all bodies
    ) -> None:
        self._numbers = np.array(sorted(set(numbers)), dtype=np.int64)
        # indices of the kept bodies among the bodies that the source shows
        self._places = np.searchsorted(np.asarray(shown), self._numbers)
        self._shown = len(shown)
        self._box = box
        self._bodies_in_all = bodies
        self._centres: dict[int, SingleArray] = {}  # centres of all bodies, by step, until the step's contacts are read

    def of(self, chunk: Chunk) -> Chunk:
        """Return a chunk with only the values of the kept bodies."""
        match chunk.entity_path:
            case paths.BODIES:
                if (centres := centres_of(chunk)) is not None and STEP in chunk.batch.schema.names:
                    self._centres |= dict(zip(chunk.batch[STEP].to_pylist(), _vectors(centres), strict=True))
                return self._bodies(chunk)
            case path if path in (*paths.OF_LASTING, *paths.OF_IMPACTS) and not chunk.is_static:
                return _masked(chunk, [np.isin(row, self._numbers) for row in _rows(chunk, "body")])
            case paths.CONTACTS | paths.FORCE_NORMAL | paths.FORCE_FRICTION if "bodies" in chunk.components:
                return _masked(chunk, [self._joins(row) for row in _rows(chunk, "bodies")])
            case paths.IMPACTS if "bodies" in chunk.components:
                kept = [bool(self._joins(row).all()) for row in _rows(chunk, "bodies")]
                return Chunk(chunk.entity_path, chunk.batch.filter(pa.array(kept, pa.bool_())))
            case paths.CONTACTS if not chunk.is_static:
                lines = _vectors(chunk.batch["LineStrips3D:strips"])
                rows = zip(chunk.batch[STEP].to_pylist(), lines, strict=True)
                return _masked(chunk, [self._among(step, row.reshape(-1, 2, 3)) for step, row in rows])
        return chunk

    def _joins(self, ends: IntArray) -> BoolArray:
        """Return a mask of the contacts with ends (2m,) that connect kept bodies, or a kept body and a plane."""
        return join_some(ends.reshape(-1, 2), self._numbers, self._bodies_in_all)

    def _bodies(self, chunk: Chunk) -> Chunk:
        """In lists with one value per body, keep only the values of the kept bodies; other lists are unchanged."""
        columns = {}
        for name in chunk.components:
            lengths = pc.list_value_length(chunk.batch[name])
            if self._shown > 1 and pc.all(pc.equal(lengths, self._shown)).as_py():
                taken = (np.arange(chunk.batch.num_rows)[:, None] * self._shown + self._places).ravel()
                columns[name] = _lists(chunk.batch[name], taken, np.full(chunk.batch.num_rows, len(self._places)))
        return _replaced(chunk, columns)

    def _among(self, step: int, lines: SingleArray) -> BoolArray:
        """Return a mask of a frame's lines (m, 2, 3) that connect kept bodies, or a kept body and a plane."""
        centres = self._centres.pop(step)
        kept = centres[self._places]
        begins = np.any(np.all(lines[:, 0, None] == kept, axis=2), axis=1)  # a line starts exactly at a centre
        ends = np.zeros(len(lines), dtype=np.bool_)
        for line in np.flatnonzero(begins):
            end = lines[line, 1]
            ends[line] = self._meets(end, kept) or not self._meets(end, centres)
        return np.asarray(begins & ends)

    def _meets(self, point: SingleArray, centres: SingleArray) -> bool:
        """Return whether a point is one of the centres or, in a periodic box, an image of a centre."""
        apart = centres.astype(np.float64) - point
        size = float(np.max(np.abs(centres), initial=0.0))
        if self._box is not None:
            apart -= self._box * np.round(apart / self._box)  # the nearest image
            size += float(np.max(self._box))
        return bool(np.any(np.max(np.abs(apart), axis=1) <= _ROUNDING * size))


def _rows(chunk: Chunk, name: str) -> list[IntArray]:
    return [np.asarray(row.values.to_numpy(), dtype=np.int64) for row in chunk.batch[name]]


def _vectors(column: pa.ListArray) -> list[SingleArray]:
    """Read the vectors of each row, (k, 3), from vectors or from lists of vectors."""
    return [plain(row.values).to_numpy().reshape(-1, 3) for row in column]


def _masked(chunk: Chunk, masks: list[BoolArray]) -> Chunk:
    """Keep the same items of every component's lists."""
    mask = np.concatenate([np.zeros(0, dtype=np.bool_), *masks])
    each = np.array([np.count_nonzero(row) for row in masks], dtype=np.int64)
    lengths = [len(row) for row in masks]
    columns = {}
    for name in chunk.components:
        found = pc.list_value_length(chunk.batch[name]).to_pylist()
        # these components describe a whole row, whatever its contacts
        if name in ("impact_count", paths.IMPACT_SUMS, paths.FLOOR):
            continue
        if found == lengths:
            columns[name] = _lists(chunk.batch[name], np.flatnonzero(mask), each)
        elif found == [2 * length for length in lengths]:  # the component has two values per item
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


PROPERTY = "clip"

# entities with rows only at changes, whose last row before the cut still applies
_STATES = (paths.PHASE, paths.DT_LIMIT)
_PATH, _KIND, _COMPONENT = b"rerun:entity_path", b"rerun:kind", b"rerun:component"


@dataclass(frozen=True, slots=True)
class Clip:
    """Result of a cut."""

    path: Path
    size: int  # bytes
    frames: int
    first_step: int
    last_step: int
    start: float  # s, time of the first frame
    end: float  # s, time of the last frame
    replays_from: int | None  # step of the exact state in /state/start; None without one
    bodies: list[int] | None  # bodies in the clip; None for all


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
    """Cut the frames between two simulated times out of a recording.

    Both times (s) are included. An existing file is replaced when the clip is complete. ``bodies`` are the numbers of
    the bodies to show; None shows all. Exact states and fingerprints describe all bodies, so even a clip of a few
    bodies can be replayed. Without exact states, the clip is smaller and contains nothing about the other bodies, but
    cannot be replayed.

    Raises RecordingError if the source cannot be read, has no frame in the interval or no such body, or the clip cannot
    be written.
    """
    recording = Recording.open(source)
    with reading(recording.path):
        cut = _cut(recording, start, end)
        exact = exact and not recording.is_partial
        shown = list(recording.shown) if bodies is None else sorted(set(bodies))
        selection = None if bodies is None else _selection(recording, bodies)
        first = _start(recording, cut) if exact else None
        with Writer(Path(out), recording.store.application_id, str(uuid.uuid4())) as writer:
            # written first, because an unfinished clip would otherwise claim the outcome of the whole run
            about: dict[str, Scalar | IntArray] = {"source": recording.path.name, "from": cut.start, "to": cut.end}
            about["recording_id"] = recording.store.store_id
            if not exact:
                about["partial"] = True
            if len(shown) < recording.info["bodies"]:
                about["bodies"] = np.array(shown, np.int64)
            writer.send_property(PROPERTY, about)
            gone = {paths.START, f"__properties/{PROPERTY}"}
            gone |= set() if exact else {paths.STATIC_STATE, paths.GIVEN_STATE}
            static = (e for e in recording.store.entries if e.is_static and e.entity_path not in gone)
            for chunk in recording.chunks(static):
                writer.send(chunk if selection is None else selection.of(chunk))
            if first is not None:
                writer.send(first)
            if not exact:
                table = recording.bodies
                values = {name: getattr(table, name)[shown] for name in ("group", "mass", "radius", "inertia")}
                writer.log(paths.STATIC_STATE, rr.AnyValues(name=[table.name[body] for body in shown], **values))
            numbers = list[IntArray]()
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
            f"it covers {units.span(times[0], times[-1], TIME, 'g')} with {len(times)} frames, the nearest at "
            f"{units.text(nearest, TIME, 'g')}"
        )
    steps, shown = prints[STEP].to_numpy(), prints[SIM_TIME].cast(pa.int64()).to_numpy()
    first, last = inside[0], inside[-1]
    return _Cut(int(steps[first]), int(steps[last]), int(shown[first]), times[first], times[last], len(inside))


def _between(start: float, end: float, units: UnitSystem) -> str:
    """Name an interval of times (s), one end of which may be infinite."""
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


def _moving(recording: Recording, cut: _Cut) -> Iterator[Chunk]:
    """Read the chunks that overlap the cut, centres before the contacts that connect them."""
    entries = [entry for entry in recording.store.entries if entry.overlaps(cut.first, cut.last)]
    for path in _STATES:
        entries += [e for e in recording.store.frames_of(path, last=cut.first)[-1:] if e not in entries]
    for chunk in recording.chunks(sorted(entries, key=_order)):
        rows = _within(chunk, cut)
        if rows.batch.num_rows:
            yield rows


def _at_impacts(recording: Recording, numbers: Sequence[IntArray]) -> Iterator[Chunk]:
    """Read the bodies at the impacts in the clip."""
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


def _within(chunk: Chunk, cut: _Cut) -> Chunk:
    """Keep the rows of the cut; a state that began earlier starts at the first frame."""
    steps = chunk.batch[STEP].to_numpy()
    inside = (steps >= cut.first) & (steps <= cut.last)
    before = np.flatnonzero(steps < cut.first)
    if chunk.entity_path in _STATES and len(before) and not np.any(steps == cut.first):
        inside[before[-1]] = True
        # rows from before the cut move to its first frame
        batch = chunk.batch.filter(pa.array(inside))
        early = pc.less(batch[STEP], cut.first)
        shown = pa.scalar(cut.first_shown, pa.int64()).cast(pa.duration("ns"))
        moved = {STEP: pc.if_else(early, pa.scalar(cut.first), batch[STEP])}
        moved[SIM_TIME] = pc.if_else(early, shown, batch[SIM_TIME])
        return _replaced(Chunk(chunk.entity_path, batch), moved)
    return Chunk(chunk.entity_path, chunk.batch.filter(pa.array(inside)))


def _start(recording: Recording, cut: _Cut) -> Chunk | None:
    """Store the last exact state at or before the first frame as static data of the clip."""
    entries = recording.store.frames_of(paths.CHECKPOINT, last=cut.first)
    if not entries:
        carried = [e for e in recording.store.entries if e.is_static and e.entity_path == paths.START]
        return next(recording.chunks(carried[-1:]), None)
    (chunk,) = recording.chunks(entries[-1:])
    row = int(np.flatnonzero(chunk.batch[STEP].to_numpy() <= cut.first)[-1])
    kept = [field for field in chunk.batch.schema if (field.metadata or {}).get(_KIND) == b"data"]
    values = [chunk.batch[field.name].slice(row, 1) for field in kept]
    number = pa.field(STEP, pa.list_(pa.int64()), metadata={_KIND: b"data", _COMPONENT: STEP.encode()})
    step = pa.array([[chunk.batch[STEP][row].as_py()]], number.type)
    metadata = dict(chunk.batch.schema.metadata) | {_PATH: f"/{paths.START}".encode()}
    return Chunk(paths.START, pa.record_batch([*values, step], pa.schema([*kept, number], metadata)))
