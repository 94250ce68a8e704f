"""Divergence of two nearby orbits under Gauss–Radau integration.

The twin takes the same steps as the orbit. The polynomials differ as little as the orbits do, so the twin starts its
iterations from the coefficients that the orbit had before its last iteration. With a single iteration, the twin costs a
third of a separate run. The distance between twin and orbit is then accurate to a hundredth, but very eccentric orbits
diverge too fast: with e = 0.999, by a factor of 10³⁰ in 13 orbits. A twin that iterates until it converges costs as
much as a separate run. It has rounding errors of its own, so the distance then measures the error by rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.forces.kernel_forces import parameters_of_all
from carom.physics.integrators.gauss_radau.gauss_radau15 import STEP_FRACTION
from carom.physics.integrators.gauss_radau.radau_step import (
    LARGEST_CHANGE,
    MAX_ITERATIONS,
    PROGRESS,
    TERMS,
    Motion,
    ProgressRecord,
    accelerate,
    acceleration_at_start,
    attempt,
    iterate,
    motion_of,
    move,
    stops,
    tolerance,
)
from carom.physics.jit.decorators import inner, long_kernel
from carom.physics.step_rule import END_TOLERANCE
from carom.plan.auto import largest_step
from carom.scene.load import Scene
from carom.scene.start import InitialBodies

FIRST_FRACTION = 1e-3  # first trial step, as a fraction of the duration
# largest numbers of steps, and of pairs times steps, in a call: 1 ms for two bodies, 5 ms for 100
MOST_AT_ONCE, PAIRS_AT_ONCE = 500, 200_000
CONVERGES = MAX_ITERATIONS  # value of ``iterations`` for a twin that iterates until it converges

GoesOn = Callable[[int, float], bool]


def always(iterations: int, time: float) -> bool:
    """Let the integrations go on; see `diverge`."""
    return True


class TwinSamples(NamedTuple):
    """Times at which orbits are compared with their twins, and the results."""

    times: FloatArray  # (K,) s
    path: FloatArray  # (K, n, 3) m, output positions
    apart: FloatArray  # (K,) m, output rms distance between orbits and twins


class TwinRule(NamedTuple):
    """Conditions under which the comparison of orbits with their twins ends; see `diverge`."""

    max_dt: float  # s
    enough: float  # m, distance from the orbit at which the comparison with a twin ends
    iterations: int


class FollowedOrbits(NamedTuple):
    """The orbits of bodies without contacts, up to the time at which the comparison ended."""

    times: FloatArray  # (K,) s
    path: FloatArray  # (K, n, 3) m, positions; infinite where not known
    steps: int
    known: int  # number of times up to which positions are known

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None if they are not known."""
        position: FloatArray = self.path[sample]
        return position if np.isfinite(position).all() else None


def diverge(
    scene: Scene,
    start: InitialBodies,
    twin: FloatArray,
    refinement: float,
    times: FloatArray,
    enough: float,
    iterations: int,
    goes_on: GoesOn = always,
) -> tuple[FollowedOrbits, FloatArray]:
    """Integrate the bodies of a scene without contacts, and their twins; return the orbits, and the twins' distances.

    The rms distances, (K,) m, are given at ascending times (s). After the first distance of at least ``enough`` (m),
    both results are infinite.

    Parameters
    ----------
    twin
        The initial positions of the twins, (n, 3) m.
    refinement
        Ratio of the usual step to the step taken.
    iterations
        Number of the twin's iterations in each step; `CONVERGES` for as many as it needs.
    goes_on
        Called after every `MOST_AT_ONCE` steps, or fewer for many bodies, with the iterations since the last call and
        the time in s; if it returns False, both integrations end.
    """
    return _follow(scene, start, refinement, times, goes_on, _motion(scene, start, twin), enough, iterations)


def orbits(
    scene: Scene, start: InitialBodies, refinement: float, times: FloatArray, goes_on: GoesOn = always
) -> FollowedOrbits:
    """Integrate the bodies of a scene without contacts; see `diverge`."""
    return _follow(scene, start, refinement, times, goes_on)[0]


