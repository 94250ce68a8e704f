"""The conductor enters what is known of a run, and leaves a run whose report is lost for the next time."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from carom.experiment.interrupts import Interrupts
from carom.experiment.sweep.conductor import GONE, INTERRUPTED, Conductor
from carom.experiment.sweep.folder import Folder
from carom.experiment.sweep.manifest import FAILED, PENDING, Manifest
from carom.experiment.sweep.plan import plan
from sweeps import write_scene


class Ended:
    """A future of Dask that has ended with a status; ``raised`` is what asking for its result raises."""

    def __init__(self, key: str, status: str, raised: Exception) -> None:
        self.key, self.status, self.raised = key, status, raised

    def add_done_callback(self, call: Callable[[Any], None]) -> None:
        call(self)

    def result(self, timeout: float) -> None:
        raise self.raised


class Scheduler:
    """A client whose runs have all ended in one way."""

    status = "running"

    def __init__(self, ended: str, raised: Exception) -> None:
        self.ended, self.raised = ended, raised

    def map(self, function: Any, tasks: list[Any], key: list[str], **options: Any) -> list[Ended]:
        return [Ended(each, self.ended, self.raised) for each in key]

    def cancel(self, futures: list[Any]) -> None:
        raise AssertionError("nothing is left to cancel")


class Silent:
    def say(self, text: str) -> None: ...
    def begin(self, found: int) -> None: ...
    def ended(self, run: Any) -> None: ...
    def tick(self) -> None: ...


def conducted(folder: Path, ended: str, raised: Exception) -> tuple[str, set[str]]:
    manifest = Manifest.begin(Folder(folder / "out"), plan(write_scene(folder), seeds=3), "carom sweep")
    client: Any = Scheduler(ended, raised)
    stopped = Conductor(client, manifest, Silent()).conduct(manifest.todo, Interrupts())
    return stopped, {run.status for run in manifest.runs.values()}


@pytest.mark.parametrize("lost", [OSError("the scheduler is gone"), TimeoutError()])
def test_a_run_whose_report_cannot_be_had_has_not_failed(lost: Exception, tmp_path: Path) -> None:
    assert conducted(tmp_path, "finished", lost) == (GONE, {PENDING})


def test_a_run_that_raised_has_failed(tmp_path: Path) -> None:
    assert conducted(tmp_path, "error", ValueError("no such scene")) == ("", {FAILED})


class UnderWay(Ended):
    """A future of a run that ends only after the conductor should have stopped waiting for it."""

    def add_done_callback(self, call: Callable[[Any], None]) -> None:
        self.end = threading.Timer(5.0, call, (self,))  # s; a conductor waits 0.2 s at a time
        self.end.start()


class Busy(Scheduler):
    """A client whose only run goes on."""

    cancelled = False

    def map(self, function: Any, tasks: list[Any], key: list[str], **options: Any) -> list[Ended]:
        self.run = UnderWay(key[0], "cancelled", TimeoutError())
        return [self.run]

    def call_stack(self) -> dict[str, list[str]]:
        return {"worker": [self.run.key]}

    def cancel(self, futures: list[Any]) -> None:
        assert futures == [self.run]
        self.run.end.cancel()
        self.cancelled = True


def test_the_second_interrupt_is_seen_even_when_its_handler_is_slow(tmp_path: Path) -> None:
    """The wait of a `SimpleQueue` that is interrupted until its time is over lasts for ever (CPython 3.11)."""
    interrupts = Interrupts()

    def interrupt(number: int, frame: object) -> None:
        time.sleep(0.4)
        interrupts.count = 2

    manifest = Manifest.begin(Folder(tmp_path / "out"), plan(write_scene(tmp_path), seeds=1), "carom sweep")
    client: Any = Busy("pending", TimeoutError())
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        assert Conductor(client, manifest, Silent()).conduct(manifest.todo, interrupts) == INTERRUPTED
    finally:
        signal.signal(signal.SIGALRM, before)
    assert client.cancelled
