"""`Recorder`: records another engine's run, frame by frame, while the user's program advances the engine."""

from __future__ import annotations

import operator
import os
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from carom.arrays import IntArray
from carom.engines.faults import Fault, Tolerances
from carom.engines.observer import Observer, header_of_source, not_finite
from carom.engines.population import Population, ids_of
from carom.engines.snapshot_writer import SnapshotWriter, Unrecorded, sentence_of
from carom.engines.source import (
    BulkSource,
    Model,
    Setup,
    Source,
    State,
    StateMemory,
    SteppedSource,
    refuse_invalid_state,
    setup_of,
    text_from,
    time_of,
)
from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.schema.header import LARGEST
from carom.recording.write.whole_file import claimed_output, refuse_name
from carom.runs.environment import environment
from carom.scene.units.dimension import LENGTH, MASS, TIME, UnitError
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import Names, told_by

COMPLETED = "completed"
CONSTANTS = {"mass": MASS, "radius": LENGTH}  # arrays of a model that must not change while bodies lack ids
LONGEST_TURN = 10.0  # s, longest wait of a thread while another thread is in `frame`, which may never return


class Recorder:
    """Records the states of a source; use it as a context, and call `frame` after every step.

    `frame` only copies the state; another thread encodes, audits and writes it. `frame` waits while that thread is
    behind, so no frame is dropped. A fault is a line in the recording's log, and an entry in `faults`.

    After its creation, a recorder never raises an exception into the run that it watches. If something cannot be
    recorded, it adds a note to the recording, to `problems` and, once, to stderr, and the run continues. A state that
    is not finite, a time that decreased or a full disk ends the recording. A state whose arrays have wrong shapes is
    left out.

    Parameters
    ----------
    source
        The other engine's run, such as ``carom.record.mujoco(model, data)``.
    path
        The ``.rrd`` to write.
    last
        Number of last frames that are kept in memory, instead of recording all frames. They are written when a state is
        not finite, when the time decreases (as in MuJoCo, which resets itself), when an exception leaves the context,
        when the program ends before `finish`, and by `write`.
    every
        Record one of this many calls of `frame`. By default the source decides: each call, or fewer for PyBullet with
        200 bodies or more.
    title
        Title of the recording; by default the name of the engine.
    duration
        s, the duration of the run, needed only above 292 years.
    exact
        Whether every frame stores the exact state in float64, which cannot be recomputed later. Otherwise about one
        frame in ten stores it, and the others store positions in float32.
    tolerances
        Errors above which the audit reports a fault.
    units
        Units of the source: a length, a time and a mass, such as ``"au, day, solar mass"``, or ``"dimensionless"``; by
        default the units that the source states, or SI.
    force
        Whether to replace a file that exists.

    Raises
    ------
    RecordingError
        If the units are invalid, the path cannot be written, or the source or its present state is invalid.
    """

    def __init__(
        self,
        source: Source,
        path: str | Path,
        *,
        last: int | None = None,
        every: int | None = None,
        title: str | None = None,
        duration: float = 0.0,
        exact: bool = True,
        tolerances: Tolerances | None = None,
        units: str | None = None,
        force: bool = False,
    ) -> None:
        if last is not None and not _counts(last):
            raise RecordingError(f"last = {last}: expected a whole number of frames, at least one")
        if not isinstance(getattr(source, "model", None), Model) or not callable(getattr(source, "state", None)):
            raise RecordingError(
                f"{type(source).__name__} is not a source: it needs `model`, a carom.record.Model, and a method `state`"
            )
        self.every = source.model.every if every is None else every
        if not _counts(self.every):
            raise RecordingError(
                f"every = {self.every!r}: expected 1 to record each call of `frame`, 2 for every second call, and so on"
            )
        if not 0.0 <= duration <= LARGEST:
            raise RecordingError(f"duration = {duration}: expected the time that the run will reach, or 0 if unknown")
        try:
            named = units or source.model.units
            self._units = UnitSystem.of_text(named) if named else SI
        except UnitError as error:
            raise RecordingError(f'units = "{named}": {error}') from None
        self.path = Path(path)
        refuse_name(self.path)
        with claimed_output(self.path, force):
            pass  # checked now, so that a folder that cannot be written is noticed before the run
        self._source, self._exact, self._force = source, exact, force
        self._read: Callable[[StateMemory], None] = lambda snapshot: snapshot.take(source.state())
        self._stepped = source.stepped if isinstance(source, SteppedSource) else None
        self._title, self._duration = "" if title is None else text_from(title), duration
        self._tolerances = tolerances or Tolerances()
        self._calls = 0
        self._time = -np.inf
        self._ended = ""  # reason why no more frames are accepted; empty while frames are accepted
        self._ring: deque[tuple[int, StateMemory]] | None = None if last is None else deque(maxlen=int(last))
        first = source.state()
        self._model = source.model  # model of the first bodies
        self._setup: Setup | None = None  # setup of these bodies; None before the first bodies exist
        self._ids: IntArray | None = None
        self._unrecorded = Unrecorded(self.path)
        if not _is_empty(first):
            self._begin_with(first)
        self._new: Callable[[], StateMemory] = lambda: StateMemory.like(first)
        if isinstance(source, BulkSource):
            self._read, self._new = source.read, source.memory
        self._free: StateMemory | None = None  # memory of a state, ready for the next frame
        self._sink: SnapshotWriter | None = None
        self._written = self._taken = 0
        self._lock, self._owner = threading.Lock(), 0  # number of the thread that is recording a frame; 0 for none
        self.faults: list[Fault] = []

    @property
    def frames(self) -> int:
        """Number of frames that were recorded or are in memory."""
        return self._taken if self._ring is None else len(self._ring)

    @property
    def problems(self) -> list[str]:
        """Sentences about everything that could not be recorded so far; the recording also contains them."""
        return list(self._unrecorded.texts)

    def frame(self) -> bool:
        """Record the present state; return whether the recording continues. Raises nothing; see `problems`.

        Threads take turns. A call from within the source's `state` is refused, since it would record a state twice.
        """
        this = threading.get_ident()
        if self._owner == this:
            self._note("`frame` was called within `state` of the source.", "This call records nothing.")
            return not self._ended
        with self._turn(this):
            try:
                self._take_frame()
            except Exception as error:
                self._note(error, "This state is not recorded.")
        return not self._ended

    @contextmanager
    def _turn(self, thread: int) -> Iterator[None]:
        """Wait until no other thread uses the recorder, but at most `LONGEST_TURN`, since a thread may never end."""
        taken = self._owner != thread and self._lock.acquire(timeout=LONGEST_TURN)
        before, self._owner = self._owner, thread
        try:
            yield
        finally:
            self._owner = before
            if taken:
                self._lock.release()

    def _note(self, problem: Exception | str, consequence: str) -> None:
        self._unrecorded.add(self._calls - 1, self._time_of_note, problem, consequence)

    def write(self, path: str | Path | None = None, outcome: str = "written on demand") -> Recording | None:
        """Write the frames in memory; recording into memory continues. None if the file cannot be written.

        Raises RecordingError if frames are not kept in memory.
        """
        if self._ring is None:
            raise RecordingError(f"{self.path} is written during the run; give last=N to keep frames in memory")
        try:
            with self._turn(threading.get_ident()):
                target = self._next_path() if path is None else Path(path)
                self._dump(target, outcome, ())
            return Recording.open(target)
        except Exception as error:
            self._note(error, "The frames in memory are not written.")
            return None

    def finish(self, outcome: str = COMPLETED) -> None:
        """Close the recording, like leaving the context. Raises nothing; see `problems`."""
        with self._turn(threading.get_ident()):
            expect_finish(self, False)
            sink, self._sink = self._sink, None
            if sink is not None:
                self._ended = self._ended or outcome
                self._close(sink, outcome, ())

    def __enter__(self) -> Self:
        with self._turn(threading.get_ident()):
            self._take_frame()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self.finish()
        else:
            self.finish_early(f"failed: {type(error).__name__}: {told_by(error)}")

    def finish_early(self, outcome: str) -> None:
        """Close the recording of a run that did not end normally: frames in memory are also written."""
        if self._ring and not self._ended:
            self.write(outcome=outcome)
        self.finish(outcome)

    def _take_frame(self) -> None:
        call, self._calls = self._calls, self._calls + 1
        if call and self._stepped is not None:
            self._stepped()
        if self._ended or call % self.every:
            return
        # get memory for a copy of the state, and wait for the writer if all memory is in use
        snapshot, self._free = self._free, None
        if snapshot is None:
            snapshot = self._new() if self._sink is None else self._sink.spare()
        try:
            self._read(snapshot)
            recorded = self._keep(call, snapshot)
        except BaseException:
            # return the memory; otherwise the writer would run out of it, and the next call would wait forever
            self._free = snapshot
            raise
        if not recorded:
            self._free = snapshot

    def _keep(self, call: int, snapshot: StateMemory) -> bool:
        """Check a snapshot, and pass it to the writer or into the ring; return whether it was passed on."""
        state = snapshot.state
        if self._setup is None:
            if _is_empty(state):
                return False
            given = {"mass": state.mass, "radius": state.radius, "fixed": state.fixed, "judged": state.judged}
            self._model = replace(self._model, **given, names=state.names, inertia=None)
            self._begin_with(state)
            if call:
                begins = self._units.text(time_of(state), TIME, "g")
                text = f"{self._model.engine}: there is no body before t = {begins}."
                self._unrecorded.add(call, time_of(state), text, "The recording begins there.")
        setup = self._setup
        assert setup is not None, "it was set above"
        if not snapshot.bounded:
            if (fault := not_finite(setup, call, state)) is not None:
                self._end(call, fault.text, (fault,))
                return False
            raise RecordingError(f"{setup.engine}: the time is {state.time}, which is not finite")
        if state.time < self._time:
            before, now = self._units.shown(self._time, TIME), self._units.text(state.time, TIME, "g")
            reset = "the engine was reset, or reset itself"
            self._end(call, f"{setup.engine}: the time decreased from {before:g} to {now}: {reset}.", ())
            return False
        if state.time == self._time:
            stands = self._units.text(state.time, TIME, "g")
            text = f"{setup.engine}: the time did not advance, it is still {stands}: give the engine's own time."
            self._unrecorded.add(call, state.time, text, "A change without time is an error of the engine.")
        self._time = state.time
        if setup is self._setup and self._ids is None:
            self._note_changed_constants(call, setup)
        if self._ring is not None:
            if not self._ring:
                expect_finish(self, True)
            if len(self._ring) == self._ring.maxlen:
                self._free = self._ring[0][1]
            self._ring.append((call, snapshot))
            return True
        if self._sink is None:
            try:
                self._sink = self._writer(self.path, state, self._force)
            except BaseException as error:
                self._ended = f"failed: {told_by(error)}"
                raise
            expect_finish(self, True)
        try:
            self._sink.put(call, snapshot)
        except Exception as error:  # an error in the writer's thread, for example when the disk is full
            self._end(call, sentence_of(error), ())
            return False
        self._taken += 1
        return True

    def _note_changed_constants(self, call: int, setup: Setup) -> None:
        """Note a mass or a radius of the model that has changed since the start."""
        for name, unit in CONSTANTS.items():
            was, now = self._constants[name], np.asarray(getattr(self._source.model, name))
            if now.shape == was.shape and (now != was).any():
                body = int(np.argmax(now != was))
                called = Names(setup.names, []).of(body)
                before, after = (self._units.text(float(values[body]), unit, "g") for values in (was, now))
                text = f"{setup.engine}: the {name} of {called} changed from {before} to {after}."
                keeps = f"The recording keeps the first {name}; if bodies come and go, give ids with each state."
                self._unrecorded.add(call, self._time, text, keeps)
                self._constants[name] = now.astype(np.float64)  # keep a copy, so that each change is noted once

    def _begin_with(self, first: State) -> None:
        """Check the model and the first state with bodies, before anything is allocated or written."""
        if not isinstance(first, State):
            raise RecordingError(
                f"`state` of {type(self._source).__name__} returned {type(first).__name__}; return a carom.record.State"
            )
        setup = setup_of(self._model, first)
        refuse_invalid_state(setup, first)
        self._setup = setup
        self._ids = None if first.ids is None else ids_of(setup.engine, first.ids, len(setup))
        points = np.flatnonzero(~setup.touches & ~setup.fixed)
        if setup.collides and len(points):
            text = f"{setup.engine}: {Names(setup.names, []).of(int(points[0]))} has the radius 0."
            self._unrecorded.add(self._calls, time_of(first), text, "It touches nothing, and is drawn small.")
        self._constants = {name: np.array(getattr(self._model, name), np.float64) for name in CONSTANTS}

    @property
    def _time_of_note(self) -> float:
        """The last recorded time in s, for notes."""
        return self._time if np.isfinite(self._time) else 0.0

    def _writer(self, path: Path, first: State, force: bool) -> SnapshotWriter:
        setup, population = self._setup, None
        assert setup is not None, "there is a state with bodies"
        if self._ids is not None:
            population = Population(setup, self._model, self._ids)
            present = population.find(first)
            setup = population.whole
            observer = Observer(present.setup, first, self._tolerances, self._units, present)
        else:
            observer = Observer(setup, first, self._tolerances, self._units)
        header = header_of_source(
            setup,
            title=self._title or setup.engine,
            run_id=str(uuid.uuid4()),
            duration=self._duration,
            exact=self._exact,
            properties={**environment(1), "engine": setup.engine},
            units=self._units,
        )
        return SnapshotWriter(path, observer, header, force, self._new, self._unrecorded, population)

    def _dump(self, path: Path, outcome: str, faults: Iterable[Fault]) -> None:
        """Write the frames in memory into a file of their own."""
        if not self._ring:
            raise RecordingError(f"{path}: there is no frame in memory yet")
        writer = self._writer(path, self._ring[0][1].state, self._force)
        for step, snapshot in self._ring:
            writer.put(step, snapshot)
        self.faults = writer.finish(outcome, faults)
        self._written += 1

    def _next_path(self) -> Path:
        """Return the path, with a number if it was already written."""
        if not self._written:
            return self.path
        return self.path.with_stem(f"{self.path.stem}-{self._written + 1}")

    def _end(self, call: int, text: str, faults: tuple[Fault, ...]) -> None:
        """End the recording before the present state, and add a note with the reason."""
        self._ended = f"failed: {text}"
        self._unrecorded.add(call, self._time_of_note, text, "The recording ends before this state.", ends=True)
        sink, self._sink = self._sink, None
        self.faults = list(faults)
        if self._ring:
            try:
                self._dump(self._next_path(), self._ended, faults)
            except Exception as error:
                self._unrecorded.add(call, self._time_of_note, error, "The frames in memory are not written.")
        elif sink is not None:
            self._close(sink, self._ended, faults)
        expect_finish(self, False)

    def _close(self, sink: SnapshotWriter, outcome: str, faults: Iterable[Fault]) -> None:
        try:
            self.faults = sink.finish(outcome, faults)
        except Exception as error:
            self._unrecorded.add(self._calls - 1, self._time_of_note, error, "The recording ends there.", ends=True)


