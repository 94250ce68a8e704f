"""The first difference between two recordings of one run, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from carom.arrays import BoolArray, IntArray
from carom.errors import DamageError
from carom.recording.read.entities import reading
from carom.recording.read.recorded_impacts import count_at, impacts_by_number, states_by_number
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.paths import CLOSING
from carom.recording.schema.series import SERIES
from carom.recording.timelines import IMPACT, SIM_TIME, STEP
from carom.scene.units.dimension import OF_UNIT, TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import body_called

Value = float | str
Reduce = Callable[[Chunk], Chunk]  # keeps only the data of selected bodies
Told = tuple[int, int, str, str, str]  # an event: its step, ns on the timeline, level, kind and text

_OF_IMPACTS = {"approach_speed": "m/s", "energy_lost": "J", "normal_impulse": "N s", "tangential_impulse": "N s"}
_LONG = 80  # characters of a text above which only part of it is shown
_ROW_ID = "rerun.controls.RowId"
_ARROWS = (paths.FORCE_NORMAL, paths.FORCE_FRICTION)  # entities whose rows list the largest impulses first
_REACHING = (paths.PLANES, paths.SHAPES, paths.MOVING)  # entities whose drawn size depends on the first frame
_STATES = (paths.STATIC_STATE, paths.GIVEN_STATE, paths.SCENE_TOML)  # entities with the initial data of a run
_PROPERTY, _CLOSING, _REFERENCES = "__properties/", "__properties/outcome", "__properties/arrows"
# entities about the circumstances of the run, the place of a clip, and the layout
_CIRCUMSTANCES = ("__properties/run", "__properties/clip", "__properties/repair", paths.START, paths.MAGNIFIED)
_NEVER_SAME = ("RecordingInfo:start_time", "wall_time", "profile.")  # prefixes of static components


@dataclass(frozen=True, slots=True)
class Difference:
    """The first frame that differs from the recording, and the difference in this frame."""

    step: int
    time: float  # s, recorded time of the frame
    quantity: str
    body: int | None  # None if the value does not belong to a single body
    recorded: Value
    replayed: Value
    name: str = ""  # name of the body
    unit: str = ""  # SI unit of both values; empty if they have none

    @property
    def by(self) -> float | None:
        """Size of the difference; None if the values are not numbers."""
        if isinstance(self.recorded, str) or isinstance(self.replayed, str):
            return None
        return self.replayed - self.recorded

    def __str__(self) -> str:
        return self.text(SI)

    def text(self, units: UnitSystem) -> str:
        """Describe the difference, in printed units."""
        dimension = OF_UNIT.get(self.unit)

        def shown(value: Value, form: str = "") -> str:
            if dimension is None or isinstance(value, str):
                return f"{value:{form}}" if form else repr(value)
            return units.text(value, dimension, form)

        what = self.quantity + ("" if self.body is None else f" of {body_called(self.body, self.name)}")
        off = "" if self.by is None else f", off by {shown(self.by, '.3g')}"
        values = f"recorded {shown(self.recorded)}, replayed {shown(self.replayed)}"
        return f"step {self.step}, t = {units.text(self.time, TIME, '.9g')}: {what}, {values}{off}"


@dataclass(frozen=True, slots=True)
class Extent:
    """The part of two recordings that is compared."""

    after: int  # step of the last frame before the compared part; -1 if there is none
    last: int  # step of the last frame in the compared part
    to_the_end: bool  # whether the recorded run ends with the compared part, so that later rows are a difference
    # whether both recorders chose impacts, arrows and checkpoints with the same budget
    same_choice: bool
    closed: bool  # whether both recordings have an outcome of the same run
    is_complete: bool  # whether the recording has lost no rows
    same_version: bool  # whether the same version made both, so that words, styles and series agree


def first_difference(
    recorded: Recording, again: Recording, extent: Extent, few: Reduce | None = None
) -> tuple[Difference | None, list[str]]:
    """Find the first difference between two recordings of the same run.

    ``few`` reduces chunks of the second recording to the bodies that the first recording shows. The second value lists
    data that the recording lost, or that another version wrote differently: these are not differences.
    """
    found = _Comparison(recorded, again, extent, few)
    with reading(recorded.path):
        first = found.first()
    return first, list(found.excused)


class _Comparison:
    def __init__(self, recorded: Recording, again: Recording, extent: Extent, few: Reduce | None) -> None:
        self.excused: dict[str, None] = {}  # descriptions of excused differences, in order
        self._recorded, self._again, self._extent, self._few = recorded, again, extent, few
        table = recorded.fingerprints()
        self._times = dict(zip(table[STEP].to_pylist(), table["time"].to_pylist(), strict=True))
        # number of impacts before the compared part
        self._before = count_at(recorded, extent.after) if extent.after >= 0 else 0
        self._count = count_at(again, extent.last)
        self._states = [states_by_number(run) for run in (recorded, again)]  # states at impacts
        numbers, rows = impacts_by_number(again)
        self._steps_of_impacts = dict(
            zip(numbers.tolist(), rows[STEP].to_pylist() if len(numbers) else [], strict=True)
        )
        self._shown_impacts = impacts_by_number(recorded)[0] if few else None
        entries = recorded.store.entries
        self._entities = {entry.entity_path for entry in entries if not entry.is_static}
        self._known = self._entities | {entry.entity_path for entry in entries}

    def first(self) -> Difference | None:
        """Return the difference at the earliest step; within a step, positions come before other data."""
        both = (entry for run in (self._recorded, self._again) for entry in run.store.entries if not entry.is_static)
        groups = {(entry.entity_path, entry.is_within_steps) for entry in both if entry.rows}
        found = [self._rows(*group) for group in sorted(groups, key=_rank) if group[0] != paths.EVENTS]
        found += [self._events(closing=False)]
        if self._extent.closed:
            found += [self._events(closing=True)]
        first = min((one for one in found if one is not None), key=lambda one: one.step, default=None)
        first = first or self._static()
        if first is None:
            return None
        name = "" if first.body is None else self._recorded.bodies.name[first.body]
        return replace(first, time=self._times.get(first.step, np.nan), name=name)

    def _rows(self, path: str, at_impacts: bool) -> Difference | None:
        """Compare the rows of an entity on the timeline of steps, or the rows of states at impacts."""
        extent = self._extent
        ours, theirs = (self._batches(run, path, at_impacts) for run in (self._recorded, self._again))
        if at_impacts and not extent.same_choice:
            none = np.empty(0, np.int64), pa.table({})
            drawn = np.intersect1d(
                self._states[0].get(paths.BODIES, none)[0], self._states[1].get(paths.BODIES, none)[0]
            )
            ours, theirs = (_selected(each, lambda keys: np.isin(keys, drawn)) for each in (ours, theirs))
        is_chosen = path in (paths.IMPACTS, paths.CHECKPOINT) and not at_impacts and not extent.same_choice
        lacks_some = not extent.is_complete or (not extent.same_version and path not in self._known)
        if lacks_some or is_chosen or path == paths.CHECKPOINT:
            own = _keys(self._batches(self._recorded, path, at_impacts))

            def present(keys: IntArray) -> BoolArray:
                there = np.isin(keys, own)
                if lacks_some and not is_chosen and not there.all():
                    self.excused[f"rows of /{path}, because the recording lacks them"] = None
                if lacks_some or is_chosen:
                    return there
                # the new file ends with a checkpoint, and in the recording a warning may have added a checkpoint there
                return there | (keys < extent.last) if not extent.to_the_end else np.ones(len(keys), np.bool_)

            theirs = _selected(theirs, present)
        one: pa.RecordBatch | None = None
        two: pa.RecordBatch | None = None
        while True:
            one, two = one or next(ours, None), two or next(theirs, None)
            if one is None or two is None:
                left = one or two
                return None if left is None else self._only(path, left, 0, recorded=one is not None)
            count = min(one.num_rows, two.num_rows)
            pair = one.slice(0, count), two.slice(0, count)
            if path in _ARROWS and not extent.same_choice:
                pair = pair[0], _shortened(pair[1], pair[0])
            if not _alike(*pair) and (found := self._in_rows(path, *pair)):
                return found
            one, two = (rest if rest.num_rows else None for rest in (one.slice(count), two.slice(count)))

    def _batches(self, run: Recording, path: str, at_impacts: bool) -> Iterator[pa.RecordBatch]:
        """Read an entity's rows within the extent; no batch is empty."""
        extent, again = self._extent, run is self._again
        after, last = (self._before, self._count) if at_impacts else (extent.after, extent.last)
        is_open = extent.to_the_end and extent.is_complete

        def inside(keys: IntArray) -> BoolArray:
            kept = (keys > after) & (is_open | (keys <= last))
            if at_impacts and again and self._shown_impacts is not None:
                kept &= np.isin(keys, self._shown_impacts)
            return np.asarray(kept)

        chunks: Iterable[Chunk] = run.chunks(run.store.frames_of(path, after + 1))
        if at_impacts:
            states = self._states[again].get(path)
            chunks = [Chunk(path, batch) for batch in states[1].to_batches()] if states else []
        for chunk in chunks:
            reduced = self._few(chunk) if again and self._few else chunk
            yield from _selected([reduced.batch], inside, IMPACT if at_impacts else STEP)

    def _in_rows(self, path: str, one: pa.RecordBatch, two: pa.RecordBatch) -> Difference | None:
        """Return the first difference of rows that are not alike; None if the difference is allowed."""
        key = IMPACT if IMPACT in one.schema.names else STEP
        keys = [_key(one).to_pylist(), _key(two).to_pylist()]
        for k, (own, other) in enumerate(zip(*keys, strict=True)):
            if own != other:
                first = own < other
                return self._only(path, one if first else two, k, recorded=first)
            step, rows = self._step(one, k), (one.slice(k, 1), two.slice(k, 1))
            for name in dict.fromkeys(each for row in rows for each in row.schema.names if each not in (_ROW_ID, key)):
                there = [name in row.schema.names for row in rows]
                if not there[0] and not self._extent.same_version:
                    self.excused[f"{name} of /{path}, which is missing"] = None
                elif not all(there):
                    return _unlike(step, f"{name} of /{path}", *map(int, there))
                elif found := value_difference(step, path, name, rows[0][name], rows[1][name]):
                    shown = self._recorded.shown
                    return found if found.body is None else replace(found, body=shown[found.body])
        return None

    def _only(self, path: str, batch: pa.RecordBatch, row: int, *, recorded: bool) -> Difference:
        """Name a row that only one recording has, or has more often."""
        step = self._step(batch, row)
        extra = "" if step in self._times else " without a frame"
        what = f"rows of /{path}{extra}"
        if IMPACT in batch.schema.names:
            there = ("a row", "nothing") if recorded else ("nothing", "a row")
            return _unlike(step, f"impact {_key(batch)[row].as_py()} in /{path}", *there)
        return _unlike(step, what, int(recorded), int(not recorded))

    def _step(self, batch: pa.RecordBatch, row: int) -> int:
        if STEP in batch.schema.names:
            return int(batch[STEP][row].as_py())
        return int(self._steps_of_impacts.get(batch[IMPACT][row].as_py(), self._extent.last))

    def _events(self, closing: bool) -> Difference | None:
        """Compare the events of frames, or the events that were logged when the run ended."""
        extent, lists = self._extent, list[list[Told]]()
        for run in (self._recorded, self._again):
            table = run.events()
            columns = [table[STEP], table[SIM_TIME].cast(pa.int64()), *map(table.column, ("level", "kind", "text"))]
            told: list[Told] = sorted(zip(*(column.to_pylist() for column in columns), strict=True))
            last = np.inf if extent.to_the_end and extent.is_complete else extent.last
            lists.append([e for e in told if (e[3] in CLOSING) == closing and (closing or extent.after < e[0] <= last)])
        ours, theirs = lists
        if ours == theirs:
            return None
        only = [event for pair in ((ours, theirs), (theirs, ours)) for event in pair[0] if event not in pair[1]]
        step = min((event[0] for event in only), default=extent.last)
        if not extent.same_version and [each[:4] for each in ours] == [each[:4] for each in theirs]:
            self.excused["the text of events"] = None
            return None
        if not extent.is_complete and set(ours) <= set(theirs):
            self.excused["events, because the recording lacks them"] = None
            return None
        where = "/events at the end" if closing else "/events"
        return _unlike(step, where, _text_of(ours, theirs), _text_of(theirs, ours))

    def _static(self) -> Difference | None:
        """Compare the data that are recorded once."""
        extent, step = self._extent, min(self._times, default=0)
        ours, theirs = _once(self._recorded), _once(self._again, self._few)
        for path in sorted(ours.keys() | theirs.keys(), key=lambda path: path not in _STATES):
            if path.startswith(_CIRCUMSTANCES) or (path == _CLOSING and not extent.closed):
                continue
            if path.startswith(_REACHING) and self._recorded.clip:
                self.excused["the drawn sizes of planes and walls"] = None
                continue
            own, other = ours.get(path, {}), theirs.get(path, {})
            for name in dict.fromkeys([*own, *other]):
                if name.startswith(_NEVER_SAME) or (
                    # the references were chosen for later frames
                    path == _REFERENCES and name not in other and not (extent.to_the_end and extent.same_choice)
                ):
                    continue
                last = extent.last if path in (_CLOSING, _REFERENCES) else step
                what = _called(path, name)
                if name in own and name in other:
                    found = value_difference(last, path, name, own[name], other[name])
                else:
                    found = _unlike(last, what, int(name in own), int(name in other))
                lost = name not in own and not extent.is_complete
                if found and (lost or (path not in _STATES and not extent.same_version)):
                    self.excused[f"{what}, which {'differs' if name in own else 'is missing'}"] = None
                elif found:
                    return found
        return None


