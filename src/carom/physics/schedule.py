"""The schedule of a run: the steps with a frame, the steps with a check of errors, and the end.

Steps do not depend on schedules. The last step of a run always has a frame and a check.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from carom.physics.world import Clock

Schedule = Callable[[int, float, float], bool]  # step, times before and after the step → whether the step is scheduled

MULTIPLE_TOLERANCE = 1e-9  # ignored relative difference between a time and a multiple of the frame interval


class Watch(ABC):
    """A schedule that reads the state before each step for which it is called, and states which steps it can skip."""

    @abstractmethod
    def __call__(self, step: int, before: float, time: float) -> bool:
        """Return whether a step is scheduled."""

    @abstractmethod
    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """At the end of a step, return the number of steps and the time (s) before which nothing is due."""


@dataclass(frozen=True, slots=True)
class Every:
    """A schedule of the first step at or after each multiple of an interval (s); 0 means every step."""

    interval: float

    def __call__(self, step: int, before: float, time: float) -> bool:
        """Return whether a step passes a multiple."""
        return self.interval == 0.0 or _multiples(time, self.interval) > _multiples(before, self.interval)

    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """Return the number of steps and the time (s) before which nothing is due."""
        if self.interval == 0.0:
            return 1, time
        following = (_multiples(time, self.interval) + 1.0) * self.interval
        return math.inf, following * (1.0 - 2.0 * MULTIPLE_TOLERANCE)


@dataclass(frozen=True, slots=True)
class At:
    """A schedule that lists steps."""

    steps: tuple[int, ...]  # numbers of the steps, in ascending order

    def __call__(self, step: int, before: float, time: float) -> bool:
        """Return whether a step is in the list."""
        place = bisect_left(self.steps, step)
        return place < len(self.steps) and self.steps[place] == step

    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """Return the number of steps and the time (s) before which nothing is due."""
        place = bisect_right(self.steps, step)
        return self.steps[place] - step if place < len(self.steps) else math.inf, math.inf


@dataclass(frozen=True, slots=True)
class Pause:
    """A schedule without frames: a call that takes many steps ends once a step reaches or passes a time (s)."""

    time: float

    def __call__(self, step: int, before: float, time: float) -> bool:
        """Return False: no frame is due."""
        return False

    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """Return the number of steps and the time (s) before which nothing is due."""
        return math.inf, self.time


@dataclass(frozen=True, slots=True)
class Checks:
    """A schedule of every k-th step, and of all steps of another schedule."""

    steps: int
    others: Schedule

    def __call__(self, step: int, before: float, time: float) -> bool:
        """Return whether a step is scheduled."""
        return step % self.steps == 0 or self.others(step, before, time)

    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """Return the number of steps and the time (s) before which nothing is due."""
        steps, until = quiet(self.others, step, time)
        return min(steps, self.steps - step % self.steps), until


def every(interval: float) -> Schedule:
    """Return the schedule of the first step at or after each multiple of an interval (s); 0 means every step."""
    return Every(interval)


def at(steps: Iterable[int]) -> Schedule:
    """Return the schedule of given steps."""
    return At(tuple(sorted(steps)))


def quiet(schedule: Schedule, step: int, time: float) -> tuple[float, float]:
    """Return the number of steps and the time (s) before which a schedule need not be evaluated.

    Schedules of other types are evaluated for every step.
    """
    return schedule.quiet(step, time) if isinstance(schedule, Every | At | Pause | Checks | Watch) else (1, time)


def looks_before(schedule: Schedule) -> bool:
    """Return whether a schedule may read the state before each step.

    Schedules of this module do not read the state. Any other schedule may read the state, so a call that takes many
    steps ends before a scheduled step.
    """
    return not isinstance(schedule, Every | At | Pause)


def _multiples(time: float, interval: float) -> float:
    """Count the multiples of an interval up to a time, with a tolerance, since the clock is a sum of steps."""
    return time / interval * (1.0 + MULTIPLE_TOLERANCE) // 1.0


class Goal(NamedTuple):
    """The end and the schedules of a run."""

    end: float  # s, end of the run
    schedule: Schedule  # steps after which a frame is due
    checks: Schedule  # steps after which the errors are checked
    most: int  # largest number of steps
    shows_end: bool = True  # whether a frame is due after the last step

    def is_reached(self, clock: Clock) -> bool:
        """Whether the last step has a frame, because the schedule requests a frame or the run ends."""
        return self.schedule(clock.step, clock.before, clock.time) or (self.shows_end and clock.limit == "end")

    def is_check(self, clock: Clock) -> bool:
        """Whether the last step has a check of errors, because `checks` requests one or the run ends."""
        return self.checks(clock.step, clock.before, clock.time) or (self.shows_end and clock.limit == "end")

    def quiet(self, clock: Clock) -> tuple[float, float]:
        """Return the number of steps and the time (s) before which neither a frame nor a check is due."""
        frame, check = (quiet(due, clock.step, clock.time) for due in (self.schedule, self.checks))
        return min(frame[0], check[0]), min(frame[1], check[1])
