"""Runs a recording again, and compares the new recording with the old one, bit for bit."""

from __future__ import annotations

import math
import tempfile
import time as clock
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from carom.errors import RecordingError
from carom.physics.schedule import at, every
from carom.physics.space import Space
from carom.plan.auto import auto_interval
from carom.recording.edit.bundle import opened
from carom.recording.edit.clip import Selection
from carom.recording.read.first_difference import Difference, Extent, first_difference
from carom.recording.read.frame_rows import Continuation
from carom.recording.read.lookup import interval, tolerance
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Header, SweepMember
from carom.recording.write.recorder import FrameRecorder
from carom.recording.write.whole_file import claimed_output, refuse_itself, refuse_output
from carom.runs.environment import versions
from carom.runs.outcome import judge
from carom.runs.run import Watcher, closing_summary, ending_of, header_of, outcome_text
from carom.runs.window import checkpoint_before, space_of
from carom.scene.data.body_sources import changed_files
from carom.scene.extensions import extensions_of, of_extensions, stamped
from carom.state.frame import Frame

TRIAL_SECONDS = 1.0  # s of stepping after which a replay estimates its remaining time
REPAIRED = "; repaired, "  # marks the outcome of a repaired recording, which may lack pieces

CHOICE = "which impacts, arrows and checkpoints were kept"
OUTCOME = "the outcome"
DENSE = "all but the exact states, since every step has a frame"
INTERVAL = "the interval of the checks, which differs from the scene's"

Consent = Callable[[float], bool]  # remaining time (s) → whether to continue


@dataclass(frozen=True, slots=True)
class Replay:
    """Result of a replay."""

    begin: int  # step of the first checkpoint
    frames: int  # recorded frames from `begin` to the end of the window
    compared: int
    difference: Difference | None
    ended: str  # reason why the replay ended before the end of the window; empty if it did not
    seconds: float
    recorded_with: dict[str, str]
    replayed_with: dict[str, str] = field(default_factory=versions)
    dense: Path | None = None  # path of the recording of every step
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

    The replay begins at the last checkpoint before the window, and ends at the first frame whose state differs. The new
    frames go into a temporary file, which needs as much space as the recording's frames.

    Parameters
    ----------
    recording
        The recording to run again, or its file: an ``.rrd``, or the ``.zip`` that `carom report` made.
    begin, end
        s, the window; by default the whole run.
    threads
        Threads for the kernels; the bits do not depend on it.
    dense
        An ``.rrd`` in which to record every step of the window. If it is given, only the exact states are compared.
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
        If the recording cannot be run or holds no frame, the window lies outside of it, the temporary file cannot be
        written, or the state is no longer finite.
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
    window = _Window(recording, checkpoint.step, end)
    began = clock.perf_counter()
    not_compared, difference = [DENSE], None
    with ExitStack() as stack:
        if dense is not None:
            stack.enter_context(claimed_output(dense, force))
            every_step = stack.enter_context(FrameRecorder(dense, header_of(space)))

            def keep(frame: Frame) -> None:
                if frame.time >= begin and (frame.step == 0 or frame.step > window.begin):
                    every_step.put(frame)

            ended = _run_again(space, window, keep, consent, watch, dense=True)
            every_step.finish(ended or "completed")
        else:
            again = stack.enter_context(_Again.made(window, space))
            ended = _run_again(space, window, again.see, consent, watch)
            difference, not_compared = again.compare(space, ended)
        seconds = clock.perf_counter() - began
    return Replay(
        begin=window.begin,
        frames=len(window.fingerprints),
        compared=window.compared,
        difference=difference or window.difference(space, ended),
        ended=ended,
        seconds=seconds,
        recorded_with=recording.versions,
        replayed_with=versions(of_extensions(extensions_of(scene))),
        dense=dense,
        not_compared=not_compared,
        changed_files=changed_files(scene.bodies, [Path(), recording.path.parent]),
    )