def _is_empty(state: State) -> bool:
    """Return whether a state has no bodies, which is allowed if bodies come and go."""
    return isinstance(state, State) and state.ids is not None and np.size(state.ids) == 0


def _counts(number: int) -> bool:
    """Return whether a number given by the caller is a positive integer."""
    try:
        return operator.index(number) > 0
    except TypeError:
        return False


_unfinished: dict[Recorder, None] = {}
os.register_at_fork(after_in_child=_unfinished.clear)
_lock = threading.Lock()
_watcher: threading.Thread | None = None


def expect_finish(recorder: Recorder, expected: bool) -> None:
    """Finish a recorder when the program ends, unless it has been finished by then."""
    global _watcher  # noqa: PLW0603 - one thread for all recorders of a process
    with _lock:
        if not expected:
            _unfinished.pop(recorder, None)
            return
        _unfinished[recorder] = None
        if _watcher is None or not _watcher.is_alive():
            # `atexit` would be too late: since Python 3.12, no thread can be started there
            _watcher = threading.Thread(target=_finish_unfinished, name="carom-exit", daemon=False)
            _watcher.start()


def _finish_unfinished() -> None:
    """Wait until all threads except daemons have ended, and finish the remaining recorders."""
    threading.main_thread().join()
    this = threading.current_thread()
    while others := [t for t in threading.enumerate() if t is not this and not t.daemon and t.is_alive()]:
        for thread in others:
            thread.join()
    for recorder in list(_unfinished):
        recorder.finish_early("interrupted: the program ended before Recorder.finish")
