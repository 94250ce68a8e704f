"""Sends runs to workers and enters their reports into the manifest."""

from __future__ import annotations

from typing import Protocol

from carom.lab.sweep.manifest import FAILED, Manifest, Run
from carom.lab.sweep.plan import Point
from carom.lab.sweep.task import Report, Task, execute
from carom.runs.environment import versions
from carom.runs.interrupts import Interrupts
from carom.runs.workers import Ended, TaskDroppedError, WorkerDiedError, Workers
from carom.scene.wording import counted

INTERRUPTED = "interrupted"
GONE = "the scheduler is gone, or has dropped runs"
_TICK = 0.2  # s between two updates of a running sweep


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
    """Makes runs on workers."""

    def __init__(self, workers: Workers, manifest: Manifest, watch: Watcher) -> None:
        self._workers = workers
        self._manifest = manifest
        self._watch = watch
        self._left: set[str] = set()  # names of the runs that have not ended
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
        plan, folder, version = self._manifest.plan, self._manifest.folder, versions()["carom"]
        self._left = {point.name for point in points}
        root, command = str(folder.root), self._manifest.command
        self._workers.send(execute, {point.name: Task(root, plan.digest, version, command, point) for point in points})
        stopping = False
        while self._left and interrupts.count < 2:
            entered = [self._enter(ended) for ended in self._workers.ended(_TICK)]
            if any(entered):
                self._save()
            self._watch.tick()
            if not self._workers.are_there:
                break
            if interrupts.count and not stopping:
                stopping = True
                self._let_finish()
        stopped = INTERRUPTED if interrupts.count else GONE if self._left or self._dropped else ""
        self._workers.drop()
        if self._unsaved:
            self._manifest.save()
        return stopped

    def _enter(self, ended: Ended) -> bool:
        """Enter one run; tell whether it has ended."""
        self._left.discard(ended.key)
        if isinstance(ended.error, TaskDroppedError):
            self._dropped += 1
            return False
        self._watch.ended(self._manifest.enter(ended.key, _report(ended)))
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
        self._left.difference_update(self._workers.drop_waiting())
        left = counted(len(self._left), "run")
        self._watch.say(f"Interrupted. Waiting for {left} under way; interrupt again to drop them.")


def _report(ended: Ended) -> Report:
    """Return the report of a worker, or what is known if it sent none."""
    if ended.error is None:
        report: Report = ended.value
        return report
    if isinstance(ended.error, WorkerDiedError):
        return {"status": FAILED, "outcome": "lost", "reason": str(ended.error)}
    return {"status": FAILED, "outcome": "error", "reason": f"{type(ended.error).__name__}: {ended.error}"}