class _Window:
    """The recorded frames of a replay, and the number of frames that were repeated."""

    def __init__(self, recording: Recording, begin: int, end: float) -> None:
        table = recording.fingerprints()
        self.recording, self.begin, self.end = recording, begin, end + tolerance(end)
        rows = zip(*(table[name].to_pylist() for name in ("step", "fingerprint", "time")), strict=True)
        inside = [(step, bits, time) for step, bits, time in rows if step >= begin and time <= self.end]
        self.fingerprints = {step: bits for step, bits, _ in inside}
        self._times = {step: time for step, _, time in inside}
        self.first, self.last = min(self.fingerprints, default=begin), max(self.fingerprints, default=begin)
        self.last_recorded = int(table["step"][-1].as_py())
        self.compared = 0
        self.differs: int | None = None  # the first step whose state differs

    def see(self, frame: Frame) -> None:
        """Compare the state of a frame, if the recording has this frame."""
        bits = self.fingerprints.get(frame.step)
        self.compared += bits is not None
        if bits not in (None, frame.fingerprint):
            self.differs = frame.step

    def difference(self, space: Space, ended: str) -> Difference | None:
        """Return the difference between the states, or between the lengths of the runs."""
        if self.differs is not None:
            return Difference(self.differs, self._times[self.differs], "the exact state", None, "one", "another")
        if ended or self.compared == len(self.fingerprints):
            return None
        step = min(step for step in self.fingerprints if step > space.step)
        return Difference(step, self._times[step], "the run ended at step", None, step, space.step)


def _run_again(
    space: Space,
    window: _Window,
    keep: Callable[[Frame], None],
    consent: Consent,
    watch: Watcher,
    *,
    dense: bool = False,
) -> str:
    """Run up to the end of the window or the first state that differs; return the reason if it ends earlier.

    ``keep`` receives a frame of each recorded step, or of every step.
    """
    # the pace leaves out the first step, which may include a compilation
    began, first, asked = math.inf, window.begin, False
    try:
        for frame in space.run(schedule=every(0.0) if dense else at(window.fingerprints)):
            watch(space.status)
            if frame.time > window.end:  # the step ends beyond the window
                break
            window.see(frame)
            keep(frame)
            if began == math.inf and frame.step > window.begin:
                began, first = clock.perf_counter(), frame.step
            spent = clock.perf_counter() - began
            if not asked and spent > TRIAL_SECONDS:
                asked = True
                if not consent(spent * max(0, window.last - space.step) / max(1, space.step - first)):
                    return "declined"
            if window.differs is not None:
                break
            if frame.step >= (window.last_recorded if dense else window.last):
                space.stop()  # the stopped run is compared at its last step
    except KeyboardInterrupt:
        return "stopped by the user"
    return ""