def value_difference(step: int, path: str, name: str, recorded: pa.Array, other: pa.Array) -> Difference | None:
    """Compare the values of a row in two recordings; return the first difference or, for positions, the largest."""
    one, two = _flat(recorded), _flat(other)
    if recorded.null_count or other.null_count:
        raise DamageError(f"rows of /{path} without {name}")
    quantity = f"/{path}" if name == "Scalars:scalars" else _called(path, name)
    if len(one) != len(two):
        return _unlike(step, f"how many values {quantity} has", len(one), len(two))
    if one.dtype.kind != two.dtype.kind or (one.dtype.kind != "S" and one.dtype != two.dtype):
        return _unlike(step, f"type of {quantity}", str(one.dtype), str(two.dtype))
    if one.tobytes() == two.tobytes():
        return None
    if one.dtype.kind == "S":
        return _unlike(step, quantity, *_excerpts(bytes(one[0]).decode(), bytes(two[0]).decode()))
    if one.dtype.kind == "m":
        one, two, quantity = one.astype(np.int64), two.astype(np.int64), f"{quantity} (ns)"
    k = int(np.argmax(other_bits(one, two)))
    if name in paths.CENTRES and np.isfinite(one).all() and np.isfinite(two).all():
        k = int(np.abs(one.astype(np.float64) - two.astype(np.float64)).argmax())
        where = f"{'xyz'[k % 3]} (as drawn in /{path})"
        return Difference(step, np.nan, where, k // 3, one[k].item(), two[k].item(), unit="m")
    unit = _OF_IMPACTS.get(name, "")
    if path == paths.CHECKPOINT:
        from carom.recording.schema.checkpoint_columns import unit_of  # noqa: PLC0415 - loads Numba

        unit = unit_of(name)
    unit = unit or next((series.unit for series in SERIES if series.path == path), "")
    return Difference(step, np.nan, quantity, None, one[k].item(), two[k].item(), unit=unit)


def other_bits(one: NDArray[np.generic], two: NDArray[np.generic]) -> BoolArray:
    """Return a mask of the numbers whose bits differ in two arrays of the same shape and type."""
    differs = one.view(np.uint8) != two.view(np.uint8)
    return np.asarray(differs.reshape(*one.shape, one.itemsize).any(axis=-1))


def _excerpts(one: str, two: str) -> tuple[str, str]:
    """Return two different texts, or their parts around the first difference if they are long."""
    if max(len(one), len(two)) <= _LONG:
        return one, two
    k = next((k for k, (a, b) in enumerate(zip(one, two, strict=False)) if a != b), min(len(one), len(two)))
    begin = max(0, k - _LONG // 2)
    return f"…{one[begin : begin + _LONG]}…", f"…{two[begin : begin + _LONG]}…"


def _unlike(step: int, what: str, recorded: Value, other: Value) -> Difference:
    return Difference(step, np.nan, what, None, recorded, other)


def _called(path: str, name: str) -> str:
    return f"{name} of {f'the property {path[len(_PROPERTY) :]}' if path.startswith(_PROPERTY) else f'/{path}'}"


def _rank(group: tuple[str, bool]) -> tuple[bool, bool, bool, str, bool]:
    """Sort entities: drawn bodies and energies come before other data, and fingerprints come last."""
    path, at_impacts = group
    return path == paths.FINGERPRINT, path != paths.BODIES, not path.startswith(f"{paths.ENERGY}/"), path, at_impacts


def _key(batch: pa.RecordBatch) -> pa.Array:
    """Return the column that numbers the rows of an entity."""
    return batch[IMPACT if IMPACT in batch.schema.names else STEP]


def _keys(batches: Iterable[pa.RecordBatch]) -> IntArray:
    return np.concatenate([np.empty(0, np.int64), *(_key(batch).to_numpy() for batch in batches)])


def _selected(
    batches: Iterable[pa.RecordBatch], mask: Callable[[IntArray], BoolArray], key: str | None = None
) -> Iterator[pa.RecordBatch]:
    """Yield the rows of batches whose numbers a mask selects, without empty batches."""
    for batch in batches:
        kept = mask((batch[key] if key else _key(batch)).to_numpy())
        if kept.any():
            yield batch if kept.all() else batch.filter(pa.array(kept))


def _alike(one: pa.RecordBatch, two: pa.RecordBatch) -> bool:
    """Return whether rows have the same bits, apart from the identifiers that Rerun gives them."""
    names = [{name for name in batch.schema.names if name != _ROW_ID} for batch in (one, two)]
    return names[0] == names[1] and all(_same(one[name], two[name]) for name in names[0])


def _same(one: pa.Array, two: pa.Array) -> bool:
    """Return whether two columns have the same bits in rows of the same lengths."""
    if pa.types.is_list(one.type) and pa.types.is_list(two.type):
        lengths = [pc.list_value_length(column) for column in (one, two)]
        if not lengths[0].equals(lengths[1]):
            return False
    first, second = _flat(one), _flat(two)
    return first.dtype == second.dtype and first.tobytes() == second.tobytes()


def _flat(rows: pa.Array) -> NDArray[np.generic]:
    """Return the numbers of rows, or their texts as a single byte string."""
    values = rows
    while pa.types.is_nested(values.type):
        values = values.flatten()
    if pa.types.is_string(values.type):
        return np.array(["\0".join(str(text) for text in values.to_pylist()).encode()])
    return np.ascontiguousarray(values.to_numpy(zero_copy_only=False))


def _shortened(longer: pa.RecordBatch, shorter: pa.RecordBatch) -> pa.RecordBatch:
    """Keep only the first values of each list, as many as the same row of another batch has."""
    columns = []
    for name in longer.schema.names:
        column = longer[name]
        if pa.types.is_list(column.type) and name in shorter.schema.names:
            there = np.diff(column.offsets.to_numpy())
            kept = np.minimum(there, np.diff(shorter[name].offsets.to_numpy()))
            taken = np.flatnonzero(np.arange(there.sum()) < np.repeat(np.cumsum(there) - there + kept, there))
            offsets = pa.array(np.concatenate([[0], np.cumsum(kept)]), pa.int32())
            column = pa.ListArray.from_arrays(offsets, column.flatten().take(pa.array(taken)), type=column.type)
        columns.append(column)
    return pa.record_batch(columns, schema=longer.schema)


def _once(run: Recording, few: Reduce | None = None) -> dict[str, dict[str, pa.Array]]:
    """Read the one row of each static component, by entity."""
    found: dict[str, dict[str, pa.Array]] = {}
    for chunk in run.chunks(entry for entry in run.store.entries if entry.is_static):
        if (rows := chunk.batch.num_rows) > 1:
            raise DamageError(f"{rows} rows of /{chunk.entity_path}, which is recorded once for all times")
        kept = few(chunk) if few else chunk
        if rows:
            found.setdefault(chunk.entity_path, {}).update({name: kept.batch[name] for name in kept.components})
    return found


def _text_of(events: list[Told], others: list[Told]) -> str:
    """Describe the event that the other list lacks."""
    only = [event for event in events if event not in others]
    if not only:
        return "nothing else"
    step, _, level, kind, text = only[0]
    return f"{level} at step {step}: {text}" + (f" ({kind})" if kind else "")