def _follow(
    scene: Scene,
    start: InitialBodies,
    refinement: float,
    times: FloatArray,
    goes_on: GoesOn,
    twin: Motion | None = None,
    enough: float = math.inf,
    iterations: int = 0,
) -> tuple[FollowedOrbits, FloatArray]:
    path, apart = np.full((len(times), *start.position.shape), np.inf), np.full(len(times), np.inf)
    progress = np.zeros(1, PROGRESS)
    progress["next_dt"], progress["fraction"] = FIRST_FRACTION * times[-1], STEP_FRACTION / refinement
    progress["tolerance"] = tolerance(refinement)
    motion, samples = _motion(scene, start, start.position), TwinSamples(times, path, apart)
    rule = TwinRule(largest_step(scene), enough, iterations)
    k, steps, counted, known = 0, 0, 0, len(times)
    at_once = max(1, min(MOST_AT_ONCE, PAIRS_AT_ONCE // scene.count**2))
    while k < len(times):
        steps += at_once
        k = follow(motion, twin, progress, samples, rule, k, steps)
        fresh, counted = int(progress["iterations"][0]) - counted, int(progress["iterations"][0])
        lasts = goes_on(fresh, float(progress["time"][0]))
        if int(progress["steps"][0]) < steps:
            break  # the end is reached, the twins are far enough apart, or the step is too short to change the clock
        if not lasts:
            known = k
            break
    return FollowedOrbits(times, path, int(progress["steps"][0]), known), apart


def _motion(scene: Scene, start: InitialBodies, position: FloatArray) -> Motion:
    gravity = scene.gravity
    return motion_of(
        position.copy(),
        start.velocity.copy(),
        gravity.constant * start.mass,
        np.flatnonzero(start.fixed),
        np.array(gravity.uniform),
        gravity.softening,
        start.mass,
        parameters_of_all(scene),
    )


@long_kernel
def follow(
    motion: Motion,
    twin: Motion | None,
    progress: RecordArray[ProgressRecord],
    samples: TwinSamples,
    rule: TwinRule,
    k: int,
    most: int,
) -> int:
    """Write positions and distances from time ``k`` on, up to step ``most`` of the run; return the next index."""
    times, path, apart = samples
    run, end, iterations = progress[0], times[-1], rule.iterations
    while k < len(times) and run.steps < most:
        dt = min(run.next_dt, rule.max_dt)
        if end - run.time <= dt * (1.0 + END_TOLERANCE):
            dt = end - run.time
        accelerate(motion, motion.position, motion.start)
        if twin is not None:
            accelerate(twin, twin.position, twin.start)
        dt, wanted = attempt(motion, twin, run, dt, LARGEST_CHANGE)
        if twin is not None:
            before = np.inf
            for iteration in range(iterations):
                error = iterate(twin, dt)
                run.iterations += 1
                if iterations == CONVERGES and stops(iteration, error, before, run.tolerance):
                    break
                before = error
        after = end if end - run.time <= dt else run.time + dt
        while k < len(times) and times[k] <= after:
            h = (times[k] - run.time) / dt
            _locate(motion, dt, h, path[k])
            if twin is not None:
                apart[k] = _distance(motion, twin, dt, h)
                if not apart[k] < rule.enough:
                    return k + 1
            k += 1
        move(motion, dt)
        if twin is not None:
            move(twin, dt)
        run.steps += 1
        if not after > run.time:
            break  # the step is NaN or too short to change the clock
        run.time, run.last_dt, run.next_dt = after, dt, min(wanted, LARGEST_CHANGE * dt)
    return k


@inner
def _locate(motion: Motion, dt: float, h: float, position: FloatArray) -> None:
    """Write the positions at a fraction h of the step, (n, 3) m."""
    x, v, b, t = motion.position, motion.velocity, motion.b, h * dt
    for i in range(len(x)):
        for k in range(3):
            bent = 0.0
            for j in range(TERMS - 1, -1, -1):
                bent = (bent + b[3 * i + k, j] / ((j + 2) * (j + 3))) * h
            a = acceleration_at_start(motion, i, k)
            position[i, k] = x[i, k] + (motion.position_compensation[i, k] + (t * v[i, k] + t * t * (0.5 * a + bent)))


@inner
def _distance(motion: Motion, twin: Motion, dt: float, h: float) -> float:
    """Return the rms distance in m between the orbits and their twins at a fraction h of the step."""
    n, square, t = len(motion.position), 0.0, h * dt
    for i in range(n):
        for k in range(3):
            c = 3 * i + k
            bent = 0.0
            for j in range(TERMS - 1, -1, -1):
                bent = (bent + (twin.b[c, j] - motion.b[c, j]) / ((j + 2) * (j + 3))) * h
            away = (twin.position[i, k] - motion.position[i, k]) + (
                twin.position_compensation[i, k] - motion.position_compensation[i, k]
            )
            away += t * (twin.velocity[i, k] - motion.velocity[i, k])
            away += t * t * (0.5 * (twin.start[i, k] - motion.start[i, k]) + bent)
            square += away * away
    return float(np.sqrt(square / n))
