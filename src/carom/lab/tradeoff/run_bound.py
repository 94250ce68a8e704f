"""How far a compared run may go: a number of steps, which is the same on every machine, and a CPU time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from carom.errors import ExperimentError

TELLING = 5.0  # s between two lines of progress


class RunStoppedError(ExperimentError):
    """A run was stopped at its bound.

    Parameters
    ----------
    reached
        The simulated time as text, with its unit.
    by_limit
        Whether the CPU time stopped it, which ``--limit`` sets.
    """

    def __init__(self, steps: int, seconds: float, reached: str, *, by_limit: bool) -> None:
        self.steps, self.seconds = steps, seconds
        after = f"{seconds:.3g} s of CPU time (--limit)" if by_limit else f"{steps} steps"
        super().__init__(f"stopped after {after}, at t = {reached}")


@dataclass(frozen=True, slots=True)
class RunBound:
    """The bound of a run."""

    steps: float = math.inf
    seconds: float = math.inf  # of CPU time


class RunGuard:
    """Watches a run from its start: when to stop it, and what to say of it meanwhile.

    Parameters
    ----------
    bound
        How far it may go.
    tell
        Called with a step and a simulated time in s, every `TELLING` seconds.
    """

    def __init__(self, bound: RunBound, tell: Callable[[int, float], None]) -> None:
        self._bound, self._tell = bound, tell
        self._began, self._told = time.process_time(), time.perf_counter()

    @property
    def seconds(self) -> float:
        """CPU time since the start, in s."""
        return time.process_time() - self._began

    def is_over(self, step: int, reached: float) -> bool:
        """Tell whether to stop after a step that reached a simulated time in s."""
        if time.perf_counter() - self._told > TELLING:
            self._told = time.perf_counter()
            self._tell(step, reached)
        return step >= self._bound.steps or self.seconds > self._bound.seconds

    @property
    def is_late(self) -> bool:
        """Whether the CPU time is over, not the number of steps."""
        return self.seconds > self._bound.seconds
