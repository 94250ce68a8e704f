"""Branches of a recording: runs that continue from a recorded state, or from states that differ from it by a few bits.

`Ensemble` describes the spread of many branches and the probability of an outcome. `inevitable` finds the time from
which an outcome was inevitable: it bisects the time of the fork. At each time, branches are run until Wald's sequential
test of the probability p of the outcome decides between p ≥ 0.99 and p ≤ 0.9, with errors of 5 %. If the outcome
occurred in k of m branches, the logarithm of the likelihood ratio is

    k ln(0.99/0.9) + (m - k) ln(0.01/0.1)

The test ends when this value leaves the interval (ln(0.05/0.95), ln(0.95/0.05)). If all branches agree, the test takes
31 branches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from carom.arrays import FloatArray
from carom.display.forecast import Forecast, write_forecast
from carom.lab.diff.diff import Diff, diff, overlay
from carom.lab.diff.divergence import DistanceCurve, Divergence, divergence_of
from carom.lab.fork.branch import Branch, BranchPath, ForkStart, PerturbedResult, PerturbedTask, path_of
from carom.lab.run_summary import Expression
from carom.private_folder import temporary_folder
from carom.recording.read.recording import Recording
from carom.runs.outcome import in_words
from carom.runs.run import Outcome, simulate
from carom.scene.units.dimension import LENGTH, TIME

# The probability of an outcome as a function of the time of the fork.
_Z = 1.96  # half-width, in standard deviations, of the interval that contains 95 % of a normal distribution


@dataclass(frozen=True, slots=True)
class Chance:
    """The number of forks at one time, and the number of forks with the outcome."""

    time: float  # s, time of the fork
    hits: int
    forks: int

    @property
    def probability(self) -> float:
        """The fraction of forks with the outcome."""
        return self.hits / self.forks

    @property
    def band(self) -> tuple[float, float]:
        """The interval that contains the probability with a confidence of 95 % (Wilson, JASA 22, 209, 1927)."""
        n, p, z2 = self.forks, self.probability, _Z * _Z
        middle, half = p + z2 / (2 * n), _Z * math.sqrt(p * (1.0 - p) / n + z2 / (4 * n * n))
        low, high = ((middle + sign * half) / (1.0 + z2 / n) for sign in (-1.0, 1.0))
        return max(0.0, low), min(1.0, high)


def chances(draw: Draw, begin: float, end: float, count: int, last_step: float = math.inf) -> Iterator[Chance]:
    """Divide the time from ``begin`` to ``end`` (s) into ``count`` equal intervals, and fork between them.

    A fork begins at the end of a step, so none begins after ``last_step``, the time (s) at which the last step begins.
    """
    for k in range(1, count):
        time = begin + (end - begin) * k / count
        if time > last_step:
            return
        came = list(draw(time))
        yield Chance(time, sum(came), len(came))


SURE, UNSURE, ERROR = 0.99, 0.9, 0.05
ROUNDS = 8  # rounds of bisection: the interval shrinks to 1/256

Draw = Callable[[float], Iterator[bool]]  # time of the fork in s → whether each fork had the outcome


@dataclass(frozen=True, slots=True)
class Tested:
    """A tested time for the fork."""

    time: float  # s, time of the fork
    hits: int
    forks: int
    inevitable: bool


@dataclass(slots=True)
class Inevitable:
    """The time from which an outcome was inevitable."""

    earliest: float  # s, last time at which the outcome was not yet inevitable, or the beginning
    latest: float  # s, first time at which the outcome is inevitable
    always: bool  # whether the outcome was inevitable from the beginning
    tested: list[Tested] = field(default_factory=list)  # tested times, in order


def inevitable(draw: Draw, begin: float, end: float, rounds: int = ROUNDS) -> Inevitable:
    """Find the time from which the outcome is inevitable, by bisection; at ``end`` (s), the outcome is certain."""
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
    """Return whether the outcome of forks at a time (s) is almost certain."""
    upper = math.log((1.0 - ERROR) / ERROR)
    evidence, hits, forks = 0.0, 0, 0
    for came in draw(time):
        forks += 1
        hits += came
        evidence += math.log(SURE / UNSURE) if came else math.log((1.0 - SURE) / (1.0 - UNSURE))
        if abs(evidence) >= upper:
            break
    return Tested(time, hits, forks, evidence > 0.0)


BAND = (5.0, 50.0, 95.0)  # percentiles of an ensemble's distances


@dataclass(frozen=True, slots=True)
class Ensemble:
    """Distances of perturbed branches from the unperturbed one.

    `spread` is the rms distance of each body over all branches; it shows which bodies are still predictable.
    """

    time: FloatArray  # (k,) s
    reference: FloatArray  # (k, n, 3) m
    rms: FloatArray  # (seeds, k) m, rms distance over the bodies of each branch
    band: FloatArray  # (3, k) m, percentiles `BAND` of `rms`
    spread: FloatArray  # (k, n) m, rms distance of each body over the branches
    growth: Divergence | None  # growth of the median
    rates: FloatArray  # (r,) 1/s, rate λ of each branch whose distance grows exponentially
    outcomes: list[bool]  # whether each branch had the outcome
    reference_outcome: bool | None
    chances: list[Chance] = field(default_factory=list)  # probabilities of the outcome, by the time of the fork

    @property
    def rate_error(self) -> float:
        """Standard deviation of λ between branches, in 1/s; infinite if fewer than two branches have a λ."""
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

    Each coordinate of a position moves by ``ulps`` units in the last place. ``outcome`` is a condition on each branch,
    from `outcome_of`. ``watch`` receives the number of branches that are done.
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
    """Return distances in the form that `carom diff` analyses."""
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


def fork(start: ForkStart, out: Path, shift: int | None, ulps: int) -> tuple[Outcome, Diff]:
    """Run one branch to its end, perturbed as in `ForkStart.space`, and write it and the recording into one file."""
    with temporary_folder() as folder:
        part = folder / f"{out.stem}.rrd"
        outcome = simulate(start.space(None, shift, ulps), part)
        branch = Recording.open(part)
        found = diff(start.recording, branch)
        text = text_of(start, found)
        if early := ended_early(outcome):
            text = f"{text}. {early.removesuffix('.')}"
        overlay(start.recording, branch, replace(found, verdict=replace(found.verdict, text=text)), out)
    return outcome, found


def ended_early(outcome: Outcome) -> str:
    """Return why a fork stopped before its end; empty if it completed, even with a missed promise."""
    if outcome.status in ("completed", "expectation missed"):
        return ""
    return f"The fork ended early, {in_words(outcome.status)}: {outcome.reason}."


def text_of(start: ForkStart, found: Diff) -> str:
    """Describe a fork: its time, the changed keys, and the distance from the recording in the last frame."""
    changes = ", ".join(
        f"{key} = {_value(found, key, other)}, before {_value(found, key, one)}"
        for key, (one, other) in found.scene.items()
    )
    what = f" with {changes}" if changes else ""
    curve, first, units = found.curve, found.verdict.first, start.scene.unit_system
    forked = f"forked at step {start.checkpoint.step}, t = {units.text(start.checkpoint.time, TIME, '.9g')}{what}"
    last = f"t = {units.text(curve.time[-1], TIME, '.9g')}"
    if first is None:
        return f"{forked}: the same bits up to {last}"
    when, apart, resolved = units.text(curve.time[first], TIME), curve.rms[-1], curve.floor[-1]
    distance = units.text(max(apart, resolved), LENGTH, ".3g")
    return (
        f"{forked}: the first frame that differs is step {curve.step[first]}, t = {when}; at {last} counterparts are "
        f"{'' if apart > resolved else 'less than '}{distance} apart (rms), in a system of "
        f"{units.text(curve.size, LENGTH, '.3g')} at first"
    )


def _value(found: Diff, key: str, written: object) -> str:
    """Return the value of a scene's key, or its default if the scene does not set it."""
    if written is not None:
        return str(written)
    default = found.defaults.get(key)
    return "not given" if default is None else f"{default} by default"


def write_ensemble(start: ForkStart, found: Ensemble, text: str, out: Path) -> None:
    """Write an ensemble and a text in Markdown for the viewer. Raises RecordingError if the file cannot be written."""
    when = start.scene.unit_system.text(start.checkpoint.time, TIME)
    title = f"{start.recording.title}: {len(found.rms)} forks at t = {when}"
    rows = [(chance.time, chance.band[0], chance.probability, chance.band[1]) for chance in found.chances]
    chances = np.array(rows, dtype=np.float64).reshape(-1, 4)
    forecast = Forecast(title, text, found.time, found.reference, found.spread, found.band, chances)
    write_forecast(out, start.recording, forecast)
