"""The budget of a look ahead, counted in work and not by a clock, so that a promise has the same bits on any machine.

Work is in nominal seconds: the steps, iterations, held contacts and impacts of the runs ahead, times their measured
costs on one core of docs/performance.md. On another or a busy machine the clock shows more, but the runs ahead end at
the same step. A budget by the clock would let a scene get one step on a fast machine and another one on a slow one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from carom.plan.auto import gravity_method
from carom.scene.schema import Scene

LEAST = 5.0  # nominal s
PART_OF_RUN = 0.1  # of the nominal time of the run itself, where that is more
MOST = 60.0  # nominal s; contacts that chatter take ever more steps, so that a run would never end

# Nominal s, to a factor of two: a call from Python, a step in a kernel, and what a body or contact adds to a step.
CALL, CALL_WITH_CONTACTS = 2e-5, 1e-4
KERNEL_STEP, KERNEL_BODY = 1e-7, 1e-8
CONTACT_BODY = 5e-7  # search, and the next impacts
HELD_STEP, HELD_CONTACT, SWEEP = 4e-4, 1e-6, 4e-8  # where contacts are held; the last for a contact and an iteration
IMPACT = 1.4e-6
PAIR = 3.2e-10  # of a direct sum, counted from both ends; few bodies take longer
TREE_BODY, TREE_ANGLE = 1.2e-6, 0.5  # of a tree at this opening angle; the number of boxes grows like 1/angle³
RADAU_STEP, RADAU_BODY, RADAU_PAIR = 1e-6, 4e-7, 3.5e-8  # of an iteration of Gauss–Radau integration
ITERATIONS = 2.5  # of its step
ORBIT_STEP, ORBIT_BODY = 1e-7, 1e-7  # of Wisdom–Holman integration
AT_ONCE = 0.05  # that a kernel may take between two looks at the budget

Watcher = Callable[["Budget"], None]


@dataclass
class Budget:
    """Work that a look ahead may do, and has done."""

    duration: float  # s, of the run
    watch: Watcher | None = None  # called now and then while runs ahead go on
    own: float = 0.0  # nominal s, the work of the run itself, by the pace of the latest run ahead
    spent: float = 0.0  # nominal s
    reached: float = 0.0  # s, where the present run ahead is
    covered: float = field(default=math.inf)  # s, up to which all runs ahead came before the budget ended

    @property
    def total(self) -> float:
        """All that may be spent, in nominal s."""
        return max(LEAST, min(PART_OF_RUN * self.own, MOST))

    @property
    def left(self) -> float:
        """What may still be spent, in nominal s."""
        return max(0.0, self.total - self.spent)

    def spend(self, work: float, reached: float) -> None:
        """Note work in nominal s of a run ahead that has reached a time in s."""
        self.spent += work
        self.reached = reached
        if self.watch:
            self.watch(self)

    def cover(self, until: float) -> None:
        """Note that a run ahead ended at a time in s because its share of the budget was spent."""
        self.covered = min(self.covered, until)


def force_work(scene: Scene) -> float:
    """Return the nominal time in s of a sum of all forces."""
    n, method = scene.count, gravity_method(scene)
    work = KERNEL_BODY * n
    if method == "none":
        return work
    direct = PAIR * n * n
    if method == "direct":
        return work + direct
    return work + min(direct, TREE_BODY * n * (TREE_ANGLE / scene.gravity.opening_angle) ** 3)


def radau_work(bodies: int) -> float:
    """Return the nominal time in s of an iteration of a Gauss–Radau step."""
    return RADAU_STEP + RADAU_BODY * bodies + RADAU_PAIR * bodies * bodies
