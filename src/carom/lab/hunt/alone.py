"""Compare the bits of a scene that runs alone in a new process with its bits after the other scenes of a hunt.

All scenes share the compiled kernels of their process, which other processes may have stored. If something leaks from
one scene to the next, such as a kernel that is linked to the record layout of another scene, neither the ledger nor a
replay in the same process shows the leak. Only a run in another process can show it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from carom.errors import PhysicsError, SceneError
from carom.lab.hunt.random_scenes import drawn
from carom.lab.shrink.trials import Budget, observe
from carom.physics.space import Space
from carom.runs.environment import Interrupts
from carom.runs.workers import LocalWorkers
from carom.scene.load import Scene

POLL = 0.2  # s between two checks of the budget
STEPS = 400  # largest number of steps of a run; a longer run is abandoned


@dataclass(frozen=True, slots=True)
class Ending:
    """The end of a run: the bits of its state, and the error that ended it."""

    step: int
    fingerprint: int
    error: str = ""


def last_ending(scenes: Sequence[tuple[int, int]]) -> Ending | None:
    """Run scenes, given by their seeds and numbers, one after the other; return the last scene's end.

    The end is None if that scene is refused or abandoned.
    """
    last = None
    with Interrupts() as interrupts:
        for seed, index in scenes:
            try:
                space = Space(Scene.from_dict(drawn(seed, index).document), threads=1)
                seen = observe(space, Budget(math.inf, interrupts), steps=STEPS)
            except (SceneError, PhysicsError):
                seen = None
            last = None if seen is None else Ending(space.step, space.fingerprint(), seen.error)
    return last


def in_new_processes(tasks: Iterable[Sequence[tuple[int, int]]], budget: Budget) -> Iterable[Ending | None]:
    """Yield `last_ending` of each list of scenes, each run in a process of its own. Raises `OutOfTime`."""
    for task in tasks:
        with LocalWorkers(1, attempts=1) as worker:
            worker.send(last_ending, {0: task})
            while not (ended := worker.ended(POLL)):
                budget.check()
            found: Ending | None = ended[0].result
            yield found


def difference(seed: int, index: int, here: Ending, before: Sequence[int], budget: Budget) -> str:
    """Compare a scene's end in this process with its end alone; return a sentence if they differ, else an empty text.

    ``before`` has the numbers of the scenes that ran earlier in this process.
    """
    (alone,) = in_new_processes([[(seed, index)]], budget)
    if alone == here:
        return ""
    pairs = in_new_processes(([(seed, other), (seed, index)] for other in reversed(before)), budget)
    for other, together in zip(reversed(before), pairs, strict=True):
        if together != alone:
            return f"its bits differ after scene {other} of the same seed, in one process"
    return "its bits differ when it runs alone in a new process, but not after any single other scene"
