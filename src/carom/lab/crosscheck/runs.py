"""Follows runs of engines, several at a time in processes of their own; nothing is timed meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from carom.errors import ExperimentError
from carom.lab.engines.engine import engine_called
from carom.lab.engines.watched import COMPLETED, Watched, watch
from carom.lab.tradeoff.settings_grid import Setting
from carom.lab.tradeoff.trajectory import Trajectory, sample_times
from carom.physics.parallel.cores import cores
from carom.runs.workers import Ended, LocalWorkers, WorkerDiedError
from carom.scene.schema import Scene

MIN_RUNS_FOR_PROCESSES = 8  # for fewer, processes take longer to start than they save
_TICK = 60.0  # s of a wait for runs


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
        self._pool: LocalWorkers | None = None
        self._begun: set[Path] = set()
        self._ended: dict[Path, Ended] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.__exit__(kind, error, traceback)

    def announce(self, task: Task) -> None:
        """Take a run that will be asked for."""
        self._tasks[task.path] = task

    def begin(self) -> None:
        """Begin all runs that were announced, if other processes follow them."""
        workers = self._workers or (cores() if len(self._tasks) >= MIN_RUNS_FOR_PROCESSES else 1)
        if workers == 1 or len(self._tasks) < 2:
            return
        self._pool = LocalWorkers(min(workers, len(self._tasks)), attempts=1)
        self._begun = set(self._tasks)
        self._pool.send(execute, self._tasks)

    def result(self, task: Task) -> Followed:
        """Return what came of a run; wait for it, or follow it here."""
        if task.path not in self._begun:
            return execute(task)
        self._begun.remove(task.path)
        assert self._pool is not None
        while task.path not in self._ended:
            self._ended |= {ended.key: ended for ended in self._pool.ended(_TICK)}
        try:
            followed: Followed = self._ended.pop(task.path).result
        except WorkerDiedError:
            raise ExperimentError(
                f"{task.setting.name} ended its process; the same command continues, with --workers 1 without others"
            ) from None
        return followed
