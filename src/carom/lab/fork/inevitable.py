"""The moment from which an outcome was inevitable: bisection over the time of the fork, with a sequential test.

At each time forks are made until Wald's test of the probability p of the outcome decides between p ≥ 0.99 and p ≤ 0.9,
with errors of 5 %. After k outcomes of m forks the logarithm of the likelihood ratio is

    k ln(0.99/0.9) + (m - k) ln(0.01/0.1)

and the test ends when it leaves (ln(0.05/0.95), ln(0.95/0.05)). If all forks agree it takes 31 of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

SURE, UNSURE, ERROR = 0.99, 0.9, 0.05
ROUNDS = 8  # of the bisection: the interval shrinks to 1/256

Draw = Callable[[float], Iterator[bool]]  # time of the fork in s → whether forks have the outcome, one after another


@dataclass(frozen=True, slots=True)
class Tested:
    """A time of the fork that was tested."""

    time: float  # s
    hits: int
    forks: int
    inevitable: bool


@dataclass(slots=True)
class Inevitable:
    """When an outcome became inevitable."""

    earliest: float  # s, at which it was not, or the beginning
    latest: float  # s, from which on it is
    always: bool  # whether it was so from the beginning on
    tested: list[Tested] = field(default_factory=list)  # in order of time


def inevitable(draw: Draw, begin: float, end: float, rounds: int = ROUNDS) -> Inevitable:
    """Find the moment between two times (s); at the end the outcome is known to come about."""
    first = judge(draw, begin)
    found = Inevitable(begin, begin if first.inevitable else end, first.inevitable, [first])
    for _ in range(0 if first.inevitable else rounds):
        middle = 0.5 * (found.earliest + found.latest)
        tested = judge(draw, middle)
        found.tested.append(tested)
        if tested.inevitable:
            found.latest = middle
        else:
            found.earliest = middle
    found.tested.sort(key=lambda tested: tested.time)
    return found


def judge(draw: Draw, time: float) -> Tested:
    """Test whether the outcome of forks at a time (s) is all but certain."""
    upper = math.log((1.0 - ERROR) / ERROR)
    evidence, hits, forks = 0.0, 0, 0
    for came in draw(time):
        forks += 1
        hits += came
        evidence += math.log(SURE / UNSURE) if came else math.log((1.0 - SURE) / (1.0 - UNSURE))
        if abs(evidence) >= upper:
            break
    return Tested(time, hits, forks, evidence > 0.0)
