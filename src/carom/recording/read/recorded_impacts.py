"""The recorded impacts of a run, and the number of unrecorded ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray, IntArray
from carom.contact_table import ImpactSums
from carom.errors import DamageError, NotRecordedError, RecordingError
from carom.recording.read.entities import Column, flat, plain, reading
from carom.recording.read.lookup import interval, shown_body, tolerance
from carom.recording.read.recorded_contacts import (
    MEASURED,
    check_pairs,
    modes,
    of_body,
    table_of,
    with_angular_impulses,
)
from carom.recording.rrd.messages import Chunk, Entry
from carom.recording.schema import paths
from carom.recording.schema.paths import IMPACT_SUMS
from carom.recording.timelines import IMPACT, SIM_TIME, STEP

if TYPE_CHECKING:
    from carom.recording.read.recorded_data import RecordedData


@dataclass(frozen=True, slots=True)
class RecordedImpacts:
    """Numbers of recorded and unrecorded impacts."""

    recorded: int = 0
    left_out: int = 0

    @property
    def count(self) -> int:
        """Number of all impacts."""
        return self.recorded + self.left_out

    def text(self, counted: int | None) -> str:
        """Describe these numbers beside the number of impacts that the run ``counted`` (None: unknown).

        ``counted`` lacks an impact at the end of a step if its bodies neither touch nor press each other afterwards,
        for example because the impulse of a neighbour separated them. Impacts with planes are treated like impacts
        between bodies.
        """
        if self.left_out:
            text = f"{self.recorded} recorded, the largest between frames; {self.left_out} left out"
        else:
            text = {0: "none", 1: "the only one is recorded"}.get(self.recorded, f"all {self.recorded} recorded")
        more = 0 if counted is None else self.count - counted
        if more <= 0:
            return text
        total = f"; in all {self.count}" if self.left_out else ""
        return f"{text}{total}, {more} of them too brief to be counted"


def impacts(recording: RecordedData, start: float | None, end: float | None, body: int | str | None) -> pa.Table:
    """Return the impacts of an interval; see `Recording.impacts`."""
    first, last = interval(recording, start, end)
    number = None if body is None else shown_body(recording, body)
    if not recording.records_contacts:
        raise NotRecordedError(recording.path, "impacts", recording.engine)
    with reading(recording.path):
        table = _recorded(recording, first - tolerance(first), last + tolerance(last))
    return of_body(table, number)


def numbered_impact(recording: RecordedData, number: int) -> tuple[float, int, int, int]:
    """Return time (s), step and ends of a recorded impact, given its number (from 1) on the timeline ``impact``."""
    numbers, rows = impacts_by_number(recording)
    found = np.flatnonzero(numbers == number)
    if not len(found):
        has = "it records no impacts"
        if len(numbers):
            first, last = numbers[0], numbers[-1]
            has = f"its impacts have numbers from {first} to {last}" if first < last else f"its only impact is {first}"
        raise RecordingError(f"{recording.path} has not recorded impact {number}; {has}")
    row = _measured(recording, rows.slice(int(found[0]), 1)).to_pylist()[0]
    return row["time"], row["step"], row["i"], row["j"]


def numbered_impacts(recording: RecordedData) -> tuple[IntArray, pa.Table]:
    """Return the numbers (k,) of all recorded impacts, ascending from 1, and their table; see `Recording.impacts`."""
    numbers, rows = impacts_by_number(recording)
    return numbers, _measured(recording, rows) if len(numbers) else table_of({STEP: numbers}, "")


def _measured(recording: RecordedData, rows: pa.Table) -> pa.Table:
    """Return the table of one or more recorded rows of impacts."""
    with reading(recording.path):
        chunk = Chunk(paths.IMPACTS, rows.to_batches()[0])
        return _table(recording, chunk, _times(recording, chunk))


def impacts_until(recording: RecordedData, step: int) -> RecordedImpacts:
    """Count the impacts up to a step that has a frame; in a clip, the impacts since its first frame.

    In a clip of selected bodies, only recorded impacts are included, since unrecorded impacts may belong to bodies
    outside the clip.
    """
    if not recording.records_contacts or not recording.frames:
        return RecordedImpacts()
    first = int(recording.fingerprints()[STEP][0].as_py())
    steps = recording.impact_steps
    recorded = int(np.count_nonzero(steps <= step))
    if not recording.shows_all:
        return RecordedImpacts(recorded)
    before = 0 if first == 0 else count_at(recording, first) - int(np.count_nonzero(steps <= first))
    count = count_at(recording, step) - before
    if recorded > count:
        raise DamageError(f"{recorded} impacts are recorded up to step {step}, more than the {count} that were counted")
    return RecordedImpacts(recorded, count - recorded)


def impacts_by_number(recording: RecordedData) -> tuple[IntArray, pa.Table]:
    """Read the numbers of all recorded impacts, (k,) ascending, and their rows."""
    return _rows_by_number(recording, recording.store.frames_of(paths.IMPACTS))


def states_by_number(recording: RecordedData) -> dict[str, tuple[IntArray, pa.Table]]:
    """Read the states at impacts: the numbers of each entity's rows, (k,), and the rows; series have two per impact."""
    entries = [entry for entry in recording.store.entries if entry.is_within_steps]
    return {
        path: _rows_by_number(recording, [entry for entry in entries if entry.entity_path == path], least=0)
        for path in sorted({entry.entity_path for entry in entries})
    }


