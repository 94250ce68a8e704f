"""Tasks on a Dask cluster: the state of an ended task, and of one whose result is lost."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from operator import neg
from typing import Any

import pytest

from carom.runs.workers import TaskDroppedError

pytest.importorskip("distributed")
from carom.lab.sweep.cluster import DaskWorkers

pytestmark = pytest.mark.needs("distributed")


class Future:
    """A future of Dask that has ended with a status; ``raised`` is what asking for its result raises."""

    def __init__(self, key: str, status: str, raised: Exception) -> None:
        self.key, self.status, self.raised = key, status, raised

    def add_done_callback(self, call: Callable[[Any], None]) -> None:
        call(self)

    def result(self, timeout: float) -> None:
        raise self.raised


class Scheduler:
    """A client whose tasks have all ended in one way."""

    status = "running"

    def __init__(self, ended: str, raised: Exception) -> None:
        self.ended, self.raised = ended, raised

    def map(self, function: Any, tasks: list[Any], key: list[str], **options: Any) -> list[Future]:
        return [Future(each, self.ended, self.raised) for each in key]

    def cancel(self, futures: list[Any]) -> None:
        raise AssertionError("nothing is left to cancel")


def workers_of(client: Any) -> DaskWorkers:
    workers = DaskWorkers("tcp://127.0.0.1:9")
    workers._client = client
    return workers


@pytest.mark.parametrize(
    ("status", "raised", "known"),
    [
        ("finished", OSError("the scheduler is gone"), TaskDroppedError),
        ("finished", TimeoutError(), TaskDroppedError),
        ("cancelled", TimeoutError(), TaskDroppedError),
        ("error", ValueError("no such scene"), ValueError),
    ],
)
def test_a_task_whose_result_cannot_be_had_has_not_failed_and_one_that_raised_has(
    status: str, raised: Exception, known: type[Exception]
) -> None:
    workers = workers_of(Scheduler(status, raised))
    workers.send(neg, {"a": 1, "b": 2})
    ended = workers.ended(1.0)
    assert {each.key: type(each.error) for each in ended} == {"a": known, "b": known}
    workers.drop()


class UnderWay(Future):
    """A future of a task that ends only long after it is asked for."""

    def add_done_callback(self, call: Callable[[Any], None]) -> None:
        self.end = threading.Timer(5.0, call, (self,))  # s; the test waits 0.2 s
        self.end.start()


class Busy(Scheduler):
    """A client whose first task is under way."""

    def __init__(self) -> None:
        super().__init__("pending", TimeoutError())
        self.cancelled: list[UnderWay] = []

    def map(self, function: Any, tasks: list[Any], key: list[str], **options: Any) -> list[Future]:
        self.sent = [UnderWay(each, self.ended, self.raised) for each in key]
        return [*self.sent]

    def call_stack(self) -> dict[str, list[str]]:
        return {"worker": [self.sent[0].key]}

    def cancel(self, futures: list[Any]) -> None:
        self.cancelled += futures
        for future in futures:
            future.end.cancel()


def test_tasks_that_have_not_begun_are_dropped_and_then_the_others() -> None:
    client = Busy()
    workers = workers_of(client)
    workers.send(neg, {"first": 1, "second": 2, "third": 3})
    assert workers.drop_waiting() == ["second", "third"] and client.cancelled == client.sent[1:]
    workers.drop()
    assert client.cancelled == [*client.sent[1:], client.sent[0]]


def test_a_signal_whose_handler_is_slow_does_not_prolong_the_wait() -> None:
    """The wait of a `SimpleQueue` that is interrupted until its time is over lasts for ever (CPython 3.11)."""
    workers = workers_of(Busy())
    workers.send(neg, {"endless": 1})
    before = signal.signal(signal.SIGALRM, lambda number, frame: time.sleep(0.4))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        assert workers.ended(0.2) == []
    finally:
        signal.signal(signal.SIGALRM, before)
        workers.drop()
