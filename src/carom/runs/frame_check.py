"""Compares a replayed frame with its recorded data, row by row and bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa

from carom.arrays import IntArray
from carom.event import Event
from carom.physics.frame import Frame
from carom.recording.edit.clip import Selection
from carom.recording.read.entities import reading
from carom.recording.read.frame_rows import BY_EVENT, RecordedRows, arrow_floors
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.header import Header, TimeScale
from carom.recording.schema.paths import CLOSING, SIM_TIME, STEP
from carom.recording.schema.series import Past, all_series
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.recorder import CheckpointPlan
from carom.runs.comparison import Mismatch, chunk_of, different, same
from carom.runs.environment import versions
from carom.runs.impact_check import ImpactCheck

Told = tuple[int, int, str, str, str]  # step, ns on the timeline, level, kind and text of an event

# frames are compared in batches, since encoding one frame costs as much as encoding a hundred
_MOST_FRAMES, _MOST_BODIES = 128, 20_000

REPAIRED = "; repaired, "  # in the outcome of a repaired recording, which may lack pieces

_LED = "quantities that depend on the steps before the first frame (contacts, torques, dt, events)"
_LARGEST = "quantities that depend on the frames in between (relative errors, sums, events, checkpoints)"
_KEPT = "which frames have a checkpoint (this depends on all earlier frames and on the version)"
_WORDS = "the text of events (another version recorded them)"
WORDS_OF_EXTREMES = "the text of the extremes in /events, which differs"

# a checkpoint does not contain the step that led to it
_BEFORE = {paths.CONTACTS, paths.FORCE_NORMAL, paths.FORCE_FRICTION, paths.TORQUE, paths.ANGULAR_ACCELERATION}
_LARGEST_FIRST = (paths.FORCE_NORMAL, paths.FORCE_FRICTION)  # arrows; the plan limits their number
_ARROWS = "Arrows3D:vectors"
_BY_CHANGE = (paths.PHASE, paths.DT_LIMIT)  # entities with a row at each change

# values that depend on earlier frames, such as errors relative to the largest energy so far
_RELATIVE = {
    paths.MOMENTUM: ("momentum_error", "angular_momentum_error"),
    paths.CHECKPOINT: ("books", "energy_scale", "digest"),
}


class FrameCheck:
    """Compares the rows of frames at ascending steps, from the first frame of a replay.

    The header of the replayed space determines which entities must exist. The replay begins with the checkpoint of the
    step ``begin``. ``all_frames`` states whether it makes exactly the same frames as the run from there on.
    """

    def __init__(self, recording: Recording, header: Header, steps: IntArray, begin: int, all_frames: bool) -> None:
        self.skipped: dict[str, None] = {}  # descriptions of data that could not be compared, in order
        self._path = recording.path
        self._rows = RecordedRows(recording)
        known = {each.path: each.past for each in all_series(header.extensions)}
        self._led_there = _BEFORE | {path for path, past in known.items() if past in (Past.STEP, Past.INTERVAL)}
        self._relative = _RELATIVE | {path: () for path, past in known.items() if past in (Past.INTERVAL, Past.RUN)}
        self._clock = TimeScale(float(recording.info["time_scale"]))
        references = {name: float(value) for name, value in recording.arrow_references.items()}
        header = header if recording.records_contacts else replace(header, record_impacts="none")
        # in a partial replay, the floors of arrows depend on earlier frames
        floors = arrow_floors(recording, int(steps[0])) if len(steps) and steps[0] > 0 else None
        self._encoder = BatchEncoder(header, recording.origin, references, floors_before=floors, everything=True)
        self._arrows = references
        self._steps, self._begin, self.all_frames = steps, begin, all_frames
        self._first_step = int(recording.fingerprints()[STEP][0].as_py())  # has at least one frame
        self._shown, bodies = recording.shown, header.bodies
        # reduces rows to the bodies of a clip; None if it shows all
        self._few = Selection(self._shown, range(bodies), header.box, bodies) if len(self._shown) < bodies else None
        self._impacts = None
        self._same_words = recording.versions == versions()
        # whether all frames so far are frames of the run
        self._whole = all_frames and begin == 0 and is_whole(recording) and not recording.clip
        self._complete = recording.finished and REPAIRED not in recording.outcome  # no rows were lost
        self._is_clip = bool(recording.clip)
        if header.records_contacts:
            whole = self._whole and self._same_words
            self._impacts = ImpactCheck(recording, self._encoder, self._rows, self._few, whole=whole)
            self.skipped = self._impacts.skipped
        self._states = {paths.PHASE: _States(recording.phases()), paths.DT_LIMIT: _States(recording.dt_limits())}
        self._before: dict[str, str] = {}  # the states of the previous frame, by entity
        events = recording.events()
        columns = [events[STEP], events[SIM_TIME].cast(pa.int64()), *map(events.column, ("level", "kind", "text"))]
        logged: list[Told] = list(zip(*(column.to_pylist() for column in columns), strict=True))
        self._events = [event for event in logged if event[3] not in CLOSING]
        self.closing = sorted(event for event in logged if event[3] in CLOSING)
        self._plan = CheckpointPlan() if self._whole else None
        self._planned = set[int]()  # steps of the frames with a checkpoint according to this plan
        self._colours_bodies = header.coloured_by in ("graph", "island")
        self._checkpoints = set(recording.checkpoint_steps)
        self._waiting: list[Frame] = []
        self._room = max(1, min(_MOST_FRAMES, _MOST_BODIES // header.bodies))

    def strays(self, is_end: bool) -> Mismatch | None:
        """Return a row of a step without a recorded frame, which the viewer would show nevertheless.

        With ``is_end``, rows after the compared frames count as well.
        """
        last = int(self._steps[-1]) if len(self._steps) else self._begin
        for path in [*self._rows.entities, *_BY_CHANGE]:
            for steps in self._rows.steps(path):
                inside = steps[(steps >= self._begin) & (is_end | (steps <= last))]
                stray = inside[~np.isin(inside, self._steps)]
                if len(stray):
                    return Mismatch(int(stray[0]), f"rows of /{path} without a frame", len(stray), 0)
        late = [event for event in self._events if is_end and event[0] > last]
        return Mismatch(last, "/events after the last frame", text_of(late, []), "nothing else") if late else None

    def missing(self, is_end: bool) -> Mismatch | None:
        """Return a missing checkpoint or reference, after all frames were found equal."""
        last = int(self._steps[-1])
        chosen = self._encoder.arrow_references.chosen
        unknown = sorted(chosen.keys() - self._arrows.keys())
        self.skipped |= {f"{name} of the property arrows, which is missing": None for name in unknown}
        # only a replay of the whole run has the frames that determined the references; a partial one uses the recorded
        # ones
        for name in sorted(chosen.keys() & self._arrows.keys()) if self._whole else ():
            if self._arrows[name] != chosen[name]:
                if self._same_words:
                    return Mismatch(last, f"{name} of the property arrows", self._arrows[name], chosen[name])
                self.skipped[f"{name} of the property arrows, which differs"] = None
        # at the end, the last frame has a checkpoint; before it, a later warning may add one
        if self._plan is None:
            self.skipped[_KEPT] = None
            return None
        planned = self._planned | ({last} if is_end else set())
        recorded = {step for step in self._checkpoints if step <= last}
        for step in sorted(planned ^ recorded):
            if not (self._same_words and self._complete):
                self.skipped[_KEPT] = None
            elif step < last or is_end:
                return Mismatch(step, f"rows of /{paths.CHECKPOINT}", int(step in recorded), int(step in planned))
        return None

    def gather(self, frame: Frame) -> None:
        """Add the impacts and events up to a frame, whether it was recorded or not."""
        if self._impacts:
            self._impacts.gather(frame)

    def see(self, frame: Frame) -> Mismatch | None:
        """Add a frame; compare the queued frames once there are enough of them."""
        if self._impacts:
            found = self._impacts.see(frame)
            if found:
                return found
        self._waiting.append(frame)
        full = len(self._waiting) >= self._room or frame.step == self._begin
        return self.finish() if full else None

    def finish(self) -> Mismatch | None:
        """Compare the queued frames; return the first difference."""
        frames, self._waiting = self._waiting, []
        if not frames:
            return None
        first = frames[0].step == self._begin and self._begin > 0
        if self._plan is not None:
            self._planned |= {frame.step for frame in self._plan.chosen(frames)}
        found: list[Mismatch] = []
        seen = {paths.CHECKPOINT}
        for rows in self._encoder.rows(frames):
            path = rows.path
            if path in BY_EVENT or not len(rows.steps):  # only entities with one row per frame
                continue
            seen.add(path)
            replayed = chunk_of(rows, self._clock)
            chunk = replayed if self._few is None else self._few.of(replayed)
            if first and path in self._led_there:
                self.skipped[_LED] = None
            elif path in (paths.TORQUE, paths.ANGULAR_ACCELERATION) and path not in self._arrows and self._begin > 0:
                self.skipped[f"/{path}"] = None
            else:
                found += self._rows_differ(chunk, first)
        exact = [frame for frame in frames if frame.step in self._checkpoints]
        if exact:
            found += self._rows_differ(chunk_of(self._encoder.checkpoints(exact), self._clock), first)
        for path in self._rows.entities:
            if path not in seen:
                self.skipped[f"/{path}"] = None
        for frame in frames:
            found += self._state(frame, first) + self._logged(frame, first)
        return min(found, key=lambda mismatch: mismatch.step, default=None)

    def _rows_differ(self, replayed: Chunk, first: bool) -> list[Mismatch]:
        """Compare the rows of an entity at once; if they differ, find the first row that does."""
        path, steps = replayed.entity_path, np.array(replayed.batch[STEP].to_numpy())
        compared = [name for name in replayed.components if not self._skips(path, name, first)]
        block = self._rows.block(path, steps)
        if block is not None and all(name in block.components for name in compared):
            columns = [SIM_TIME, *compared]
            if all(same(block.batch[name], replayed.batch[name]) for name in columns):
                return []
        with reading(self._path):
            for k, step in enumerate(steps):
                if found := self._row(path, int(step), replayed.batch.slice(k, 1), compared):
                    return [found]
        return []

    def _skips(self, path: str, name: str, first: bool) -> bool:
        """Return whether a component cannot be compared, and list it as skipped."""
        if name == "impact_count":  # `ImpactCheck` compares it
            return True
        if name == paths.IMPACT_SUMS and not self.all_frames:
            self.skipped[_LARGEST] = None
            return True
        if path in self._relative and not self.all_frames and name in (self._relative[path] or (name,)):
            self.skipped[_LARGEST] = None
            return True
        if first and self._colours_bodies and path == paths.BODIES and name.endswith("colors"):
            self.skipped[_LED] = None
            return True
        return False

    def _row(self, path: str, step: int, replayed: pa.RecordBatch, compared: list[str]) -> Mismatch | None:
        found = self._rows.at(path, step)
        if not found:
            if self._complete:
                return Mismatch(step, f"rows of /{path}", 0, 1)
            self.skipped[f"/{path}, rows of which are missing"] = None
            return None
        if len(found) > 1:
            return Mismatch(step, f"rows of /{path}", len(found), 1)
        (recorded,) = found
        if path in _LARGEST_FIRST and self._impacts and _ARROWS in recorded.components:
            count = len(recorded.batch[_ARROWS][0].values)
            if (room := self._impacts.arrows.get(step, count)) != count:
                return Mismatch(step, f"arrows of /{path}", count, room)
            # only as many values of each list as were recorded: the first ones, which have the largest impulses
            columns = {}
            for name in replayed.schema.names:
                column = replayed[name]
                if pa.types.is_list(column.type) and name in recorded.batch.schema.names:
                    kept = column[0].values[: len(recorded.batch[name][0].values)]
                    column = pa.ListArray.from_arrays(pa.array([0, len(kept)], pa.int32()), kept, type=column.type)
                columns[name] = column
            replayed = pa.record_batch(list(columns.values()), schema=replayed.schema)
        times = [int(batch[SIM_TIME].cast(pa.int64())[0].as_py()) for batch in (recorded.batch, replayed)]
        if times[0] != times[1]:
            return Mismatch(step, f"sim_time of /{path} (ns)", times[0], times[1])
        for name in compared:
            if name not in recorded.components and self._complete:
                return Mismatch(step, f"{name} of /{path}", 0, 1)
            if name not in recorded.components:
                self.skipped[f"{name} of /{path}, which is missing"] = None
            elif off := different(step, path, name, recorded.batch[name], replayed[name]):
                # rows of a clip contain only the bodies that it shows
                return off if off.body is None else replace(off, body=self._shown[off.body])
        return None

    def _state(self, frame: Frame, first: bool) -> list[Mismatch]:
        """Compare the phase and the limit of dt, which have a row at each change and at the first frame."""
        found = list[Mismatch]()
        time = int(self._clock.nanoseconds([frame.time])[0])
        for path, state in ((paths.PHASE, frame.phase), (paths.DT_LIMIT, frame.dt_limit)):
            recorded, rows = self._states[path].at(frame.step)
            before = self._before.get(path)
            self._before[path] = (recorded or state) if first else state
            changes = int(before != state)
            known = before is not None or frame.step == self._first_step  # whether there is a row for this frame
            if (first and path == paths.DT_LIMIT) or (recorded is None and (self._is_clip or not self._complete)):
                self.skipped[_LED] = None
            elif recorded != state:
                found.append(Mismatch(frame.step, f"/{path}", recorded or "nothing", state))
            elif known and len(rows) != changes and self._complete:
                found.append(Mismatch(frame.step, f"rows of /{path}", len(rows), changes))
            elif len(rows) and rows[0] != time:
                found.append(Mismatch(frame.step, f"sim_time of /{path} (ns)", int(rows[0]), time))
        return found

    def _logged(self, frame: Frame, first: bool) -> list[Mismatch]:
        """Compare the events since the previous frame. Another version may word them differently."""
        if first or not self.all_frames:
            self.skipped[_LED if first else _LARGEST] = None
            return []
        before = self._steps[np.searchsorted(self._steps, frame.step) - 1] if frame.step > self._steps[0] else -1
        recorded = sorted(event for event in self._events if before < event[0] <= frame.step)
        replayed = told_of(frame.events, self._clock)
        if recorded == replayed:
            return []
        alike = all(one[:4] == other[:4] for one, other in zip(recorded, replayed, strict=False))
        if self._same_words or len(recorded) != len(replayed) or not alike:
            return [Mismatch(frame.step, "/events", text_of(recorded, replayed), text_of(replayed, recorded))]
        self.skipped[_WORDS] = None
        return []


def told_of(events: Sequence[Event], clock: TimeScale) -> list[Told]:
    """Return events as they are recorded, in order."""
    times = clock.nanoseconds([event.time for event in events]).tolist()
    return sorted((e.step, time, e.level, e.kind, e.text) for e, time in zip(events, times, strict=True))


def is_whole(recording: Recording) -> bool:
    """Return whether a recording is of one whole run: not repaired, and not resumed, which restarts counts."""
    return "resumed.step" not in recording.properties and REPAIRED not in recording.outcome


class _States:
    """A state that is recorded only when it changes."""

    def __init__(self, table: pa.Table) -> None:
        self._step: IntArray = table[STEP].to_numpy()
        self._time: IntArray = table[SIM_TIME].cast(pa.int64()).to_numpy()  # ns on the timeline
        self._name: list[str] = table["state"].to_pylist()

    def at(self, step: int) -> tuple[str | None, IntArray]:
        """Return the state at a step, and the times of its rows of this step."""
        first, last = (int(np.searchsorted(self._step, step, side=side)) for side in ("left", "right"))
        return self._name[last - 1] if last else None, self._time[first:last]


def text_of(events: list[Told], others: list[Told]) -> str:
    """Describe the event that the other list lacks."""
    only = [event for event in events if event not in others]
    if not only:
        return "nothing else"
    step, _, level, kind, text = only[0]
    return f"{level} at step {step}: {text}" + (f" ({kind})" if kind else "")
