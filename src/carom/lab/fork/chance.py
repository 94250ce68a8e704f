"""The probability of an outcome over the time of the fork."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from carom.lab.fork.inevitable import Draw

_Z = 1.96  # standard deviations of a normal distribution, of which 95 % are nearer


@dataclass(frozen=True, slots=True)
class Chance:
    """How many forks at a time have an outcome."""

    time: float  # s, of the fork
    hits: int
    forks: int

    @property
    def probability(self) -> float:
        """The part of the forks that have it."""
        return self.hits / self.forks

    @property
    def band(self) -> tuple[float, float]:
        """The interval that has the probability with 95 % (Wilson, JASA 22, 209, 1927)."""
        n, p, z2 = self.forks, self.probability, _Z * _Z
        middle, half = p + z2 / (2 * n), _Z * math.sqrt(p * (1.0 - p) / n + z2 / (4 * n * n))
        low, high = ((middle + sign * half) / (1.0 + z2 / n) for sign in (-1.0, 1.0))
        return max(0.0, low), min(1.0, high)


def chances(draw: Draw, begin: float, end: float, count: int, last_step: float = math.inf) -> Iterator[Chance]:
    """Fork at equal distances after a time (s) and before the end; ``count`` is that of the intervals.

    A fork begins at the end of a step, so none begins after ``last_step``, where the last one does (s).
    """
    for k in range(1, count):
        time = begin + (end - begin) * k / count
        if time > last_step:
            return
        came = list(draw(time))
        yield Chance(time, sum(came), len(came))
