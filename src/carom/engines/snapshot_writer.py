"""`SnapshotWriter`: records the snapshots of another engine's run in a separate thread.

`Unrecorded` has the notes on everything that could not be recorded: they are events of the recording, and lines on
stderr.
"""

from __future__ import annotations

import contextlib
import queue
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from carom.engines.faults import Fault
from carom.engines.observer import Observer, header_of_source
from carom.engines.population import Population, Present, spread, without_bodies
from carom.engines.source import State, StateMemory
from carom.errors import RecordingError
from carom.event import Event
from carom.recording.edit.repair import widen
from carom.recording.schema.header import Header, Scalar
from carom.recording.write.recorder import FrameRecorder
from carom.recording.write.whole_file import claimed_output
from carom.runs.environment import environment
from carom.runs.outcome import ONCE_A_STEP, closing_of
from carom.scene.load import Scene
from carom.scene.wording import counted, escaped, told_by
from carom.state.frame import Frame

WAITING_BYTES = 32_000_000  # bytes of states that wait for the writer
MOST_WAITING = 256
STOCK_BYTES = 8_000_000  # bytes of memory that the writer's thread allocates at the start
BATCH = 8  # states in a batch: waking a thread costs as much as copying a state of 1000 bodies
PATIENCE = 0.02  # s, time after which a smaller batch is sent
KIND = "not-recorded"  # kind of the events
MOST_TEXTS = 20  # largest number of different texts; further texts are only counted


