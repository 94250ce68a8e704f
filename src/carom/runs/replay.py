"""Runs a recording again and compares every frame with the recorded one, bit for bit."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from carom.event import Event
from carom.physics.frame import Frame
from carom.physics.schedule import at, every
from carom.physics.space import Space
from carom.recording.edit.bundle import opened
from carom.recording.read.lookup import interval, tolerance
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Header, Scalar, TimeScale
from carom.recording.write.recorder import FrameRecorder
from carom.recording.write.whole_file import claimed_output, refuse_itself, refuse_output
from carom.runs.comparison import Mismatch, StaticCheck, Value
from carom.runs.environment import versions
from carom.runs.frame_check import WORDS_OF_EXTREMES, FrameCheck, is_whole, text_of, told_of
from carom.runs.outcome import judge
from carom.runs.run import Watcher, closing_summary, ending_of, header_of, outcome_text
from carom.runs.window import checkpoint_before, space_of
from carom.scene.data.body_sources import changed_files
from carom.scene.forces import FORCES
from carom.scene.units.dimension import OF_UNIT, TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import body_called

_OUTCOME = "the outcome and its numbers (of a part of a run, or a repaired or resumed recording)"
_EXTREMES = "the extremes and the end in /events, which another version recorded"
_UNSTATED = "the outcome and its numbers (the run could not write them, since the disk was full or it failed)"
_NO_OUTCOME = "the outcome and its numbers, which are missing"
_MORE_FRAMES = "the outcome and its numbers (with more frames than the run had)"
TRIAL_SECONDS = 1.0  # after stepping so long, a replay estimates its remaining time

Consent = Callable[[float], bool]  # remaining time (s) → whether to continue


@dataclass(frozen=True, slots=True)
class Difference:
    """The first frame that differs from the recording, and the largest difference in it."""

    step: int
    time: float  # s, recorded
    quantity: str
    body: int | None  # None if the value does not belong to a single body
    recorded: Value
    replayed: Value
    name: str = ""  # of the body
    unit: str = ""  # of both values, in SI; empty if they have none

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
class Replay:
    """Result of a replay."""

    begin: int  # step of the first checkpoint
    frames: int  # recorded frames from `begin` to the end of the window
    compared: int
    difference: Difference | None
    ended: str  # why the replay ended before the end of the window; otherwise empty
    seconds: float
    recorded_with: dict[str, str]
    replayed_with: dict[str, str] = field(default_factory=versions)
    dense: Path | None = None  # the recording of every step
    not_compared: list[str] = field(default_factory=list)  # descriptions of data that could not be compared
    changed_files: list[str] = field(default_factory=list)  # data files that have changed since the recording

    @property
    def same(self) -> bool:
        """Whether every frame was compared, and all its recorded data had the same bits."""
        return self.difference is None and self.compared == self.frames


def replay(
    recording: Recording | str | Path,
    begin: float = 0.0,
    end: float = np.inf,
    *,
    threads: int | None = None,
    dense: str | Path | None = None,
    force: bool = False,
    consent: Consent = lambda seconds: True,
    watch: Watcher = lambda status: None,
) -> Replay:
    """Run a recording again, and compare every frame with the recorded one, bit for bit.

    It begins at the last checkpoint before the window, and ends at the first difference.

    Parameters
    ----------
    recording
        The recording to run again, or its file: an ``.rrd``, or the ``.zip`` that `carom report` made.
    begin, end
        s, the window; by default the whole run.
    threads
        Threads for the kernels; the bits do not depend on it.
    dense
        The ``.rrd`` in which every step of the window is recorded, if any.
    force
        Whether ``dense`` may replace a file.
    consent
        Called once, after a second of stepping, with the remaining time (s); returns whether to continue.
    watch
        Called after every frame with a `StepStatus`: step, time in s, dt, contacts, energy error.

    Returns
    -------
    result
        ``result.same`` states whether all recorded frames have the same bits; ``result.difference`` is the first
        difference. The interrupt key ends a replay early, as ``result.ended`` then states.

    Raises
    ------
    SceneError, RecordingError, PhysicsError
        If the recording cannot be run or holds no frame, the window lies outside of it, or the state is no longer
        finite.
    """
    if not isinstance(recording, Recording):
        with opened(Path(recording)) as path:
            whole = Recording.open(path)
            return replay(whole, begin, end, threads=threads, dense=dense, force=force, consent=consent, watch=watch)
    dense = None if dense is None else Path(dense)
    if dense is not None:
        refuse_output(dense, force)
        refuse_itself(dense, recording.path)
    begin, end = interval(recording, begin, end)
    scene = recorded_scene(recording)
    checkpoint = checkpoint_before(recording, begin)
    records = recording.records_contacts or (dense is not None and scene.record.impacts != "none")
    space = space_of(recording, scene, checkpoint, threads, record_contacts=records)
    run = _Comparison(recording, header_of(space), checkpoint.step, end, dense is None)
    began = clock.perf_counter()
    with ExitStack() as stack:
        recorder = None
        if dense is not None:
            stack.enter_context(claimed_output(dense, force))
            recorder = stack.enter_context(FrameRecorder(dense, header_of(space)))
        ended = _run_again(space, run, recorder, begin, consent, watch)
        if recorder is not None:
            recorder.finish(ended or "completed")
    return Replay(
        begin=checkpoint.step,
        frames=len(run.fingerprints),
        compared=run.compared,
        difference=run.finish(space, ended),
        ended=ended,
        seconds=clock.perf_counter() - began,
        recorded_with=recording.versions,
        dense=dense,
        not_compared=list(run.check.skipped),
        changed_files=changed_files(scene.bodies, [Path(), recording.path.parent]),
    )


def _run_again(
    space: Space, run: _Comparison, recorder: FrameRecorder | None, begin: float, consent: Consent, watch: Watcher
) -> str:
    """Run up to the end of the window or the first difference; return the reason for an earlier end, or an empty text.

    ``recorder`` receives every step from the time ``begin`` (s).
    """
    # the pace excludes the first step, which may include a compilation
    began, first, asked = math.inf, run.begin, False
    schedule = at(run.fingerprints) if recorder is None else every(0.0)
    try:
        for frame in space.run(schedule=schedule):
            watch(space.status)
            if frame.time > run.end:  # a step beyond the window
                break
            run.see(frame)
            if recorder is not None and frame.time >= begin and (frame.step == 0 or frame.step > run.begin):
                recorder.put(frame)
            if began == math.inf and frame.step > run.begin:
                began, first = clock.perf_counter(), frame.step
            spent = clock.perf_counter() - began
            if not asked and spent > TRIAL_SECONDS:
                asked = True
                if not consent(spent * max(0, run.last - space.step) / max(1, space.step - first)):
                    return "declined"
            if run.difference:
                break
            if frame.step >= (run.last if recorder is None else run.last_recorded):
                space.stop()  # a stopped run is judged at its last step
    except KeyboardInterrupt:
        return "stopped by the user"
    return ""


class _Comparison:
    """Compares frames with the recorded ones."""

    def __init__(self, recording: Recording, header: Header, begin: int, end: float, only_recorded: bool) -> None:
        table = recording.fingerprints()
        self.end = end = end + tolerance(end)
        rows = zip(*(table[name].to_pylist() for name in ("step", "fingerprint", "time")), strict=True)
        inside = [(step, bits, time) for step, bits, time in rows if step >= begin and time <= end]
        self.fingerprints = {step: bits for step, bits, _ in inside}
        self._times = {step: time for step, _, time in inside}
        self.begin, self.last = begin, max(self.fingerprints, default=begin)
        self.last_recorded = int(table["step"][-1].as_py())
        self.compared = 0
        self.difference: Difference | None = None
        self._recording = recording
        steps = np.array(list(self.fingerprints), dtype=np.int64)
        self.check = FrameCheck(recording, header, steps, begin, only_recorded and begin in self.fingerprints)

    def see(self, frame: Frame) -> None:
        """Compare a frame, if it was recorded."""
        self.check.gather(frame)
        bits = self.fingerprints.get(frame.step)
        if bits is None:
            return
        self.compared += 1
        differs = bits != frame.fingerprint
        found = self._difference(self.check.finish() if differs else self.check.see(frame))
        if found is None and differs:
            found = _largest_difference(self._recording, frame, self._times[frame.step])
        self.difference = found

    def finish(self, space: Space, ended: str) -> Difference | None:
        """Compare the remaining data after a run, which may have ended early; return the first difference."""
        is_end = self.last == self.last_recorded
        found = [self.difference or self._difference(self.check.finish())]
        if not ended:
            found.append(self._difference(self.check.strays(is_end)))
        first = min((one for one in found if one is not None), key=lambda one: one.step, default=None)
        if first is not None or ended:
            return first
        if self.compared < len(self.fingerprints):
            step = min(step for step in self.fingerprints if step > space.step)
            return Difference(step, self._times[step], "the run ended at step", None, step, space.step)
        first = self._difference(self.check.missing(is_end)) or self._outcome(space)
        if first is None:
            statics = StaticCheck(self._recording, space)
            first = self._difference(statics.difference())
            self.check.skipped |= statics.skipped
        return first

    def _outcome(self, space: Space) -> Difference | None:
        """Compare the outcome of the run, if its end is recorded and was reached.

        Versions differ in verdicts, counts and texts, so differences from a recording of another version are only
        listed.
        """
        recording, skipped = self._recording, self.check.skipped
        if self.last < self.last_recorded:
            return None
        if not recording.closing:
            skipped[_NO_OUTCOME] = None
            return None
        if self.begin > 0 or recording.clip or not is_whole(recording):
            skipped[_OUTCOME] = None
            return None
        if not self.check.all_frames or "steps" not in recording.closing:
            skipped[_MORE_FRAMES if "steps" in recording.closing else _UNSTATED] = None
            return None
        same_version = recording.versions == versions()
        extremes = space.named_extremes()
        verdicts = judge(space.scene, extremes, space.time, space.state)
        replayed: dict[str, Scalar] = {"frames": self.compared, **closing_summary(space, extremes, verdicts)}
        if space.time >= space.scene.end:  # otherwise the user or the system ended it
            replayed["outcome"] = outcome_text(*ending_of(verdicts, space.scene.unit_system))
        for name, value in replayed.items():
            recorded = recording.closing.get(name)
            if name.startswith("profile.") or _alike(recorded, value):
                continue
            if not same_version:
                skipped[f"{name} of the outcome, which another version recorded"] = None
                continue
            one, other = (each if isinstance(each, str) else float(each) for each in (recorded or "nothing", value))
            return Difference(self.last, self._times[self.last], f"{name} of the outcome", None, one, other)
        return self._end(space, same_version)

    def _end(self, space: Space, same_version: bool) -> Difference | None:
        """Compare the events that a run logs at its end: its extremes and its outcome."""
        recording, step = self._recording, self.last
        level = "INFO" if recording.outcome == "completed" else "WARN"
        events = [*space.highlights(), Event(step, self._times[step], level, f"end: {recording.outcome}", "end")]
        found, expected = self.check.closing, told_of(events, TimeScale(float(recording.info["time_scale"])))
        ends = [[event for event in logged if event[3] == "end"] for logged in (found, expected)]
        if ends[0] != ends[1] or [event[:4] for event in found] != [event[:4] for event in expected]:
            if same_version:
                texts = text_of(found, expected), text_of(expected, found)
                return Difference(step, self._times[step], "/events at the end", None, *texts)
            self.check.skipped[_EXTREMES] = None
        elif found != expected:
            self.check.skipped[WORDS_OF_EXTREMES] = None
        return None

    def _difference(self, found: Mismatch | None) -> Difference | None:
        """Add the time and the name of the body."""
        if found is None:
            return None
        time = self._times.get(found.step, np.nan)
        name = "" if found.body is None else self._recording.bodies.name[found.body]
        return Difference(
            found.step, time, found.quantity, found.body, found.recorded, found.replayed, name, found.unit
        )


def _alike(recorded: Any, replayed: Scalar) -> bool:
    """Return whether two values of the outcome have the same bits; empty texts and lists are not recorded."""
    if recorded is None:
        return replayed == ""
    if isinstance(replayed, float) and isinstance(recorded, float):
        return recorded == replayed or (math.isnan(recorded) and math.isnan(replayed))
    return bool(recorded == replayed)


def _largest_difference(recording: Recording, frame: Frame, time: float) -> Difference:
    """Return the largest difference in the first differing quantity: time, positions, then energies."""
    if frame.time != time:
        return Difference(frame.step, time, "time", None, time, frame.time, unit="s")
    recorded = recording.drawn_positions(frame.step)
    if recorded is not None and len(recorded) == len(frame.position):
        shown = (frame.position - recording.origin).astype(np.float32)
        off = np.abs(shown.astype(np.float64) - recorded).max(axis=1)
        if off.max() > 0.0:
            body = int(off.argmax())
            axis = int(np.abs(shown[body] - recorded[body]).argmax())
            values = float(recorded[body, axis]), float(shown[body, axis])
            name = f"{'xyz'[axis]} (as drawn)"
            return Difference(frame.step, time, name, body, *values, recording.bodies.name[body], "m")
    energy = recording.energy()
    rows = np.flatnonzero(energy["step"].to_numpy() == frame.step)
    row = int(rows[0]) if len(rows) else 0
    terms = ("translational", "rotational", *(kind.potential for kind in FORCES if kind.potential))
    for name in (*terms, *dict(frame.energy.others)):
        if len(rows) and name in energy.column_names and energy[name][row].as_py() != frame.energy.term(name):
            value = float(energy[name][row].as_py())
            return Difference(frame.step, time, f"{name} energy", None, value, frame.energy.term(name), unit="J")
    return Difference(frame.step, time, "bits that affect neither drawn positions nor energies", None, 0.0, 0.0)
