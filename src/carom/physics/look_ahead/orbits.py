"""The longest step of Wisdom–Holman integration that keeps an accuracy, from trial runs of the orbits.

The error is of second order in the step. If D(t) is the distance between runs with refinements r and s, the error with
refinement q is

    e(t) = D(t) / q² / (1/r² - 1/s²)

The two runs are also each other's twins: D shows the growth of errors, and rounding is far below these accuracies. The
runs are sampled only a few times, because each sample takes a corrector and its inverse.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.physics.look_ahead.trial_run import ITERATIONS, ORBIT_BODY, ORBIT_STEP, WorkBudget, radau_work
from carom.plan.auto import largest_step
from carom.scene.load import Scene
from carom.scene.start import InitialBodies

ROUGH = 1e-3  # smallest accuracy for coarse steps; refinements of at least 0.63 resolve the innermost orbit
COMPARED_ROUGHLY = (0.7, 0.85)  # refinements; between these and 1, the error falls faster than its second order says
COMPARED = (1.0, 1.2)
# Factor for the extrapolated error. In individual systems, the error is up to 9 times a second-order term, because it
# has terms of higher order with either sign.
UNEVEN = 4.0
CHEAP = (0.7, 1.0, 2.0)  # refinements that cost less than gauss-radau15
STEPS_AT_ONCE = 1000  # steps between two checks of the budget
SHARE = 1.0 / 3.0  # fraction of the budget for each trial run; the remainder is for gauss-radau15
FINER = (4.0, 8.0, 16.0, 32.0)  # refinements that are also tried if no other integrator is possible


class OrbitStep(NamedTuple):
    """A step that keeps an accuracy, or the finest step tried."""

    refinement: float
    error: FloatArray  # (K,) m, largest rms error of the bodies so far
    exponent: float  # 1/s, growth rate of the error since the first time
    keeps: bool  # whether the error is within the requested error


def look_at_orbits(
    scene: Scene,
    start: InitialBodies,
    times: FloatArray,
    accuracy: float,
    most: float,
    persists: bool,
    budget: WorkBudget,
) -> OrbitStep:
    """Find the longest step that keeps an error of ``most`` m at the times (s), (K,).

    With ``persists``, steps that cost more than gauss-radau15 are also tried.
    """
    r, s = COMPARED_ROUGHLY if accuracy >= ROUGH else COMPARED
    d = _follow(scene, start, r, times, budget) - _follow(scene, start, s, times, budget)
    apart = np.sqrt(np.mean(np.sum(d * d, axis=2), axis=1))
    # distances are infinite where a run has failed
    apart = np.maximum.accumulate(np.where(np.isnan(apart), math.inf, apart))
    usual = UNEVEN * apart / (1.0 / r**2 - 1.0 / s**2)
    tried = (*CHEAP, *FINER) if persists else CHEAP
    found = next((q for q in tried if q >= r and usual[-1] / q**2 <= most), None)
    q = tried[-1] if found is None else found
    grown = usual[-1] / usual[0] if 0.0 < usual[0] < usual[-1] < math.inf else 1.0
    exponent = math.log(grown) / float(times[-1] - times[0])
    return OrbitStep(q, usual / q**2, exponent, keeps=found is not None)


def _follow(scene: Scene, start: InitialBodies, refinement: float, times: FloatArray, budget: WorkBudget) -> FloatArray:
    """Return the positions at all times, (K, n, 3) m; NaN from the end of the budget on."""
    from carom.physics.integrators.wisdom_holman.wisdom_holman import WisdomHolman  # noqa: PLC0415 - a part that can be removed

    rule, gm, n = scene.time, scene.gravity.constant * start.mass, scene.count
    state, resolves = (start.position.copy(), start.velocity.copy()), rule.encounters == "resolve"
    runner = WisdomHolman(*state, gm, largest_step(scene), None, resolves, refinement)
    runner.begin(0.0)
    each, met = ORBIT_STEP + ORBIT_BODY * n, ITERATIONS * radau_work(n)  # nominal s per step, and in an encounter
    now, work, found = 0.0, 0.0, np.full((len(times), *start.position.shape), np.nan)
    for k, time in enumerate(times.tolist()):
        while now < time:
            if work > SHARE * budget.total:
                budget.cover(float(times[k - 1]) if k else 0.0)
                return found
            batch = runner.advance(now, float(times[-1]), time, STEPS_AT_ONCE)
            if not batch.time > now:
                return found
            now, fresh = batch.time, batch.steps * (met if runner.encounters else each)
            work += fresh
            budget.own = work * budget.duration / now
            budget.spend(fresh, now)
        found[k] = runner.at(now - time)[0] if now > time else state[0]
    return found
