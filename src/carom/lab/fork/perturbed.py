"""Runs branches on workers, one thread each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from carom.lab.fork.branch import Branch, Start, start_of
from carom.lab.fork.path import OPTION, Path, path_of
from carom.lab.shrink.expression import Expression
from carom.physics.periodic_box import minimum_images
from carom.runs.workers import Workers

FloatArray = NDArray[np.float64]

_TICK = 60.0  # s of a wait for results
_STARTS = 4  # moments and reference paths that a worker keeps


@dataclass(frozen=True, slots=True)
class Task:
    """One perturbed branch."""

    branch: Branch
    seed: int
    ulps: int
    outcome: str | None


@dataclass(frozen=True, slots=True)
class Result:
    """How far the bodies of a perturbed branch are from those of the unperturbed one."""

    seed: int
    apart: NDArray[np.float32]  # (k, n) m
    outcome: bool | None


def results_of(tasks: Iterable[Task], workers: Workers) -> Iterator[Result]:
    """Yield results as they come; what has not begun when the caller stops is dropped.

    The bits do not depend on how many workers there are.

    Raises
    ------
    ExperimentError
        If the workers died.
    """
    left = {task.seed: task for task in tasks}
    workers.send(execute, left)
    try:
        while left:
            for ended in workers.ended(_TICK):
                del left[ended.key]
                yield ended.result
    finally:
        workers.drop()


def by_seed(results: Iterable[Result]) -> Iterator[Result]:
    """Yield results in the order of their seeds, from 1 on, so that a test of them does not depend on the workers."""
    waiting: dict[int, Result] = {}
    seed = 1
    for result in results:
        waiting[result.seed] = result
        while seed in waiting:
            yield waiting.pop(seed)
            seed += 1


def execute(task: Task) -> Result:
    """Run one branch."""
    start, reference = _prepared(task.branch)
    outcome = None if task.outcome is None else Expression(task.outcome, OPTION)
    path = path_of(start, task.seed, task.ulps, outcome)
    return Result(task.seed, apart(path.position, reference.position, start).astype(np.float32), path.outcome)


def apart(a: FloatArray, b: FloatArray, start: Start) -> FloatArray:
    """Return the distances of counterparts, (k, n) m, through the boundary of a periodic box where that is nearer."""
    off = a - b
    if start.scene.domain.boundary == "periodic":
        box = np.asarray(start.scene.domain.size, dtype=np.float64)
        off = minimum_images(off, box)
    return np.asarray(np.sqrt((off * off).sum(axis=2)))


@lru_cache(_STARTS)
def _prepared(branch: Branch) -> tuple[Start, Path]:
    start = start_of(branch)
    return start, path_of(start, None, 0, None)
