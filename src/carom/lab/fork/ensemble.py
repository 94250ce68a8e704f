"""`Ensemble`: the spread of many branches from states that differ by a few bits, and the probability of an outcome.

`inevitable` finds the moment from which an outcome was inevitable: bisection over the time of the fork, with a
sequential test. At each time forks are made until Wald's test of the probability p of the outcome decides between
p ≥ 0.99 and p ≤ 0.9, with errors of 5 %. After k outcomes of m forks the logarithm of the likelihood ratio is

    k ln(0.99/0.9) + (m - k) ln(0.01/0.1)

and the test ends when it leaves (ln(0.05/0.95), ln(0.95/0.05)). If all forks agree it takes 31 of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from carom.arrays import FloatArray
from carom.lab.diff.divergence import DistanceCurve, Divergence, divergence_of
from carom.lab.fork.branch import Branch, BranchPath, ForkStart, PerturbedResult, PerturbedTask, path_of
from carom.lab.run_summary import Expression

# The probability of an outcome over the time of the fork.
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


BAND = (5.0, 50.0, 95.0)  # percentiles


@dataclass(frozen=True, slots=True)
class Ensemble:
    """Distances of perturbed branches from the unperturbed one.

    `spread` is the root of the mean square over all branches, so it shows which bodies can still be predicted.
    """

    time: FloatArray  # (k,) s
    reference: FloatArray  # (k, n, 3) m
    rms: FloatArray  # (seeds, k) m, over the bodies of each branch
    band: FloatArray  # (3, k) m, percentiles `BAND` of these
    spread: FloatArray  # (k, n) m, of each body
    growth: Divergence | None  # of the median
    rates: FloatArray  # (r,) 1/s, λ of the branches that have one
    outcomes: list[bool]  # of the branches
    reference_outcome: bool | None
    chances: list[Chance] = field(default_factory=list)  # of the outcome, by the time of the fork

    @property
    def rate_error(self) -> float:
        """Standard deviation of λ between branches, in 1/s; infinite if fewer than two have one."""
        return float(self.rates.std(ddof=1)) if len(self.rates) > 1 else np.inf


def ensemble(
    start: ForkStart,
    branch: Branch,
    seeds: int,
    ulps: int,
    run: Callable[[list[PerturbedTask]], Iterable[PerturbedResult]],
    outcome: Expression | None = None,
    watch: Callable[[int], None] = lambda done: None,
) -> Ensemble:
    """Run perturbed branches, with seeds from 1 on.

    Parameters
    ----------
    start
        The state at the fork.
    branch
        The same, for workers.
    seeds
        Number of branches.
    ulps
        Units in the last place by which each coordinate of a position is moved.
    run
        Runs the branches.
    outcome
        On the summary of each branch, from `outcome_of`.
    watch
        Called with the number of branches that are done.
    """
    reference = path_of(start, None, 0, outcome, None)
    rms = np.empty((seeds, len(reference.time)))
    squares = np.zeros(reference.position.shape[:2])
    outcomes: dict[int, bool] = {}
    text = None if outcome is None else outcome.text
    tasks = [PerturbedTask(branch, seed, ulps, text) for seed in range(1, seeds + 1)]
    for done, found in enumerate(run(tasks), 1):
        square = found.apart.astype(np.float64) ** 2
        squares += square
        rms[found.seed - 1] = np.sqrt(square.mean(axis=1))
        if found.outcome is not None:
            outcomes[found.seed] = found.outcome
        watch(done)
    band = np.percentile(rms, BAND, axis=0)
    growths = [divergence_of(_curve(reference, row)) for row in rms]
    return Ensemble(
        time=reference.time,
        reference=reference.position,
        rms=rms,
        band=band,
        spread=np.sqrt(squares / seeds),
        growth=divergence_of(_curve(reference, band[1])),
        rates=np.array([growth.rate for growth in growths if growth is not None and growth.is_exponential]),
        outcomes=[outcomes[seed] for seed in sorted(outcomes)],
        reference_outcome=reference.outcome,
    )


def _curve(reference: BranchPath, rms: FloatArray) -> DistanceCurve:
    """Write distances as `carom diff` reads them."""
    first = reference.position[0]
    off = first - first.mean(axis=0)
    reach = float(np.abs(reference.position[np.isfinite(reference.position)]).max())
    return DistanceCurve(
        step=np.arange(len(rms)),
        time=reference.time,
        rms=rms,
        floor=np.full(len(rms), np.finfo(np.float64).eps * reach),
        energy=np.zeros(len(rms)),
        differs=rms > 0.0,
        size=float(np.sqrt((off * off).sum(axis=1).mean())),
        reach=reach,
    )