class SnapshotWriter:
    """Converts snapshots to frames and records them, in a separate thread.

    ``observer`` converts each state to a frame and audits it, ``new`` allocates memory for a snapshot, and
    ``unrecorded`` collects notes on states and contacts that cannot be recorded. ``population`` numbers the bodies if
    they come and go.
    """

    def __init__(
        self,
        path: Path,
        observer: Observer,
        header: Header,
        force: bool,
        new: Callable[[], StateMemory],
        unrecorded: Unrecorded,
        population: Population | None = None,
    ) -> None:
        self._observer, self._new, self._unrecorded = observer, new, unrecorded
        self._population, self._present = population, None if population is None else population.present
        self._path, self._header = path, header
        self._noted = 0  # number of events of `unrecorded` that are in the recording
        self._stack = contextlib.ExitStack()
        self._stack.enter_context(claimed_output(path, force))
        self._recorder = FrameRecorder(path, header)
        self._store = None if population is not None else self._recorder.store_for(observer.bodies)
        size = 104 * header.bodies
        room = max(2, min(MOST_WAITING, WAITING_BYTES // size))  # number of snapshots that may be allocated
        self._stock = min(room, STOCK_BYTES // size)  # number of snapshots that this thread allocates in advance
        self._room = room - self._stock
        self._batch: list[tuple[int, StateMemory]] = []  # waiting to be sent
        self._due = 0.0
        self._queue: queue.SimpleQueue[list[tuple[int, StateMemory]] | None] = queue.SimpleQueue()
        self._spare: queue.SimpleQueue[StateMemory] = queue.SimpleQueue()  # reusable memory
        self._error: Exception | None = None  # the error after which the file can no longer be written
        self._last = (0, 0.0)
        self._frame: Frame  # the last frame with bodies
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
        """Pass a snapshot to the thread, which then owns it. Raises the error that closed the file, if any."""
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
            if self._error is not None:
                raise self._error
            for fault in faults:
                audit.note(fault)
            events = (
                *self._unrecorded.events[self._noted :],
                *self._unrecorded.total(*self._last),
                *(fault.event for fault in faults),
                *self._observer.highlights(),
            )
            self._recorder.finish(outcome, observed_totals(self._observer, *self._last), events)
        finally:
            self._stack.close()
        if self._population is not None and len(self._population.whole) > self._header.bodies:
            widen(self._path)
        return sorted(audit.first.values(), key=lambda fault: fault.step)

    def _run(self) -> None:
        for allocated in range(self._stock):
            try:
                self._spare.put(self._new())
            except MemoryError:
                self._room += self._stock - allocated  # `spare` tries to allocate them again
                break
        while (batch := self._queue.get()) is not None:
            for step, snapshot in batch:
                if self._error is None:
                    self._record(step, snapshot.state)
                self._spare.put(snapshot)  # returned in any case; otherwise `spare` would wait forever

    def _record(self, step: int, state: State) -> None:
        try:
            present = self._find_bodies(state)
        except Exception as error:
            self._unrecorded.add(step, state.time, error, "This state is not recorded.")
            return
        if present is not None and not len(present.numbers):
            self._put(without_bodies(self._frame, step, state.time))
            return
        try:
            if state.contacts is not None:
                self._observer.named(state.contacts)
        except (RecordingError, TypeError, ValueError) as error:
            self._unrecorded.add(step, state.time, error, "Its contacts are computed from distances.")
            state.contacts = None
        try:
            frame = self._observer.frame(step, state, self._store if present is None else None)
            frame = frame if present is None else spread(frame, present)
        except Exception as error:
            self._unrecorded.add(step, state.time, error, "This state is not recorded.")
            return
        self._frame = frame
        self._put(frame)

    def _put(self, frame: Frame) -> None:
        # a note from before this frame, such as a note from before the first frame, gets the time of this frame
        notes: list[Event] = []
        for event in self._unrecorded.events[self._noted :]:
            if event.step > frame.step:
                break
            notes.append(replace(event, step=frame.step, time=frame.time))
        self._noted += len(notes)
        try:
            self._recorder.put(replace(frame, events=(*notes, *frame.events)) if notes else frame)
            self._last = (frame.step, frame.time)
        except Exception as error:
            self._error = error

    def _find_bodies(self, state: State) -> Present | None:
        """Return the bodies of a state, and observe these bodies from now on; None if bodies do not come and go."""
        population, before = self._population, self._present
        if population is None:
            return None
        present = population.find(state)
        if present is not before:
            if present.bodies > self._recorder.bodies:
                whole = population.whole
                self._recorder.extend(
                    replace(
                        self._header,
                        names=whole.names,
                        group=np.zeros(len(whole), dtype=np.int64),
                        mass=whole.mass,
                        radius=whole.radius,
                        inertia=whole.inertia,
                        fixed=whole.fixed if whole.fixed.any() else None,
                        judged=None if whole.judged.all() else whole.judged,
                    )
                )
            if len(present.numbers):
                self._observer = self._observer.continued(present, state)
            self._present = present
        return present


def observed_totals(observer: Observer, steps: int, time: float) -> dict[str, Scalar]:
    """Return the closing properties of another engine's run, which ended after some steps at a time (s)."""
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


class Unrecorded:
    """Notes on states and contacts that the recording at a path lacks. Any thread may add notes."""

    def __init__(self, path: Path) -> None:
        self.events: list[Event] = []  # elements are only ever appended
        self.texts: list[str] = []
        self.count = 0
        self._path = path
        self._known: set[str] = set()
        self._lock = threading.Lock()

    def add(self, step: int, time: float, problem: Exception | str, consequence: str, *, ends: bool = False) -> None:
        """Add a note on a problem and its consequence; a text that differs only in its digits is counted, not repeated.

        A problem that ends the recording is not an event, since the outcome states it.
        """
        cause = problem if isinstance(problem, str) else sentence_of(problem)
        pattern, text = "".join(letter for letter in cause if not letter.isdigit()), f"{cause} {consequence}"
        with self._lock:
            self.count += 1
            if pattern in self._known or len(self._known) == MOST_TEXTS:
                return
            self._known.add(pattern)
            self.texts.append(text)
            if not ends:
                self.events.append(Event(step, time, "WARN", text, KIND))
        with contextlib.suppress(OSError, ValueError, AttributeError):  # stderr may be full, closed or missing
            sys.stderr.write(f"carom: {escaped(f'{self._path}: {text}')}\n")
            sys.stderr.flush()

    def total(self, step: int, time: float) -> list[Event]:
        """Return an event with the number of problems, if there are more problems than stored texts."""
        if self.count <= len(self.texts):
            return []
        return [Event(step, time, "WARN", f"{counted(self.count, 'problem')} of recording in all.", KIND)]


def sentence_of(error: BaseException) -> str:
    """Return an error as a sentence."""
    told = told_by(error)
    text = told if isinstance(error, RecordingError) else f"{type(error).__name__}: {told}"
    return text if text.endswith((".", "!", "?")) else f"{text}."
