"""Runs tasks on the user's Dask cluster. Needs `carom[cluster]`."""

from __future__ import annotations

import contextlib
import logging
import queue
import re
import socket
import uuid
from collections.abc import Callable, Mapping
from typing import Any, Self

import dask
from distributed import Client, Future, KilledWorker

from carom.errors import ExperimentError
from carom.runs.workers import Ended, TaskDroppedError, WorkerDiedError

_CONNECT = 20.0  # s, time limit for connecting
_ANSWER = 60.0  # s, longest wait for an answer from the scheduler
_RETRIES = 3  # attempts to repeat a task whose result does not arrive
_ADDRESS = re.compile(r"\w+://\[?([^/\]]+)\]?:(\d+)/?")
_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado.application")
_SETTINGS = {"distributed.comm.timeouts.connect": f"{_CONNECT:.0f}s"}


class DaskWorkers:
    """The workers of the scheduler at an address. Leaving the context does not change the cluster."""

    def __init__(self, address: str) -> None:
        self._address = address  # such as tcp://10.0.0.1:8786
        self._keys: dict[str, Any] = {}  # carom's keys of the tasks, by Dask's keys
        self._futures: dict[str, Future[Any]] = {}  # futures that have not ended yet, by Dask's keys
        # not a SimpleQueue: its wait with a timeout never ends if a signal arrives during the wait
        self._done: queue.Queue[Future[Any]] = queue.Queue()
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        """Connect. Raises ExperimentError if no scheduler answers at the address."""
        for logger in _LOGGERS:
            logging.getLogger(logger).setLevel(logging.CRITICAL)  # the command prints its own reports
        with self._stack:
            self._stack.enter_context(dask.config.set(_SETTINGS))
            self._client = self._stack.enter_context(_client_of(self._address))
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def are_there(self) -> bool:
        """Whether the scheduler answers."""
        return self._client.status in ("running", "connecting")

    def send(self, function: Callable[[Any], Any], tasks: Mapping[Any, Any]) -> None:
        """Run a function of a module for each task, in order; the keys name the tasks.

        All tasks are sent at once, since a task is at most a page of text; the scheduler keeps their order.
        """
        batch = uuid.uuid4().hex[:8]
        names = {f"carom-{batch}-{key}": key for key in tasks}
        self._keys |= names
        sent: list[Any] = self._client.map(
            function, list(tasks.values()), key=list(names), pure=False, retries=_RETRIES
        )
        for future in sent:
            self._futures[future.key] = future
            future.add_done_callback(self._done.put)

    def ended(self, seconds: float) -> list[Ended]:
        """Return the tasks that have ended; wait up to a timeout for the first."""
        done = []
        with contextlib.suppress(queue.Empty):
            done.append(self._done.get(timeout=seconds))
            while True:
                done.append(self._done.get_nowait())
        wanted = [future for future in done if self._futures.pop(str(future.key), None) is not None]
        return [_ended(self._keys[str(future.key)], future) for future in wanted]

    def drop_waiting(self) -> list[Any]:
        """Drop the tasks that have not begun; return their keys."""
        executing: dict[str, Any] = self._client.call_stack()
        begun = {key for keys in executing.values() for key in keys}
        return self._forget([key for key in self._futures if key not in begun])

    def drop(self) -> None:
        """Drop all tasks."""
        self._forget(list(self._futures))

    def refuse_unfit(self, unfit: Callable[[], str]) -> None:
        """Refuse a cluster if a worker answers with a reason why it cannot run the sweep.

        Raises
        ------
        ExperimentError
            The message names the worker.
        """
        try:
            answers = self._client.run(unfit, on_error="return")
        except Exception as error:
            raise ExperimentError(f"the workers do not answer: {type(error).__name__}: {error}") from None
        for worker, answer in answers.items():
            if isinstance(answer, BaseException):
                raise ExperimentError(
                    f"worker {worker}: {type(answer).__name__}: {answer}; it needs carom in its environment"
                )
            if answer:
                raise ExperimentError(f"worker {worker} {answer}")

    def _forget(self, names: list[str]) -> list[Any]:
        futures = [self._futures.pop(name) for name in names]
        if futures and self._client.status == "running":
            self._client.cancel(futures)
        return [self._keys[name] for name in names]


def _ended(key: Any, future: Future[Any]) -> Ended:
    """Return the result of a task, or its error."""
    if future.status in ("cancelled", "lost"):
        return Ended(key, error=TaskDroppedError(f"the scheduler dropped it: {future.status}"))
    try:
        return Ended(key, future.result(timeout=_ANSWER))
    except KilledWorker as error:
        last = error.last_worker.address
        return Ended(key, error=WorkerDiedError(f"the workers died; the last one was {last}; is there enough memory?"))
    except Exception as error:
        if future.status != "error":  # the task has ended, but the scheduler died before it delivered the result
            return Ended(key, error=TaskDroppedError(f"its result is lost: {error}"))
        return Ended(key, error=error)


def _client_of(address: str) -> Client:
    """Connect to a scheduler; test the port first, since a client without a scheduler takes 40 s to close."""
    matched = _ADDRESS.fullmatch(address)
    if matched is None:
        raise ExperimentError(f"--cluster {address}: expected the address of a Dask scheduler, as tcp://10.0.0.1:8786")
    try:
        socket.create_connection((matched[1], int(matched[2])), _CONNECT).close()
        connect: Any = Client  # untyped
        client: Client = connect(address, set_as_default=False, timeout=_CONNECT)
        return client
    except (OSError, OverflowError) as error:
        raise ExperimentError(f"--cluster {address}: no Dask scheduler answers: {error}") from None
