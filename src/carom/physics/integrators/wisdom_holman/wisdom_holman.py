"""Wisdom–Holman integration of bodies about a dominant body; Gauss–Radau integration takes over close encounters.

In Jacobi coordinates, the position of each body is relative to the centre of mass of all bodies before it, in the order
of their semi-major axes. With M_i = m_0 + … + m_i and m'_i = m_i M_{i-1}/M_i, the Hamiltonian is a sum of two parts,
each of which can be solved exactly (Wisdom & Holman 1991):

    H_Kepler = Σ_{i≥1} (p'_i² / 2m'_i - G m'_i M_i / |x'_i|) + the free motion of the centre of mass
    H_mutual = Σ_{i≥2} G m'_i M_i / |x'_i| - Σ_{i<j, j≥2} G m_i m_j / |x_i - x_j|

A step of length h drifts along Kepler orbits for h/2 (`kepler`), kicks by H_mutual for h, and drifts for h/2 again.
The half drifts of successive steps are joined. For masses ε relative to the dominant body, a step conserves

    H + ε h²/24 … + O(ε² h²)

A corrector undoes the terms in ε (`orbit_steps`); errors in ε² h² remain.

The step is the shortest period divided by `STEPS_PER_ORBIT`, or by `STEPS_OF_HEAVY` for bodies above `HEAVY`. Here, the
period of an orbit is the period of a circular motion with the angular speed at the pericentre (Wisdom 2015). When two
bodies pass within `HILL_RADII` Hill radii of each other, or a body comes so close to the dominant body that the step no
longer resolves its motion, the state before this step is passed to `GaussRadau15`, which integrates all bodies until
they are far apart again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.physics.bodies import Bodies
from carom.physics.integrators.batch_integrator import Batch
from carom.physics.integrators.gauss_radau.gauss_radau15 import GaussRadau15
from carom.physics.integrators.gauss_radau.radau_step import motion_of
from carom.physics.integrators.wisdom_holman.kepler import TWO_PI, WORKSPACE
from carom.physics.integrators.wisdom_holman.orbit_steps import RUN, OrbitArrays, advance, begin, leap, meets_soon
from carom.plan.auto import largest_step
from carom.plan.features import Requirements
from carom.scene.load import Scene
from carom.scene.portable_math import cube_root
from carom.state.checkpoint import EqualSteps, IntegratorCheckpoint, OrbitCheckpoint

HILL_RADII = 12.0  # distance, in Hill radii, within which bodies on crossing orbits are close (docs/validation.md)
FEWEST_HILL_RADII = 3.0  # distance of two orbits, in Hill radii, beyond which their bodies never come close
GAP_FRACTION = 0.9  # fraction of the distance between two orbits; bodies that are nearer have left their orbits
NEAREST = 0.03  # smallest pericentre over the semi-major axis; closer passages are left to Gauss–Radau integration
STEPS_PER_ORBIT = 20.0  # steps per period of the shortest orbit
# Steps per period for bodies above `HEAVY`: the error of their encounters grows as the square of the mass and of the
# step.
STEPS_OF_HEAVY = 50.0
HEAVY = 2e-5  # mass relative to the dominant body
FIRST_FRACTION = 0.01  # the first step that Gauss–Radau integration tries, as a fraction of the last step
ANEW, FAR, CLOSE = range(3)  # phases: start from the present state, steps of equal length, and Gauss–Radau integration
LIMITS = ("orbit", "cap", "fixed")  # limits that shorten a step


class Conics(NamedTuple):
    """Orbits about the dominant body, (n,) each."""

    axis: FloatArray  # m, semi-major axis; infinite if unbound
    size: FloatArray  # m, modulus of the semi-major axis, which is negative for an unbound orbit
    pericentre: FloatArray  # m
    apocentre: FloatArray  # m
    period: FloatArray  # s, period of a circular motion with the angular speed at the pericentre


def conics(position: FloatArray, velocity: FloatArray, gm: FloatArray, first: int) -> Conics:
    """Return the present orbits about the dominant body, ``first``, whose own axis is set to -1."""
    x, y, z = (position - position[first]).T
    u, v, w = (velocity - velocity[first]).T
    mu = gm + gm[first]
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = 2.0 * mu / np.sqrt(x * x + y * y + z * z) - (u * u + v * v + w * w)
        size = mu / np.abs(beta)
        spin = (y * w - z * v, z * u - x * w, x * v - y * u)
        parameter = (spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]) / mu
        e = np.sqrt(np.maximum(1.0 - beta * parameter / mu, 0.0))
        pericentre = parameter / (1.0 + e)
        resolved = np.maximum(pericentre, NEAREST * size)
        period = TWO_PI * np.sqrt(resolved * resolved * resolved / (mu * (1.0 + e)))
        axis = np.where(beta > 0.0, size, np.inf)
        apocentre = np.where(beta > 0.0, size * (1.0 + e), np.inf)
    axis[first] = -1.0
    return Conics(axis, size, pericentre, apocentre, period)


def near(conics: Conics, hill_ratio: FloatArray, first: int) -> FloatArray:
    """Return for each body the distance (m) below which others are close, given Hill radii over semi-major axes."""
    hill = hill_ratio * np.minimum(conics.size, np.where(conics.axis < np.inf, np.inf, conics.pericentre))
    close = HILL_RADII * hill
    close[first] = 0.0
    for i in range(len(close)):
        if i == first:
            continue
        gap = np.maximum(conics.pericentre - conics.apocentre[i], conics.pericentre[i] - conics.apocentre)
        gap[[i, first]] = np.inf
        if gap.min() > FEWEST_HILL_RADII * hill[i]:
            close[i] = min(close[i], max(FEWEST_HILL_RADII * hill[i], GAP_FRACTION * gap.min()))
    return close


class WisdomHolman:
    """Integrates bodies that orbit a dominant body, many steps per call, in place.

    Without a ``fixed_dt``, steps are a fraction of the shortest period, divided by ``refinement``. With ``resolves``,
    close encounters of light bodies are left to Gauss–Radau integration. ``gm`` is G m of each body, (n,) m³/s².
    """

    def __init__(
        self,
        position: FloatArray,
        velocity: FloatArray,
        gm: FloatArray,
        max_dt: float,
        fixed_dt: float | None,
        resolves: bool = True,
        refinement: float = 1.0,
    ) -> None:
        n = len(position)
        self._orbits = OrbitArrays(
            position=position,
            velocity=velocity,
            order=np.zeros(n, np.int64),
            mu=np.zeros(n),
            gm=np.zeros(n),
            mass_fraction=np.zeros(n),
            near=np.zeros(n),
            x=np.zeros((n, 3)),
            v=np.zeros((n, 3)),
            x_spare=np.zeros((n, 3)),
            v_spare=np.zeros((n, 3)),
            place=np.zeros((n, 3)),
            speed=np.zeros((n, 3)),
            acceleration=np.zeros((n, 3)),
            max_displacement=np.zeros(n),
            lanes=np.zeros(WORKSPACE),
        )
        self._gm = gm
        self._first = int(np.argmax(gm))
        self._hill = cube_root(gm / (3.0 * gm[self._first]))  # Hill radii divided by semi-major axes
        self._max_dt, self._fixed_dt = max_dt, fixed_dt
        self._limit, self._resolves, self._refinement = LIMITS[0], resolves, refinement
        self._run = np.zeros(1, RUN)
        no_field, none_fixed = np.zeros(3), np.zeros(0, np.int64)
        self._radau = GaussRadau15(motion_of(position, velocity, gm, none_fixed, no_field, 0.0), max_dt, None)
        self._phase = ANEW
        self._by_radau = False  # whether Gauss–Radau integration took the last step
        self.encounters = 0  # number of times that Gauss–Radau integration took over

    @property
    def next_dt(self) -> float:
        """The length of the next step in seconds."""
        return self._radau.next_dt if self._phase == CLOSE else float(self._run["dt"][0])

    def begin(self, dt: float) -> None:
        """Start anew at the present positions and velocities, which determine the first step."""
        self._phase = ANEW
        self._run["dt"] = dt

    def advance(self, time: float, end: float, until: float, steps: int) -> Batch:
        """Take steps until a time, the end of the run, or a number of steps is reached; see `BatchIntegrator`."""
        taken, before, dt, limit = 0, time, 0.0, ""
        while taken < steps and time < end and (time < until or taken == 0):
            if self._phase == ANEW:
                self._start(time)
            if self._phase == CLOSE:
                did, before, time, dt, limit, _ = self._radau.advance(time, end, until, 1)
                taken += did
                self._by_radau = True
                if not time > before:
                    break
                if time < end and not meets_soon(self._orbits, float(self._run["dt"][0])):
                    self._phase = ANEW
                continue
            run = self._run[0]
            run["steps"], run["time"] = 0, time
            advance(self._orbits, self._run, end, until, steps - taken)
            if run["steps"]:
                taken += int(run["steps"])
                before, time, dt, limit = float(run["before"]), float(run["time"]), float(run["dt"]), self._limit
                self._by_radau = False
                if not time > before:
                    break
            elif run["close"]:
                self._meet()
            else:
                orbits = self._orbits
                if leap(orbits, end - time, orbits.position, orbits.velocity, False):
                    taken, before, time, dt, limit = taken + 1, time, end, end - time, "end"
                    self._phase, self._by_radau = ANEW, False
                else:
                    self._meet()
        return Batch(taken, before, time, dt, limit)

    def at(self, earlier: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the last step."""
        if self._by_radau:
            return self._radau.at(earlier)
        position, velocity = np.empty_like(self._orbits.x), np.empty_like(self._orbits.v)
        leap(self._orbits, -earlier, position, velocity, True)
        return position, velocity

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the state that the next step needs."""
        orbits, run, radau = self._orbits, self._run[0], self._radau.checkpoint
        series = EqualSteps(self._phase, run["start"], run["count"], run["dt"], LIMITS.index(self._limit))
        copies = (orbits.order.astype(np.float64), orbits.near.copy(), orbits.x.copy(), orbits.v.copy())
        own = OrbitCheckpoint(np.array(series), *copies)
        if self._phase == CLOSE:
            return replace(radau, orbits=own)
        nothing, no_rows = np.empty((0, 3)), np.empty((0, 8))
        return IntegratorCheckpoint(0.0, nothing, nothing, no_rows, no_rows, own)

    def restore(self, checkpoint: IntegratorCheckpoint | None, next_dt: float) -> None:
        """Continue from a checkpoint with a step of ``next_dt`` s; without a checkpoint, start anew."""
        self.begin(next_dt)
        if checkpoint is None or checkpoint.orbits is None:
            return
        own, orbits, run = checkpoint.orbits, self._orbits, self._run[0]
        series = EqualSteps(*own.series.tolist())
        run["start"], run["count"], run["dt"] = series.start, series.steps, series.dt
        self._phase, self._limit = int(series.phase), LIMITS[int(series.limit)]
        self._set_order(own.order.astype(np.int64), own.near)
        orbits.x[:], orbits.v[:] = own.position, own.velocity
        if self._phase == CLOSE:
            self._radau.restore(checkpoint, next_dt)

    def _meet(self) -> None:
        """Let Gauss–Radau integration continue."""
        self._phase = CLOSE
        self.encounters += 1
        self._radau.begin(FIRST_FRACTION * float(self._run["dt"][0]))

    def _start(self, time: float) -> None:
        """Order the bodies, choose the step and start from the present state."""
        orbits, first = self._orbits, self._first
        orbits_now = conics(orbits.position, orbits.velocity, self._gm, first)
        order = np.argsort(orbits_now.axis, kind="stable")
        steps = np.where(self._gm > HEAVY * self._gm[self._first], STEPS_OF_HEAVY, STEPS_PER_ORBIT)
        dt, self._limit = float((orbits_now.period / steps)[order[1:]].min()), "orbit"
        dt /= self._refinement
        if self._fixed_dt is not None:
            dt, self._limit = self._fixed_dt, "fixed"
        elif dt >= self._max_dt:
            dt, self._limit = self._max_dt, "cap"
        self._run[0] = np.zeros(1, RUN)[0]
        self._run["start"], self._run["dt"] = time, dt
        close = near(orbits_now, self._hill, first) if self._resolves else np.zeros(len(order))
        self._set_order(order, close[order])
        begin(orbits, dt)
        self._phase = FAR

    def _set_order(self, order: IntArray, close: FloatArray) -> None:
        """Set the arrays that depend on the order of the bodies; `OrbitArrays.near`, (n,) m, has that order."""
        orbits = self._orbits
        orbits.order[:] = order
        orbits.gm[:] = self._gm[order]
        orbits.mu[:] = np.cumsum(orbits.gm)
        orbits.mass_fraction[:] = orbits.gm / orbits.mu
        orbits.near[:] = close


def make(scene: Scene, needs: Requirements, bodies: Bodies, uniform: FloatArray) -> WisdomHolman:
    """Return the integrator of a scene's bodies; scenes with a uniform field have been refused."""
    gm, rule = scene.gravity.constant * bodies.mass, scene.time
    steps, resolves = (largest_step(scene), rule.fixed_dt), rule.encounters == "resolve"
    return WisdomHolman(bodies.position, bodies.velocity, gm, *steps, resolves, scene.refinement)
