"""Compares the impacts of a replay, and the states at impacts, with the recorded ones, bit for bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from carom.arrays import IntArray, Records
from carom.contact_table import CONTACT_ROW
from carom.physics.contact.contact_tap import MOST_IMPACTS
from carom.physics.frame import Frame
from carom.recording.edit.clip import Selection
from carom.recording.read.entities import Column, flat, reading
from carom.recording.read.frame_rows import RecordedRows
from carom.recording.read.recorded_impacts import RecordedImpacts, impacts_by_number, impacts_until, states_by_number
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.header import TimeScale
from carom.recording.schema.paths import IMPACT, SIM_TIME, STEP
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.impact_frames import instants
from carom.recording.write.impact_plan import ImpactPlan, Kept, impact_rows, largest
from carom.runs.comparison import Mismatch, chunk_of, different, same

LEFT_OUT = "the number of impacts that were not recorded (only the largest between two frames are)"
ROOM = "the numbers of contacts with arrows and of impacts with frames"
FIRST_STATES = "states at impacts before the first frame"
OF_OTHERS = "impacts of bodies that the clip does not show"


class _Interval(NamedTuple):
    """The impacts of a replay between two recorded frames."""

    frame: Frame  # at the end of the interval
    before: Frame | None  # at its beginning
    impacts: Records  # (k,) CONTACT_ROW, in order of time
    kept: Kept | None  # numbers of impacts that should be recorded; None if unknown
    numbers: IntArray  # (k,)
    begin: int  # number of impacts of the run before the interval
    end: int  # number of impacts up to its end


class ImpactCheck:
    """Compares impacts between one recorded frame and the next.

    ``few`` selects the bodies of a clip that shows only some. The recorder's plan is known if ``whole``: this version
    made the recording, and the replay has all frames since the start of the run.
    """

    def __init__(
        self,
        recording: Recording,
        encoder: BatchEncoder,
        rows: RecordedRows,
        few: Selection | None = None,
        *,
        whole: bool = False,
    ) -> None:
        self.skipped: dict[str, None] = {}  # descriptions of data that could not be compared
        self._path = recording.path
        self._numbers, self._recorded = impacts_by_number(recording)
        self._states = states_by_number(recording)
        self._rows, self._encoder, self._few = rows, encoder, few
        self._clock = TimeScale(float(recording.info["time_scale"]))
        self._references = {name: float(value) for name, value in recording.arrow_references.items()}
        steps = recording.fingerprints()[STEP]
        self._first_step = int(steps[0].as_py()) if len(steps) else 0  # a clip has no impacts before this step
        self._last_step = int(steps[-1].as_py()) if len(steps) else -1
        # a clip has the closing properties of the whole run
        self._closing: Mapping[str, Any] = {} if recording.clip else recording.closing
        self._leaves_out = impacts_until(recording, self._last_step).left_out > 0
        self._plan = ImpactPlan.of(encoder.header) if whole and few is None else None
        self.arrows: dict[int, int] = {}  # number of arrows that a frame should have, by step, where known
        if self._plan is None:
            self.skipped |= {ROOM: None, **({LEFT_OUT: None} if self._leaves_out else {})}
        if few:
            self.skipped[OF_OTHERS] = None
        self._since: list[Records] = []
        self._missed = 0  # impacts that the replay left out
        # the previous recorded frame, and the number of impacts up to it
        self._before: tuple[Frame, int | None] | None = None

    def gather(self, frame: Frame) -> None:
        """Add the impacts since the previous frame of the replay, whether or not the frame was recorded."""
        if frame.impacts is not None and len(frame.impacts):
            self._since.append(frame.impacts)
        self._missed += frame.impacts_left_out

    def see(self, frame: Frame) -> Mismatch | None:
        """Compare the impacts gathered up to a recorded frame."""
        impacts = np.concatenate([np.empty(0, CONTACT_ROW), *self._since])
        found = len(impacts) + self._missed
        before, counted = self._before or (None, None)
        count = self._count_at(frame.step)
        impacts = impacts[largest(impacts, MOST_IMPACTS)]  # as many as a recorded run stores between two frames
        kept = None  # the numbers of impacts and contacts since the previous frame that the plan records
        if self._plan is not None:
            contacts = 0 if frame.contact_rows is None else len(frame.contact_rows)
            edges, rows, number = (np.array([each]) for each in (len(frame.contacts), contacts, len(impacts)))
            hardest = np.array([impacts["normal_impulse"].max(initial=0.0)])
            kept = self._plan.choose(frame.position[None], edges, rows, number, hardest)
            self.arrows[frame.step] = int(kept.arrows[0])
        self._since, self._missed, self._before = [], 0, (frame, count)
        if count is None:
            self.skipped[f"impacts, where rows of /{paths.CONTACTS} are missing"] = None
            return None
        if counted is not None and count - counted != found:
            return Mismatch(frame.step, "impacts since the previous frame", count - counted, found)
        numbers = count - found + 1 + np.arange(len(impacts))
        interval = _Interval(frame, before, impacts, kept, numbers, count - found, count)
        other = self._impacts_differ(interval) or self._states_differ(interval)
        return other or (self._end_differs(frame.step, count) if frame.step == self._last_step else None)

    def _impacts_differ(self, interval: _Interval) -> Mismatch | None:
        recorded = _within(self._numbers, interval)
        own = self._numbers[recorded]
        if interval.kept is not None:
            chosen = largest(interval.impacts, int(interval.kept.impacts[0]))
        elif self._few or (self._leaves_out and interval.before is None):
            chosen = np.flatnonzero(np.isin(interval.numbers, own))
        elif self._leaves_out:
            chosen = largest(interval.impacts, max(1, len(own)))
        else:
            chosen = np.flatnonzero(interval.impacts["step"] >= self._first_step)
        numbers, impacts = interval.numbers[chosen], interval.impacts[chosen]
        if not np.array_equal(numbers, own):
            return _other_choice(interval.frame.step, paths.IMPACTS, own, numbers)
        if not len(own):
            return None
        encoder = self._encoder
        rows = impact_rows(impacts, numbers, self._references, encoder.header, encoder.origin)
        replayed = chunk_of(rows, self._clock)
        columns = [STEP, SIM_TIME, *replayed.components]
        return self._differ(impacts["step"], self._recorded.slice(recorded.start, len(own)), replayed, columns)

    def _states_differ(self, interval: _Interval) -> Mismatch | None:
        """Compare the states at the largest of the recorded impacts."""
        own = self._states_within(paths.BODIES, interval)[0]
        if len(own) and interval.before is None and interval.frame.step > 0:
            self.skipped[FIRST_STATES] = None
            return None
        recorded = self._numbers[_within(self._numbers, interval)]
        room = len(own) if interval.kept is None else int(interval.kept.scenes[0])
        before = interval.before
        if before is None or interval.frame.time <= before.time:
            room = 0
        drawable = np.flatnonzero(np.isin(interval.numbers, recorded))
        if self._few:
            chosen = drawable[np.isin(interval.numbers[drawable], own)]
        else:
            chosen = drawable[largest(interval.impacts[drawable], room)]
        expected = interval.numbers[chosen]
        if not np.array_equal(own, expected):
            return _other_choice(interval.frame.step, f"{paths.BODIES} at impacts", own, expected)
        if before is None or not len(own):
            return None
        found = instants(self._encoder.header, before, interval.frame, interval.impacts, chosen, expected)
        chunks = {rows.path: chunk_of(rows, self._clock) for rows in self._encoder.at_impacts(found)}
        for path in sorted(chunks.keys() | self._states.keys()):
            numbers, rows = self._states_within(path, interval)
            replayed = chunks.get(path)
            if replayed is not None and self._few:
                replayed = self._few.of(replayed)
            wanted = np.empty(0, np.int64) if replayed is None else replayed.batch[IMPACT].to_numpy()
            if not np.array_equal(numbers, wanted):
                return _other_choice(interval.frame.step, f"{path} at impacts", numbers, wanted)
            if replayed is not None:
                steps = interval.impacts["step"][np.searchsorted(interval.numbers, numbers)]
                columns = [name for name in replayed.batch.schema.names if name == SIM_TIME] + replayed.components
                if mismatch := self._differ(steps, rows, replayed, columns):
                    return mismatch
        return None

    def _states_within(self, path: str, interval: _Interval) -> tuple[IntArray, pa.Table]:
        """Return the numbers and the rows of an entity at the impacts of an interval."""
        numbers, table = self._states.get(path, (np.empty(0, np.int64), pa.table({})))
        inside = _within(numbers, interval)
        rows = table.slice(inside.start, inside.stop - inside.start)
        return numbers[inside], rows

    def _differ(self, steps: IntArray, recorded: pa.Table, replayed: Chunk, columns: list[str]) -> Mismatch | None:
        with reading(self._path):
            for name in columns:
                if name not in recorded.column_names:
                    return Mismatch(int(steps[0]), f"{name} of /{replayed.entity_path}", "nothing", "values")
                one, other = _whole(recorded[name]), _whole(replayed.batch[name])
                if not same(one, other):
                    for row, step in enumerate(steps.tolist()):
                        found = different(step, replayed.entity_path, name, one.slice(row, 1), other.slice(row, 1))
                        if found:
                            return found
                    return None
        return None

    def _end_differs(self, step: int, count: int) -> Mismatch | None:
        """Find rows of impacts after the last frame, and compare the outcome's numbers of impacts with the rows."""
        drawn = ((f"{path} at impacts", numbers) for path, (numbers, _) in self._states.items())
        for path, numbers in ((paths.IMPACTS, self._numbers), *drawn):
            if len(numbers) and numbers[-1] > count:
                return Mismatch(step, f"the last impact of /{path}", int(numbers[-1]), count)
        for name, found in asdict(RecordedImpacts(len(self._numbers), count - len(self._numbers))).items():
            said = self._closing.get(f"impacts.{name}")
            if said is None and self._closing:
                self.skipped[f"impacts.{name} of the property outcome, which is missing"] = None
            elif said is not None and not np.array_equal(said, found):
                shown = said if isinstance(said, int | float) else str(said)
                return Mismatch(step, f"impacts.{name} of the property outcome", shown, found)
        return None

    def _count_at(self, step: int) -> int | None:
        """Return the recorded number of impacts up to a frame; None if it is missing."""
        with reading(self._path):
            for chunk in self._rows.at(paths.CONTACTS, step):
                if "impact_count" in chunk.components:
                    return int(flat(chunk, "impact_count", Column(pa.int64()))[0].as_py())
        return None


def _within(numbers: IntArray, interval: _Interval) -> slice:
    """Return a mask of the ascending numbers that belong to impacts of an interval."""
    first, last = np.searchsorted(numbers, [interval.begin, interval.end], side="right")
    return slice(int(first), int(last))


def _other_choice(step: int, path: str, recorded: IntArray, expected: IntArray) -> Mismatch:
    """Name the first impact that is recorded but should not be, or should be but is not."""
    if np.array_equal(np.unique(recorded), np.unique(expected)):
        return Mismatch(step, f"the number of rows of /{path}", len(recorded), len(expected))
    number = int(np.setxor1d(recorded, expected)[0])
    values = ("nothing", "a row") if number in expected else ("a row", "nothing")
    return Mismatch(step, f"impact {number} in /{path}", *values)


def _whole(column: pa.Array | pa.ChunkedArray) -> pa.Array:
    whole = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    return whole.cast(pa.int64()) if pa.types.is_duration(whole.type) else whole
