"""`Recorder`: records another engine's run, frame by frame, while a user's own loop steps it."""

from __future__ import annotations

import contextlib
import operator
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Scalar
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
from carom.runs.environment import environment
from carom.runs.output import refuse_name, refuse_output
from carom.runs.snapshot_writer import SnapshotWriter
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.units.unit import UnitError

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
