"""`Recorder`: records another engine's run, frame by frame, while a user's own loop steps it."""

from __future__ import annotations

import contextlib
import operator
import queue
import threading
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Header, Scalar
from carom.recording.source.law_audit import Fault, Tolerances
from carom.recording.source.observer import Observer, header_of_source, not_finite
from carom.recording.source.source import (
    Model,
    Setup,
    Source,
    State,
    StateMemory,
    SteppedSource,
    array_of,
    memory_of,
    reader_of,
    refuse_no_rotation,
    setup_of,
    time_of,
)
from carom.recording.write.recorder import FrameRecorder
from carom.runs.environment import environment
from carom.runs.outcome import closing_of
from carom.runs.output import claimed_output, refuse_name, refuse_output
from carom.runs.overview import ONCE_A_STEP
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.units.unit import UnitError

# `SnapshotWriter`: the thread that records the snapshots of another engine's run.
WAITING_BYTES = 32_000_000  # bytes of states that wait for the writer
MOST_WAITING = 256
STOCK_BYTES = 8_000_000  # bytes of memory that the writer's thread allocates at the start
BATCH = 8  # states in a batch: waking a thread costs as much as copying a state of 1000 bodies
PATIENCE = 0.02  # s, after which a smaller batch is sent


class SnapshotWriter:
    """Makes and records frames of snapshots in its own thread.

    Parameters
    ----------
    path
        The ``.rrd`` to write.
    observer
        Makes a frame of each state, and audits it.
    header
        Of the recording.
    force
        Whether to replace a file that exists.
    new
        Makes memory for a snapshot.
    """

    def __init__(
        self, path: Path, observer: Observer, header: Header, force: bool, new: Callable[[], StateMemory]
    ) -> None:
        self._observer, self._new = observer, new
        self._stack = contextlib.ExitStack()
        self._stack.enter_context(claimed_output(path, force))
        self._recorder = FrameRecorder(path, header)
        self._store = self._recorder.store_for(observer.bodies)
        size = 104 * header.bodies
        room = max(2, min(MOST_WAITING, WAITING_BYTES // size))  # snapshots that may be made
        self._stock = min(room, STOCK_BYTES // size)  # allocated in advance, by this thread
        self._room = room - self._stock
        self._batch: list[tuple[int, StateMemory]] = []  # waiting to be sent
        self._due = 0.0
        self._queue: queue.SimpleQueue[list[tuple[int, StateMemory]] | None] = queue.SimpleQueue()
        self._spare: queue.SimpleQueue[StateMemory] = queue.SimpleQueue()  # reusable memory
        self._error: Exception | None = None
        self._whole = True  # whether the file can be closed: errors concern a state and not the disk
        self._last = (0, 0.0)
        self._thread = threading.Thread(target=self._run, name="carom-observer", daemon=True)
        self._thread.start()

    def spare(self) -> StateMemory:
        """Return memory for a state. Waits while the thread is behind."""
        try:
            return self._spare.get(False)
        except queue.Empty:
            if self._room > 0:
                self._room -= 1
                return self._new()
        self._hand_over()
        return self._spare.get()

    def put(self, step: int, snapshot: StateMemory) -> None:
        """Pass a snapshot to the thread, which then owns it."""
        if self._error is not None:
            raise self._error
        self._batch.append((step, snapshot))
        if len(self._batch) == BATCH or time.monotonic() >= self._due:
            self._hand_over()

    def _hand_over(self) -> None:
        self._queue.put(self._batch)
        self._batch, self._due = [], time.monotonic() + PATIENCE

    def finish(self, outcome: str, faults: Iterable[Fault]) -> list[Fault]:
        """Write the remaining snapshots, close the file, and return the first fault of each law."""
        self._queue.put(self._batch)
        self._queue.put(None)
        self._thread.join()
        audit = self._observer.audit
        try:
            if self._error is not None and not self._whole:
                raise self._error
            for fault in faults:
                audit.note(fault)
            events = (
                *(fault.event for fault in faults),
                *self._observer.highlights(),
            )
            ended = outcome if self._error is None else f"failed: {self._error}"
            self._recorder.finish(ended, observed_totals(self._observer, *self._last), events)
        finally:
            self._stack.close()
        if self._error is not None:
            raise self._error
        return sorted(audit.first.values(), key=lambda fault: fault.step)

    def _run(self) -> None:
        for _ in range(self._stock):
            self._spare.put(self._new())
        while (batch := self._queue.get()) is not None:
            for step, snapshot in batch:
                if self._error is None:
                    self._record(step, snapshot.state)
                self._spare.put(snapshot)  # always, or `spare` would wait for ever

    def _record(self, step: int, state: State) -> None:
        try:
            frame = self._observer.frame(step, state, self._store)
        except Exception as error:
            self._error = error
            return
        try:
            self._recorder.put(frame)
            self._last = (step, state.time)
        except Exception as error:
            self._error, self._whole = error, False


COMPLETED = "completed"


class Recorder:
    """Records the states of a source; use it as a context, and call `frame` after every step.

    `frame` only copies the state; another thread encodes, audits and writes it. `frame` waits while that thread is
    behind, so no frame is dropped. A state that is not finite ends the recording with the frame before it. A fault is a
    line in the recording's log, and an entry in `faults`.

    Parameters
    ----------
    source
        The other engine's run, such as ``carom.record.mujoco(model, data)``.
    path
        The ``.rrd`` to write.
    last
        Keep only so many frames, in memory. They are written when a state is not finite, when an exception leaves the
        context, and by `write`.
    every
        Record one of so many calls of `frame`. By default the source decides: each call, or fewer for PyBullet with
        200 bodies or more.
    title
        Of the recording; by default the name of the engine.
    duration
        s, the duration of the run, needed only above 292 years.
    exact
        Whether every frame has the exact state in float64, which cannot be recomputed. Otherwise about one frame in ten
        has it, and the others have positions in float32.
    tolerances
        Errors above which the audit reports a fault.
    units
        Of the source: a length, a time and a mass, such as ``"au, day, solar mass"``, or ``"dimensionless"``. By
        default those of the source, or SI.
    force
        Whether to replace a file that exists.

    Raises
    ------
    RecordingError
        If the units are invalid, the path cannot be written, or the source is no valid run of bodies.
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
        if not 0.0 <= duration < np.inf:
            raise RecordingError(f"duration = {duration}: expected the time that the run will reach, or 0 if unknown")
        try:
            named = units or source.model.units
            self._units = UnitSystem.of_text(named) if named else SI
        except UnitError as error:
            raise RecordingError(f'units = "{named}": {error}') from None
        self.path = Path(path)
        refuse_name(self.path)
        refuse_output(self.path, force)
        self._source, self._exact, self._force = source, exact, force
        self._read = reader_of(source)
        self._stepped = source.stepped if isinstance(source, SteppedSource) else None
        self._title, self._duration = title, duration
        self._tolerances = tolerances or Tolerances()
        self._calls = 0
        self._time = -np.inf
        self._ended = ""  # why no more frames are accepted
        self._setup: Setup | None = None
        self._ring: deque[tuple[int, StateMemory]] | None = None if last is None else deque(maxlen=int(last))
        self._free: StateMemory | None = None  # reusable memory
        self._new: Callable[[], StateMemory]  # allocates memory; known after the first state
        self._sink: SnapshotWriter | None = None
        self._written = self._taken = 0
        self.faults: list[Fault] = []

    @property
    def frames(self) -> int:
        """Number of frames that were recorded or are in memory."""
        return self._taken if self._ring is None else len(self._ring)

    def frame(self) -> bool:
        """Record the present state; return whether the recording continues.

        Raises
        ------
        RecordingError
            If the file can no longer be written, or the time has decreased.
        """
        call, self._calls = self._calls, self._calls + 1
        if call and self._stepped is not None:
            self._stepped()
        if self._ended or call % self.every:
            return not self._ended
        setup = self._setup
        if setup is None:
            state = self._source.state()
            setup = self._begin(state)
            snapshot = self._memory()
            snapshot.take(state)
        else:
            snapshot = self._memory()
            self._read(snapshot)
        state = snapshot.state
        if not snapshot.bounded and (fault := not_finite(setup, call, state)) is not None:
            self._end(fault)
            return False
        if not np.isfinite(state.time):
            raise RecordingError(f"{setup.engine}: the time is {state.time}, which is not finite")
        if state.time < self._time:
            raise RecordingError(
                f"{setup.engine}: the time decreased from {self._units.shown(self._time, TIME):g} to "
                f"{self._units.text(state.time, TIME, 'g')}; start another recording"
            )
        self._time = state.time
        if self._ring is not None:
            if len(self._ring) == self._ring.maxlen:
                self._free = self._ring[0][1]
            self._ring.append((call, snapshot))
        elif self._sink is not None:
            self._sink.put(call, snapshot)
            self._taken += 1
        return True

    def _memory(self) -> StateMemory:
        """Return memory for a copy of a state; wait for the writer if all memory is in use."""
        if self._sink is not None:
            return self._sink.spare()
        free, self._free = self._free, None
        return free or self._new()

    def write(self, path: str | Path | None = None, outcome: str = "written on demand") -> Recording:
        """Write the frames in memory; recording into memory continues.

        Raises
        ------
        RecordingError
            If frames are not kept in memory, there is none yet, or the file cannot be written.
        """
        if self._ring is None:
            raise RecordingError(f"{self.path} is written during the run; give last=N to keep frames in memory")
        if not self._ring:
            raise RecordingError(f"{self.path}: there is no frame in memory yet")
        target = self._next_path() if path is None else Path(path)
        self._dump(target, outcome, ())
        return Recording.open(target)

    def finish(self, outcome: str = COMPLETED) -> None:
        """Close the recording. Leaving the context does it, too."""
        sink, self._sink = self._sink, None
        if sink is not None:
            self._ended = self._ended or outcome
            self.faults = sink.finish(outcome, ())

    def __enter__(self) -> Self:
        self.frame()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        outcome = COMPLETED if error is None else f"failed: {type(error).__name__}: {error}"
        if error is None:
            self.finish()
            return
        with contextlib.suppress(RecordingError):  # the exception that leaves the context is more informative
            if self._ring and not self._ended:
                self._dump(self._next_path(), outcome, ())
            self.finish(outcome)

    def _begin(self, first: State) -> Setup:
        """Check the model and the first state of the source before anything is allocated or written."""
        if not isinstance(first, State):
            raise RecordingError(
                f"`state` of {type(self._source).__name__} returned {type(first).__name__}; return a carom.record.State"
            )
        setup = setup_of(self._source.model, first)
        array_of(setup.engine, "time", time_of(first), ())
        n = len(setup)
        array_of(setup.engine, "velocity", first.velocity, (n, 3))
        for name, width in (("orientation", 4), ("angular_velocity", 3)):
            if getattr(first, name) is not None:
                array_of(setup.engine, name, getattr(first, name), (n, width))
        if first.orientation is not None:
            refuse_no_rotation(setup.engine, np.asarray(first.orientation, dtype=np.float64))
        self._new = memory_of(self._source, first)
        if self._ring is None:
            self._sink = self._writer(self.path, setup, first, self._force)
        self._setup = setup
        return setup

    def _writer(self, path: Path, setup: Setup, first: State, force: bool) -> SnapshotWriter:
        observer = Observer(setup, first, self._tolerances, self._units)
        stamped: dict[str, Scalar] = {**environment(1), "engine": setup.engine}
        header = header_of_source(
            setup,
            title=self._title or setup.engine,
            run_id=str(uuid.uuid4()),
            duration=self._duration,
            exact=self._exact,
            properties=stamped,
            units=self._units,
        )
        return SnapshotWriter(path, observer, header, force, self._new)

    def _dump(self, path: Path, outcome: str, faults: Iterable[Fault]) -> None:
        """Write the frames in memory into their own file."""
        assert self._ring and self._setup, "there are frames"
        writer = self._writer(path, self._setup, self._ring[0][1].state, self._force)
        for step, snapshot in self._ring:
            writer.put(step, snapshot)
        self.faults = writer.finish(outcome, faults)
        self._written += 1

    def _next_path(self) -> Path:
        """Return the path, with a number if it was already written."""
        if not self._written:
            return self.path
        return self.path.with_stem(f"{self.path.stem}-{self._written + 1}")

    def _end(self, fault: Fault) -> None:
        """End the recording with the last finite state, since later states are meaningless."""
        self._ended = f"failed: {fault.text}"
        if self._ring:
            self._dump(self._next_path(), self._ended, (fault,))
        elif self._sink is not None:
            sink, self._sink = self._sink, None
            self.faults = sink.finish(self._ended, (fault,))
        else:
            self.faults = [fault]
        warnings.warn(f"carom: {fault.text} The recording {self.path} ends before it.", RuntimeWarning, stacklevel=3)


def _counts(number: int) -> bool:
    """Return whether a caller's number is whole and positive."""
    try:
        return operator.index(number) > 0
    except TypeError:
        return False


def observed_totals(observer: Observer, steps: int, time: float) -> dict[str, Scalar]:
    """Return the closing properties of a run of another engine that ended after some steps, at a time in s."""
    totals: dict[str, Scalar] = {"steps": steps, "sim_time": time, "contacts.impacts_counted": ONCE_A_STEP}
    return totals | closing_of(observer.extremes.named(observer.names)) | dict(observer.audit.closing())


@contextlib.contextmanager
def observed_recording(path: Path, observer: Observer, scene: Scene) -> Iterator[FrameRecorder]:
    """Claim a path, and yield the recorder of a scene that another engine runs; an earlier file is replaced."""
    setup = observer.setup
    header = header_of_source(
        setup,
        title=f"{scene.title}: {setup.engine}",
        run_id=str(uuid.uuid4()),
        duration=scene.time.duration,
        exact=True,
        properties={**environment(1), "engine": setup.engine},
        units=scene.unit_system,
    )
    with claimed_output(path, force=True), FrameRecorder(path, header) as recorder:
        yield recorder
