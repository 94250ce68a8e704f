"""Runs tasks in processes of this machine, one at a time in each process. `sweep.cluster` runs tasks on a Dask cluster.

A worker is a Python process that imports nothing from the folder in which the command runs (``-P``). It receives its
tasks over a socket without a name, so no other user can open the socket. It ignores signals that request its end,
because the command handles them, and ends as soon as the command has ended in any way.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe, wait
from pathlib import Path
from typing import Any, Protocol, Self

from carom.errors import ExperimentError
from carom.held_signals import ENDING
from carom.private_folder import move_into, private_folder
from carom.runs.environment import collect_garbage_rarely, keep_freed_memory, leave_pandas_out

MOST_DEATHS = 4  # workers that may die on one task before the task is abandoned
_START = "from carom.runs.workers import work; work()"
_SIGNALS = {signal.SIGINT, *ENDING}
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class WorkerDiedError(ExperimentError):
    """All workers that received a task died."""


class TaskDroppedError(ExperimentError):
    """A task has not run, or its result is lost; it can be sent again."""


@dataclass(frozen=True, slots=True)
class Ended:
    """A task that has ended."""

    key: Any
    value: Any = None
    error: Exception | None = None  # the exception that the task raised, `WorkerDiedError` or `TaskDroppedError`

    @property
    def result(self) -> Any:
        """Return value of the task; raises its error."""
        if self.error is not None:
            raise self.error
        return self.value


class Workers(Protocol):
    """Processes that run tasks."""

    @property
    def are_there(self) -> bool:
        """Whether tasks can still end."""

    def send(self, function: Callable[[Any], Any], tasks: Mapping[Any, Any]) -> None:
        """Run a function of a module for each task, in order; the keys name the tasks."""

    def ended(self, seconds: float) -> list[Ended]:
        """Return the tasks that have ended; wait up to a timeout for the first."""

    def drop_waiting(self) -> list[Any]:
        """Cancel the tasks that have not started; return their keys."""

    def drop(self) -> None:
        """Cancel all tasks."""


@dataclass(slots=True, eq=False)
class _Job:
    key: Hashable
    function: Callable[[Any], Any]
    task: Any
    deaths: int = 0
    is_wanted: bool = True


@dataclass(slots=True, eq=False)
class _Process:
    process: subprocess.Popen[bytes]  # the worker's standard input ends when this process ends
    is_ready: bool = False
    job: _Job | None = None


class LocalWorkers:
    """Processes on this machine, started when there are tasks for them, and ended when the context is left.

    Parameters
    ----------
    count
        Number of processes.
    attempts
        Number of attempts at a task, which is repeated when its worker dies.
    """

    are_there = True

    def __init__(self, count: int, attempts: int = MOST_DEATHS) -> None:
        self._count = count
        self._attempts = attempts
        self._waiting: deque[_Job] = deque()
        self._processes: dict[Connection, _Process] = {}
        self._failed_starts = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for started in self._processes.values():
            started.process.kill()
        for connection in list(self._processes):
            self._remove(connection)

    def send(self, function: Callable[[Any], Any], tasks: Mapping[Any, Any]) -> None:
        """Run a function of a module for each task, in order; the keys name the tasks."""
        self._waiting.extend(_Job(key, function, task) for key, task in tasks.items())
        self._hand_out()

    def ended(self, seconds: float) -> list[Ended]:
        """Return the tasks that have ended; wait up to a timeout for the first.

        Raises ExperimentError if all workers end while starting.
        """
        done: list[Ended] = []
        for connection in wait(list(self._processes), seconds):
            assert isinstance(connection, Connection)
            started = self._processes[connection]
            try:
                succeeded, value = connection.recv()
            except (EOFError, OSError):
                done += self._died(connection)
                continue
            if not started.is_ready:
                started.is_ready, self._failed_starts = True, 0
                continue
            job, started.job = started.job, None
            if job is not None and job.is_wanted:
                done.append(Ended(job.key, value) if succeeded else Ended(job.key, error=value))
        self._hand_out()
        return done

    def drop_waiting(self) -> list[Any]:
        """Cancel the tasks that have not started; return their keys."""
        keys = [job.key for job in self._waiting]
        self._waiting.clear()
        return keys

    def drop(self) -> None:
        """Cancel all tasks; workers finish their current ones, whose results are ignored."""
        self._waiting.clear()
        for started in self._processes.values():
            if started.job is not None:
                started.job.is_wanted = False

    def _hand_out(self) -> None:
        """Send the next tasks to idle workers; start more workers if there are too few."""
        idle = deque(connection for connection, started in self._processes.items() if started.job is None)
        while self._waiting and (idle or len(self._processes) < self._count):
            connection = idle.popleft() if idle else self._start()
            job = self._waiting.popleft()
            self._processes[connection].job = job
            # `ended` notices a worker that has died meanwhile
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                connection.send((job.function, job.task))

    def _start(self) -> Connection:
        ours, theirs = Pipe()
        with theirs, _signals_blocked():  # an interrupt while a worker starts concerns only this process
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", _START, str(theirs.fileno()), str(private_folder())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                env=_ONE_THREAD | os.environ,
            )
        self._processes[ours] = _Process(process)
        return ours

    def _died(self, connection: Connection) -> list[Ended]:
        """Remove a dead worker; the worker's task is repeated, or ends after the last attempt."""
        died = self._remove(connection)
        code = died.process.returncode
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        if not died.is_ready:
            self._failed_starts += 1
            if self._failed_starts >= MOST_DEATHS:
                raise ExperimentError(f"the workers end while starting, {how}; is there enough memory?")
        job = died.job
        if job is None or not job.is_wanted:
            return []
        job.deaths += 1
        if job.deaths < self._attempts:
            self._waiting.appendleft(job)
            return []
        return [Ended(job.key, error=WorkerDiedError(f"the workers died, the last one {how}; is there enough memory?"))]

    def _remove(self, connection: Connection) -> _Process:
        removed = self._processes.pop(connection)
        connection.close()
        assert removed.process.stdin is not None
        removed.process.stdin.close()
        removed.process.wait()
        return removed


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """Block termination signals in this thread and its new processes until the context ends."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def work() -> None:
    """Run tasks until the parent process has ended, or closes the socket."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    life = os.dup(0)  # keep the parent's pipe here, so that tasks have no standard input
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    threading.Thread(target=_end_with, args=(life,), name="end-with-parent", daemon=True).start()
    keep_freed_memory()
    collect_garbage_rarely()
    leave_pandas_out()
    move_into(Path(sys.argv[2]))
    connection = Connection(int(sys.argv[1]))
    connection.send((True, None))  # ready
    while True:
        try:
            received = connection.recv_bytes()
        except EOFError:
            return
        connection.send_bytes(_answer(received))


def _answer(received: bytes) -> bytes:
    """Run a task; return whether it succeeded, and its result or its exception, pickled."""
    try:
        function, task = pickle.loads(received)
        return pickle.dumps((True, function(task)))
    except Exception as error:
        try:
            answer = pickle.dumps((False, error))
            pickle.loads(answer)
        except Exception:  # pickle cannot rebuild this exception from its arguments
            answer = pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")))
        return answer


def _end_with(life: int) -> None:
    os.read(life, 1)
    os._exit(1)
