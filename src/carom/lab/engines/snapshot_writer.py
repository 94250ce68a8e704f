"""`SnapshotWriter`: the thread that records the snapshots of another engine's run."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from carom.recording.schema.header import Header, Scalar
from carom.recording.source.faults import Fault
from carom.recording.source.observer import Observer
from carom.recording.source.snapshot import Snapshot
from carom.recording.source.source import State
from carom.recording.write.recorder import Recorder
from carom.runs.closing import closing_of
from carom.runs.contact_counts import ONCE_A_STEP
from carom.runs.output import claimed_output

WAITING_BYTES = 32_000_000  # of states that wait for the writer
MOST_WAITING = 256
STOCK_BYTES = 8_000_000  # of memory that the writer's thread makes ready at the start
BATCH = 8  # states that are handed over at once: waking a thread costs as much as copying a state of 1000 bodies
PATIENCE = 0.02  # s, after which fewer are


class SnapshotWriter:
    """Makes frames of snapshots and records them, in a thread of its own.

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
        self, path: Path, observer: Observer, header: Header, force: bool, new: Callable[[], Snapshot]
    ) -> None:
        self._observer, self._new = observer, new
        self._stack = contextlib.ExitStack()
        self._stack.enter_context(claimed_output(path, force))
        self._recorder = Recorder(path, header)
        self._store = self._recorder.store_for(observer.bodies)
        size = 104 * header.bodies
        room = max(2, min(MOST_WAITING, WAITING_BYTES // size))  # snapshots that may be made
        self._stock = min(room, STOCK_BYTES // size)  # of them, by this thread
        self._room = room - self._stock
        self._batch: list[tuple[int, Snapshot]] = []  # not handed over yet
        self._due = 0.0
        self._queue: queue.SimpleQueue[list[tuple[int, Snapshot]] | None] = queue.SimpleQueue()
        self._spare: queue.SimpleQueue[Snapshot] = queue.SimpleQueue()  # whose memory can be used again
        self._error: Exception | None = None
        self._whole = True  # whether the file can be closed: what is wrong is a state, and not the disk
        self._last = (0, 0.0)
        self._thread = threading.Thread(target=self._run, name="carom-observer", daemon=True)
        self._thread.start()

    def spare(self) -> Snapshot:
        """Return memory for a state. Waits while the thread is behind."""
        try:
            return self._spare.get(False)
        except queue.Empty:
            if self._room > 0:
                self._room -= 1
                return self._new()
        self._hand_over()
        return self._spare.get()

    def put(self, step: int, snapshot: Snapshot) -> None:
        """Hand over a snapshot, which belongs to the thread from then on."""
        if self._error is not None:
            raise self._error
        self._batch.append((step, snapshot))
        if len(self._batch) == BATCH or time.monotonic() >= self._due:
            self._hand_over()

    def _hand_over(self) -> None:
        self._queue.put(self._batch)
        self._batch, self._due = [], time.monotonic() + PATIENCE

    def finish(self, outcome: str, faults: Iterable[Fault]) -> list[Fault]:
        """Write what is left, close the file, and return the first fault of each law."""
        self._queue.put(self._batch)
        self._queue.put(None)
        self._thread.join()
        audit = self._observer.audit
        try:
            if self._error is not None and not self._whole:
                raise self._error
            for fault in faults:
                audit.note(fault)
            extremes = self._observer.extremes.named(self._observer.names)
            steps, time = self._last
            totals: dict[str, Scalar] = {"steps": steps, "sim_time": time, "contacts.impacts_counted": ONCE_A_STEP}
            events = (
                *(fault.event for fault in faults),
                *self._observer.highlights(),
            )
            ended = outcome if self._error is None else f"failed: {self._error}"
            self._recorder.finish(ended, totals | closing_of(extremes) | dict(audit.closing()), events)
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
                self._spare.put(snapshot)  # in any case, or `spare` would wait for ever

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
