"""How an orbit and its twin, which begins almost alike, part under Gauss–Radau integration.

The twin takes the steps of the orbit. Their polynomials differ only as much as they are apart, so the twin begins with
the coefficients that the orbit has before its last iteration. A single one costs a third of a run of its own. It misses
less than a hundredth of their difference, but very eccentric orbits then part too fast: with e = 0.999 by 10³⁰ in 13
orbits, where three iterations are right to a factor of 2. The twin rounds independently.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.integrators.gauss_radau15 import LARGEST_CHANGE, PROGRESS, SHRINKING, STEP_FRACTION
from carom.physics.integrators.radau_nodes import TERMS
from carom.physics.integrators.radau_step import (
    MAX_ITERATIONS,
    Motion,
    accelerate,
    iterate,
    motion_of,
    move,
    next_step,
    predict,
    stops,
)
from carom.physics.integrators.radau_tolerance import tolerance
from carom.physics.parallel.jit import borrowing, unowned
from carom.physics.step_rule import END_TOLERANCE
from carom.scene.schema import Scene
from carom.scene.start import Start

FloatArray = NDArray[np.float64]
Records = NDArray[np.void]

FIRST_PART = 1e-3  # of the duration: the first step that is tried


def part(
    scene: Scene, start: Start, twin: FloatArray, refinement: float, times: FloatArray, enough: float, iterations: int
) -> FloatArray:
    """Return the rms distance in m between the bodies of a scene without contacts and their twins, (K,).

    Beyond the first distance that is large enough, it is infinite.

    Parameters
    ----------
    start, twin
        The bodies at the start, and the positions of the twins, (n, 3) m.
    refinement
        Usual steps over those taken.
    times
        (K,) s, in order.
    enough
        m
    iterations
        Of the twin in each step.
    """
    pull, field = scene.gravity.constant * start.mass, np.array(scene.gravity.uniform)
    fixed = np.flatnonzero(start.fixed)
    one, other = (motion_of(x.copy(), start.velocity.copy(), pull, fixed, field) for x in (start.position, twin))
    progress, apart = np.zeros(1, PROGRESS), np.full(len(times), np.inf)
    progress["next_dt"], progress["fraction"] = FIRST_PART * times[-1], STEP_FRACTION / refinement
    progress["tolerance"] = tolerance(refinement)
    follow(one, other, scene.gravity.softening**2, progress, times, scene.time.max_dt, enough, iterations, apart)
    return apart


@borrowing
def follow(
    motion: Motion,
    twin: Motion,
    eps2: float,
    progress: Records,
    times: FloatArray,
    max_dt: float,
    enough: float,
    iterations: int,
    apart: FloatArray,
) -> None:
    """Write the distances at all times; see `part`."""
    run, k, end = progress[0], 0, times[-1]
    while k < len(times):
        dt = min(run.next_dt, max_dt)
        if end - run.time <= dt * (1.0 + END_TOLERANCE):
            dt = end - run.time
        accelerate(motion.position, motion.pull_of, motion.moves, eps2, motion.start, motion.lanes)
        accelerate(twin.position, twin.pull_of, twin.moves, eps2, twin.start, twin.lanes)
        wanted = _attempt(motion, twin, eps2, run, dt)
        while wanted * LARGEST_CHANGE < dt:
            share = wanted / dt
            dt = wanted
            wanted = _attempt(motion, twin, eps2, run, dt)
            if not wanted > SHRINKING * share * dt:
                break
        for _ in range(iterations):
            iterate(twin, eps2, dt)
        after = end if end - run.time <= dt else run.time + dt
        while k < len(times) and times[k] <= after:
            apart[k] = _distance(motion, twin, dt, (times[k] - run.time) / dt)
            if not apart[k] < enough:
                return
            k += 1
        move(motion, dt)
        move(twin, dt)
        if not after > run.time:
            break  # the step is too short to change the clock, or NaN
        run.time, run.last_dt, run.next_dt = after, dt, min(wanted, LARGEST_CHANGE * dt)


@unowned
def _attempt(motion: Motion, twin: Motion, eps2: float, run: Any, dt: float) -> float:
    """Find the polynomial of a step; return the longest next one, in s. The twin gets it before the last iteration."""
    predict(motion, dt / run.last_dt if run.last_dt > 0.0 else 0.0)
    before = np.inf
    for iteration in range(MAX_ITERATIONS):
        for c in range(len(motion.b)):
            for j in range(TERMS):
                twin.b[c, j] = motion.b[c, j]
        error = iterate(motion, eps2, dt)
        if stops(iteration, error, before, run.tolerance):
            break
        before = error
    return next_step(motion, dt, run.fraction)


@unowned
def _distance(motion: Motion, twin: Motion, dt: float, h: float) -> float:
    """Return the rms distance in m at a part h of the step."""
    n, square, t = len(motion.position), 0.0, h * dt
    for i in range(n):
        for k in range(3):
            c = 3 * i + k
            bent = 0.0
            for j in range(TERMS - 1, -1, -1):
                bent = (bent + (twin.b[c, j] - motion.b[c, j]) / ((j + 2) * (j + 3))) * h
            away = (twin.position[i, k] - motion.position[i, k]) + (
                twin.position_rest[i, k] - motion.position_rest[i, k]
            )
            away += t * (twin.velocity[i, k] - motion.velocity[i, k])
            away += t * t * (0.5 * (twin.start[i, k] - motion.start[i, k]) + bent)
            square += away * away
    return float(np.sqrt(square / n))
