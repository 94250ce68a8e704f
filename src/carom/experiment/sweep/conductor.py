"""Submits runs to a cluster and enters their reports into the manifest. Needs `carom[cluster]`."""

from __future__ import annotations

import queue
import uuid
from typing import Any, Protocol

from distributed import Client, Future, KilledWorker

from carom.experiment.environment import versions
from carom.experiment.interrupts import Interrupts
from carom.experiment.sweep.manifest import FAILED, Manifest, Run
from carom.experiment.sweep.plan import Point
from carom.experiment.sweep.task import Report, Task, execute
from carom.scene.counted import counted

INTERRUPTED = "interrupted"
GONE = "the scheduler is gone, or has dropped runs"
_TICK = 0.2  # s between two updates of a running sweep
_RETRIES = 3  # of a run whose report does not arrive
_ANSWER = 60.0  # s a scheduler may take


class Watcher(Protocol):
    """Receives the progress of a sweep."""

    def say(self, text: str) -> None:
        """Receive a message that concerns all runs."""

    def begin(self, found: int) -> None:
        """Receive the number of runs that already exist."""

    def ended(self, run: Run) -> None:
        """Receive a run that ended."""

    def tick(self) -> None:
        """Update the display; called a few times a second."""


class Conductor:
    """Executes runs on a cluster."""

    def __init__(self, client: Client, manifest: Manifest, watch: Watcher) -> None:
        self._client = client
        self._manifest = manifest
        self._watch = watch
        self._waiting: dict[str, Future[Report]] = {}  # by key
        self._names: dict[str, str] = {}  # of the runs, by key
        # not a SimpleQueue: a signal that interrupts its wait when the time is over makes it wait for ever
        self._ended: queue.Queue[Future[Report]] = queue.Queue()
        self._dropped = 0  # runs that the scheduler refuses to make, or whose report it lost
        self._unsaved = ""  # why the manifest could not be written

    def conduct(self, points: list[Point], interrupts: Interrupts) -> str:
        """Make runs; return why this ended early, or an empty text.

        The first interrupt lets current runs finish, the second drops them.

        Raises
        ------
        OSError
            If the final manifest could not be written.
        """
        self._submit(points)
        stopping = False
        while self._waiting and interrupts.count < 2:
            if self._take():
                self._save()
            self._watch.tick()
            if self._client.status not in ("running", "connecting"):
                break
            if interrupts.count and not stopping:
                stopping = True
                self._let_finish()
        stopped = INTERRUPTED if interrupts.count else GONE if self._waiting or self._dropped else ""
        self._forget(list(self._waiting.values()))
        if self._unsaved:
            self._manifest.save()
        return stopped

    def _submit(self, points: list[Point]) -> None:
        """Submit all runs at once; a task is at most a page of text, and the scheduler keeps the order."""
        plan, folder = self._manifest.plan, self._manifest.folder
        version, sweep = versions()["carom"], uuid.uuid4().hex[:8]
        tasks = [Task(str(folder.root), plan.digest, version, self._manifest.command, point) for point in points]
        keys = [f"carom-{sweep}-{point.name}" for point in points]
        self._names = dict(zip(keys, (point.name for point in points), strict=True))
        futures: list[Any] = self._client.map(execute, tasks, key=keys, pure=False, retries=_RETRIES)
        for future in futures:
            self._waiting[future.key] = future
            future.add_done_callback(self._ended.put)

    def _take(self) -> bool:
        """Enter all runs that have ended; wait a tick for the first."""
        try:
            ended = [self._ended.get(timeout=_TICK)]
            while not self._ended.empty():
                ended.append(self._ended.get())
        except queue.Empty:
            return False
        entered = [self._enter(future) for future in ended]
        return any(entered)

    def _enter(self, future: Future[Report]) -> bool:
        """Enter one run; tell whether there was one."""
        if self._waiting.pop(str(future.key), None) is None:
            return False
        if future.status in ("cancelled", "lost"):
            self._dropped += 1
            return False
        report = _report(future)
        if report is None:
            self._dropped += 1
            return False
        self._watch.ended(self._manifest.enter(self._names[str(future.key)], report))
        return True

    def _save(self) -> None:
        """Write the manifest; keep an error for later, since a full disk may get room again."""
        try:
            self._manifest.save()
            self._unsaved = ""
        except OSError as error:
            if not self._unsaved:
                self._watch.say(f"{self._manifest.folder.manifest} cannot be written: {error.strerror}")
            self._unsaved = str(error)

    def _let_finish(self) -> None:
        """Drop the runs that have not begun."""
        executing: dict[str, Any] = self._client.call_stack()  # type: ignore[no-untyped-call]
        under_way = {key for keys in executing.values() for key in keys}
        idle = [future for key, future in self._waiting.items() if key not in under_way]
        self._forget(idle)
        for future in idle:
            self._waiting.pop(str(future.key), None)
        left = counted(len(self._waiting), "run")
        self._watch.say(f"Interrupted. Waiting for {left} under way; interrupt again to drop them.")

    def _forget(self, futures: list[Future[Report]]) -> None:
        if futures and self._client.status == "running":
            self._client.cancel(futures)  # type: ignore[no-untyped-call]


def _report(future: Future[Report]) -> Report | None:
    """Return the report of a worker, or what is known if it sent none; None if the report is lost on its way."""
    try:
        return future.result(timeout=_ANSWER)
    except KilledWorker as error:
        reason = f"the workers that had it died, {error.last_worker.address} last; is there memory enough for it?"
        return {"status": FAILED, "outcome": "lost", "reason": reason}
    except Exception as error:
        if future.status != "error":  # the run has ended, and the scheduler died before it handed over the report
            return None
        return {"status": FAILED, "outcome": "error", "reason": f"{type(error).__name__}: {error}"}