def _rows_by_number(recording: RecordedData, entries: list[Entry], least: int = 1) -> tuple[IntArray, pa.Table]:
    """Read chunks of an entity on the timeline of impacts; consecutive numbers differ by at least ``least``."""
    with reading(recording.path):
        batches = [chunk.batch for chunk in recording.chunks(entries) if chunk.batch.num_rows]
        if not batches:
            return np.empty(0, dtype=np.int64), pa.table({STEP: pa.array([], pa.int64())})
        if any(IMPACT not in batch.schema.names for batch in batches):
            raise DamageError(f"rows of /{entries[0].entity_path} without the numbers of their impacts")
        ordered = sorted(batches, key=lambda batch: batch[IMPACT][0].as_py())
        table = pa.concat_tables([pa.Table.from_batches([batch]) for batch in ordered], promote_options="default")
        table = table.combine_chunks()
        numbers = np.array(table[IMPACT].to_numpy())
        if numbers[0] < 1 or np.any(np.diff(numbers) < least):
            raise DamageError(f"rows of /{entries[0].entity_path} that are not sorted by impact")
        return numbers, table


def count_at(recording: RecordedData, step: int) -> int:
    """Return the number of impacts up to a frame; 0 if the number is not recorded."""
    with reading(recording.path):
        chunk, row = recording.row(paths.CONTACTS, step) or (None, 0)
        if chunk is None or "impact_count" not in chunk.components:
            return 0
        return int(flat(chunk, "impact_count", Column(pa.int64()))[row].as_py())


def sums_between(recording: RecordedData, first: int, last: int) -> ImpactSums | None:
    """Add up the sums over all impacts between the frames of two steps; None if a frame lacks these sums."""
    found = list[ImpactSums]()
    with reading(recording.path):
        for chunk in recording.chunks(recording.store.frames_of(paths.CONTACTS, first, last)):
            steps = chunk.batch[STEP].to_numpy()
            inside = np.flatnonzero((steps > first) & (steps <= last)).tolist()
            if inside and IMPACT_SUMS not in chunk.components:
                return None
            for k in inside:
                row = chunk.batch[IMPACT_SUMS][k]
                if not row.is_valid or len(row) == 0:
                    return None
                sums = np.array(row.values.to_numpy(), dtype=np.float64)
                if not np.isfinite(sums).all():
                    raise DamageError(f"{IMPACT_SUMS} of /{paths.CONTACTS} that are not finite")
                found.append(ImpactSums.of(sums))
    return ImpactSums.over(found)


def _recorded(recording: RecordedData, first: float, last: float) -> pa.Table:
    frames = recording.fingerprints()
    steps, times = frames[STEP].to_numpy(), frames["time"].to_numpy()
    # skip chunks of other steps: no impact is later than the end of its step
    lowest = int(steps[max(0, int(np.searchsorted(times, first)) - 1)])
    later = int(np.searchsorted(times, last, side="right"))
    highest = int(steps[later]) if later < len(steps) else int(steps[-1]) + 1
    entries = recording.store.frames_of(paths.IMPACTS, lowest, highest)
    found, before = [table_of({"step": np.empty(0, np.int64)}, "")], 0
    for chunk in recording.chunks(entries):
        numbers = chunk.batch[IMPACT].to_numpy() if IMPACT in chunk.batch.schema.names else np.empty(0)
        if len(numbers) != chunk.batch.num_rows or np.any(np.diff(numbers, prepend=before) <= 0):
            raise DamageError(f"rows of /{paths.IMPACTS} that are not sorted by number")
        before = int(numbers[-1])
        time = _times(recording, chunk)
        if time[0] <= last and time[-1] >= first:
            table = _table(recording, chunk, time)
            found.append(table.filter(pa.array((time >= first) & (time <= last))))
    told = impacts_until(recording, int(recording.fingerprints()[STEP][-1].as_py()))
    return pa.concat_tables(found).replace_schema_metadata({"source": "recorded", "left_out": str(told.left_out)})


def _times(recording: RecordedData, chunk: Chunk) -> FloatArray:
    """Return the times of the rows of a chunk, in s."""
    scale = 1e-9 * float(recording.info["time_scale"])
    return np.asarray(chunk.batch[SIM_TIME].cast(pa.int64()).to_numpy() * scale)


def _table(recording: RecordedData, chunk: Chunk, time: FloatArray) -> pa.Table:
    path, rows = paths.IMPACTS, chunk.batch.num_rows
    pairs = flat(chunk, "bodies", Column(pa.uint32(), 2)).to_numpy().reshape(-1, 2).astype(np.int64)
    check_pairs(pairs, len(recording.bodies.mass), path)
    normal = flat(chunk, "normal", Column(pa.float32(), 3)).to_numpy().reshape(-1, 3)
    point = plain(chunk.batch["Points3D:positions"]).to_numpy().reshape(rows, 3) + recording.origin
    columns = {
        STEP: chunk.batch[STEP],
        "time": time,
        **dict(zip(("i", "j"), pairs.T.copy(), strict=True)),
        **dict(zip(("x", "y", "z"), point.T.copy(), strict=True)),
        **dict(zip(("nx", "ny", "nz"), normal.T.astype(np.float64), strict=True)),
        **{name: flat(chunk, name, Column(pa.float32())).to_numpy().astype(np.float64) for name in MEASURED},
        "mode": modes(flat(chunk, "mode", Column(pa.uint8())).to_numpy(), path),
    }
    return with_angular_impulses(table_of(columns, ""), recording)
