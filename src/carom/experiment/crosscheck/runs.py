"""Follows runs of engines, several at a time in processes of their own; nothing is timed meanwhile."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from carom.experiment.engines.engine import engine_called
from carom.experiment.engines.watched import COMPLETED, Watched, watch
from carom.experiment.error import ExperimentError
from carom.experiment.work_precision.settings_grid import Setting
from carom.experiment.work_precision.trajectory import Trajectory, sample_times
from carom.physics.parallel.cores import cores
from carom.scene.schema import Scene

MIN_RUNS_FOR_PROCESSES = 8  # for fewer, processes take longer to start than they save


@dataclass(frozen=True, slots=True)
class Task:
    """A run of an engine that is to be followed."""

    scene: Scene
    setting: Setting
    path: Path  # of its recording
    limit: float  # s of CPU time


@dataclass(frozen=True, slots=True)
class Followed:
    """What came of a task."""

    watched: Watched
    trajectory: Trajectory | None  # None if the run failed
    reason: str  # why it did


def execute(task: Task) -> Followed:
    """Follow a run step by step, and record it; sample it once more where the engine can do so between steps."""
    engine = engine_called(task.setting.engine)
    engine.ensure_installed()
    times = sample_times(task.scene)
    seen = watch(engine.begin(task.scene, task.setting), task.scene, times, task.path, task.limit)
    if engine.samples_steps(task.scene):
        done = seen.outcome == COMPLETED
        return Followed(seen, seen.trajectory if done else None, "" if done else seen.outcome.removeprefix("failed: "))
    try:
        return Followed(seen, engine.follow(task.scene, task.setting, times), "")
    except ExperimentError as error:
        return Followed(seen, None, str(error))


class Runs:
    """Follows runs; a context, which ends what is unfinished.

    Parameters
    ----------
    workers
        Processes; None is one for each core from `MIN_RUNS_FOR_PROCESSES` runs on, and 1 does all in this process.
    """

    def __init__(self, workers: int | None) -> None:
        self._workers = workers
        self._tasks: dict[Path, Task] = {}
        self._begun: dict[Path, Future[Followed]] = {}
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._pool is None:
            return
        if kind is not None:
            for process in multiprocessing.active_children():
                process.terminate()
        self._pool.shutdown(cancel_futures=True)

    def announce(self, task: Task) -> None:
        """Take a run that will be asked for."""
        self._tasks[task.path] = task

    def begin(self) -> None:
        """Begin all runs that were announced, if other processes follow them."""
        workers = self._workers or (cores() if len(self._tasks) >= MIN_RUNS_FOR_PROCESSES else 1)
        if workers == 1 or len(self._tasks) < 2:
            return
        spawn = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(min(workers, len(self._tasks)), spawn)
        with _ignoring_interrupts():
            self._begun = {path: self._pool.submit(execute, task) for path, task in self._tasks.items()}

    def result(self, task: Task) -> Followed:
        """Return what came of a run; wait for it, or follow it here."""
        begun = self._begun.pop(task.path, None)
        if begun is None:
            return execute(task)
        try:
            return begun.result()
        except BrokenProcessPool:
            raise ExperimentError(
                f"{task.setting.name}, or a run beside it, ended its process; the same command continues, and with "
                "--workers 1 it shows which"
            ) from None


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Begin processes that ignore the interrupt key from the start: this one ends them."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
