"""How an orbit and its twin, which begins almost alike, part under Gauss–Radau integration.

The twin takes the steps of the orbit. Their polynomials differ only as much as they are apart, so the twin begins with
the coefficients that the orbit has before its last iteration. A single one costs a third of a run of its own. It misses
less than a hundredth of their difference, but very eccentric orbits then part too fast: with e = 0.999 by 10³⁰ in 13
orbits, where three iterations are right to a factor of 2.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.integrators.gauss_radau15 import LARGEST_CHANGE, PROGRESS, SHRINKING, STEP_FRACTION
from carom.physics.integrators.radau_nodes import TERMS
from carom.physics.integrators.radau_step import (
    MAX_ITERATIONS,
    Motion,
    accelerate,
    acceleration_at_start,
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
from carom.plan.auto import largest_step
from carom.scene.schema import Scene
from carom.scene.start import Start

FloatArray = NDArray[np.float64]
Records = NDArray[np.void]

FIRST_PART = 1e-3  # of the duration: the first step that is tried


class Orbits(NamedTuple):
    """Bodies without contacts, as far as they were followed."""

    times: FloatArray  # (K,) s
    path: FloatArray  # (K, n, 3) m, infinite beyond
    steps: int

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None where they were not followed."""
        position: FloatArray = self.path[sample]
        return position if np.isfinite(position).all() else None


def part(
    scene: Scene, start: Start, twin: FloatArray, refinement: float, times: FloatArray, enough: float, iterations: int
) -> tuple[Orbits, FloatArray]:
    """Follow the bodies of a scene without contacts, and their twins.

    Return them and their rms distance in m, (K,). Beyond the first distance that is large enough, both are infinite.

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
    return _follow(scene, start, refinement, times, _motion(scene, start, twin), enough, iterations)


def orbits(scene: Scene, start: Start, refinement: float, times: FloatArray) -> Orbits:
    """Follow the bodies of a scene without contacts; see `part`."""
    return _follow(scene, start, refinement, times)[0]


def _follow(
    scene: Scene,
    start: Start,
    refinement: float,
    times: FloatArray,
    twin: Motion | None = None,
    enough: float = math.inf,
    iterations: int = 0,
) -> tuple[Orbits, FloatArray]:
    path, apart = np.full((len(times), *start.position.shape), np.inf), np.full(len(times), np.inf)
    progress = np.zeros(1, PROGRESS)
    progress["next_dt"], progress["fraction"] = FIRST_PART * times[-1], STEP_FRACTION / refinement
    progress["tolerance"] = tolerance(refinement)
    motion, eps2 = _motion(scene, start, start.position), scene.gravity.softening**2
    follow(motion, twin, eps2, progress, times, largest_step(scene), enough, iterations, path, apart)
    return Orbits(times, path, int(progress["steps"][0])), apart


def _motion(scene: Scene, start: Start, position: FloatArray) -> Motion:
    pull, field = scene.gravity.constant * start.mass, np.array(scene.gravity.uniform)
    return motion_of(position.copy(), start.velocity.copy(), pull, np.flatnonzero(start.fixed), field)


@borrowing
def follow(
    motion: Motion,
    twin: Motion | None,
    eps2: float,
    progress: Records,
    times: FloatArray,
    max_dt: float,
    enough: float,
    iterations: int,
    path: FloatArray,
    apart: FloatArray,
) -> None:
    """Write the positions and distances at all times; see `part`."""
    run, k, end = progress[0], 0, times[-1]
    while k < len(times):
        dt = min(run.next_dt, max_dt)
        if end - run.time <= dt * (1.0 + END_TOLERANCE):
            dt = end - run.time
        accelerate(motion.position, motion.pull_of, motion.moves, eps2, motion.start, motion.lanes)
        if twin is not None:
            accelerate(twin.position, twin.pull_of, twin.moves, eps2, twin.start, twin.lanes)
        wanted = _attempt(motion, twin, eps2, run, dt)
        while wanted * LARGEST_CHANGE < dt:
            share = wanted / dt
            dt = wanted
            wanted = _attempt(motion, twin, eps2, run, dt)
            if not wanted > SHRINKING * share * dt:
                break
        if twin is not None:
            for _ in range(iterations):
                iterate(twin, eps2, dt)
        after = end if end - run.time <= dt else run.time + dt
        while k < len(times) and times[k] <= after:
            h = (times[k] - run.time) / dt
            _locate(motion, dt, h, path[k])
            if twin is not None:
                apart[k] = _distance(motion, twin, dt, h)
                if not apart[k] < enough:
                    return
            k += 1
        move(motion, dt)
        if twin is not None:
            move(twin, dt)
        run.steps += 1
        if not after > run.time:
            break  # the step is too short to change the clock, or NaN
        run.time, run.last_dt, run.next_dt = after, dt, min(wanted, LARGEST_CHANGE * dt)


@unowned
def _attempt(motion: Motion, twin: Motion | None, eps2: float, run: Any, dt: float) -> float:
    """Find the polynomial of a step; return the longest next one, in s. The twin gets it before the last iteration."""
    predict(motion, dt / run.last_dt if run.last_dt > 0.0 else 0.0)
    before = np.inf
    for iteration in range(MAX_ITERATIONS):
        if twin is not None:
            for c in range(len(motion.b)):
                for j in range(TERMS):
                    twin.b[c, j] = motion.b[c, j]
        error = iterate(motion, eps2, dt)
        if stops(iteration, error, before, run.tolerance):
            break
        before = error
    return next_step(motion, dt, run.fraction)


@unowned
def _locate(motion: Motion, dt: float, h: float, position: FloatArray) -> None:
    """Write the positions at a part h of the step, (n, 3) m."""
    x, v, b, t = motion.position, motion.velocity, motion.b, h * dt
    for i in range(len(x)):
        for k in range(3):
            bent = 0.0
            for j in range(TERMS - 1, -1, -1):
                bent = (bent + b[3 * i + k, j] / ((j + 2) * (j + 3))) * h
            a = acceleration_at_start(motion, i, k)
            position[i, k] = x[i, k] + (motion.position_rest[i, k] + (t * v[i, k] + t * t * (0.5 * a + bent)))


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
