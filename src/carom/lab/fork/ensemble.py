"""`Ensemble`: many branches from states that differ by a few bits, and how far they spread."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carom.lab.diff.divergence import Curve, Divergence, divergence_of
from carom.lab.fork.branch import Branch, Start
from carom.lab.fork.chance import Chance
from carom.lab.fork.path import Path, path_of
from carom.lab.fork.perturbed import Result, Task
from carom.lab.shrink.expression import Expression

FloatArray = NDArray[np.float64]

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
    start: Start,
    branch: Branch,
    seeds: int,
    ulps: int,
    run: Callable[[list[Task]], Iterable[Result]],
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
    tasks = [Task(branch, seed, ulps, text) for seed in range(1, seeds + 1)]
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


def _curve(reference: Path, rms: FloatArray) -> Curve:
    """Write distances as `carom diff` reads them."""
    first = reference.position[0]
    off = first - first.mean(axis=0)
    reach = float(np.abs(reference.position[np.isfinite(reference.position)]).max())
    return Curve(
        step=np.arange(len(rms)),
        time=reference.time,
        rms=rms,
        floor=np.full(len(rms), np.finfo(np.float64).eps * reach),
        energy=np.zeros(len(rms)),
        differs=rms > 0.0,
        size=float(np.sqrt((off * off).sum(axis=1).mean())),
        reach=reach,
    )