class _Again:
    """Records the window once more: from frame 0 on, or else without the first frame of the window.

    If a window begins later than the run, it continues from the recorded values of its first frame, as a resumed run
    does.
    """

    def __init__(self, window: _Window, space: Space, path: Path) -> None:
        recording = window.recording
        self._window, self._path, self._recording = window, path, recording
        is_whole = "resumed.step" not in recording.properties and REPAIRED not in recording.outcome
        used = extensions_of(space.scene)
        same = recording.versions == versions(of_extensions(used)) and stamped(recording.info) == used
        # whether the replay begins at the start of the run, and the run's recorder received all frames from the start
        self._is_whole = window.begin == 0 and is_whole and not recording.clip
        self._same_choice, self._same_version = self._is_whole and same, same
        self._header = self._header_of(space)
        self._before: Frame | None = None
        self._last: int | None = None
        self._recorder = self._record() if window.first == 0 else None

    @classmethod
    @contextmanager
    def made(cls, window: _Window, space: Space) -> Iterator[_Again]:
        """Make the temporary file, which is removed when the context ends."""
        try:
            folder = tempfile.TemporaryDirectory(prefix="carom-replay-", ignore_cleanup_errors=True)
        except OSError as error:
            raise _unwritable(str(error)) from error
        with folder as place, ExitStack() as stack:
            again = cls(window, space, Path(place) / "again.rrd")
            stack.callback(again.close)
            yield again

    def see(self, frame: Frame) -> None:
        """Record a frame."""
        with _writing():
            if self._recorder is None and frame.step > self._window.first and self._before is not None:
                self._recorder = self._record(self._before)
            if self._recorder is not None:
                self._recorder.put(frame)
                self._last = frame.step
        self._before = frame

    def compare(self, space: Space, ended: str) -> tuple[Difference | None, list[str]]:
        """Close the file, compare it with the recording, and list the data that cannot be compared."""
        recording, window = self._recording, self._window
        reached_end = not ended and self._last == window.last_recorded and window.differs is None
        closed = reached_end and self._is_whole and "steps" in recording.closing
        not_compared = [] if self._same_choice else [CHOICE]
        if reached_end and not closed:
            not_compared.append(OUTCOME)
        usual = auto_interval(space.scene, space.scene.time.duration)
        if recording.check_interval not in (None, usual) and "resumed.step" not in recording.properties:
            # the program that ran the scene chose the interval of frames, and the replay uses the same interval
            not_compared.append(INTERVAL)
        if self._recorder is None or self._last is None:
            return None, not_compared
        extremes = space.named_extremes()
        verdicts = judge(space.scene, extremes, space.time, space.state)
        outcome = recording.outcome  # an outcome that the user or the system caused cannot be compared
        if space.time >= space.scene.end:
            outcome = outcome_text(*ending_of(verdicts, space.scene.unit_system))
        with _writing():
            self._recorder.finish(outcome, closing_summary(space, extremes, verdicts), space.highlights())
        extent = Extent(
            after=-1 if window.first == 0 else window.first,
            last=self._last,
            to_the_end=reached_end,
            same_choice=self._same_choice,
            closed=closed,
            is_complete=recording.finished and REPAIRED not in recording.outcome,
            same_version=self._same_version,
        )
        few = None
        if not recording.shows_all:
            bodies = self._header.bodies
            few = Selection(recording.shown, range(bodies), self._header.box, bodies).of
        found, excused = first_difference(recording, Recording.open(self._path), extent, few)
        return found, [*not_compared, *excused]

    def close(self) -> None:
        """End the thread of the recorder."""
        if self._recorder is not None:
            self._recorder.__exit__(None, None, None)

    def _record(self, before: Frame | None = None) -> FrameRecorder:
        recording = self._recording
        continued = None if before is None else Continuation(recording, before.step, before.checkpoint)
        steps = None if self._same_choice else frozenset(recording.checkpoint_steps)
        with _writing():
            return FrameRecorder(self._path, self._header, continued=continued, checkpoints=steps)

    def _header_of(self, space: Space) -> Header:
        """Return the header that the run's recorder had, with the circumstances of that run."""
        recording, scene, header = self._recording, space.scene, header_of(space)
        # the order of placement is: explicit bodies, data, groups
        given = [(-1, len(scene.body)), *((-2 - k, len(columns.mass)) for k, columns in enumerate(scene.data))]
        numbers, counts = zip(*given, *((k, group.count) for k, group in enumerate(scene.group)), strict=True)
        swept = dict(recording.parameters)
        return replace(
            header,
            group=np.repeat(np.array(numbers, np.int64), counts),
            # if the recorder's choice of impacts and arrows is unknown, all are compared
            record_impacts=header.record_impacts if self._same_choice or not header.records_contacts else "all",
            properties={
                name: each for name, each in recording.properties.items() if isinstance(each, str | int | float)
            },
            member=SweepMember(str(swept.pop("name", "")), swept, "") if swept else None,
        )


@contextmanager
def _writing() -> Iterator[None]:
    try:
        yield
    except RecordingError as error:
        raise _unwritable(str(error)) from error


def _unwritable(why: str) -> RecordingError:
    told = "a replay records the run again in a temporary file"
    return RecordingError(f"{told}, which failed: {why}; set TMPDIR to a folder with more space")
