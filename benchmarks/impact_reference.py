"""Independent solutions for spheres that fly and bounce, as references for runs; nothing of carom's physics is used.

Where bodies do not attract each other, flights are parabolas and times of impact the roots of quadratics, in extended
precision. Where they do, REBOUND's IAS15 takes the steps. A polynomial of degree five between the ends of each step
serves to find the first pair that touches. The time of touching is then refined with IAS15 itself, from the beginning
of the step. An impact follows Newton's restitution and Coulomb's friction at the one contact point.

A solution ends where bounces become too short, because resting contacts are not impacts.
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rebound
from numpy.typing import NDArray

from carom.physics.space import Space
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.start import half_spaces

FloatArray = NDArray[Any]

SHORTEST = 1e-9  # of the duration: shortest flight between two bounces of a pair, which otherwise is at rest
WITHIN = np.linspace(0.0, 1.0, 33)  # fractions of a step at which distances are examined
TOUCHING = 1e-12  # of the sum of radii
IMAGES = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)  # of a periodic box
NEWTON = 6  # largest number of refinements of a time of touching
FIRST_STEP = 1e-3  # of the duration, after an impact; IAS15 repeats it if it is too long


@dataclass
class Solution:
    """Positions at the given times up to its end, (K, n, 3) m, and the reason why it ended."""

    position: FloatArray
    ended: str = ""
    impacts: list[float] = field(default_factory=list)  # s


class Spheres:
    """The spheres of a scene at its start, and the half-spaces that they bounce on; column n + p is half-space p."""

    def __init__(self, scene: Scene, precision: type[Any]) -> None:
        state, planes = Space(scene, 1).state, half_spaces(scene)
        self.n, self.p = len(state), len(planes)
        self.x, self.v = state.position.astype(precision), state.velocity.astype(precision)
        spins = len(state.angular_velocity) == self.n
        self.spin = (state.angular_velocity if spins else np.zeros((self.n, 3))).astype(precision)
        self.radius = state.radius.astype(precision)
        self.mass, self.inertia = state.mass.astype(precision), state.inertia.astype(precision)
        self.normal, self.offset = planes.normal.astype(precision), planes.offset.astype(precision)
        self.coefficients = pair_coefficients(scene)
        self.touches = scene.contact.enabled
        periodic = scene.domain.boundary == "periodic"
        self.box = np.array(scene.domain.size, dtype=precision) if periodic else None

    def strike(self, i: int, j: int) -> None:
        """Resolve the impact of body i on body or plane j: change velocities and spins."""
        law = self.coefficients.of(i, j)
        if j < self.n:
            away = self.x[j] - self.x[i]
            if self.box is not None:
                away -= self.box * np.round(away / self.box)
            distance = np.sqrt(away @ away)
            n, other, spin = away / distance, self.v[j], self.spin[j]
            to_i = distance * self.radius[i] / (self.radius[i] + self.radius[j])
            to_j, mass, inertia = distance - to_i, 1 / self.mass[j], 1 / self.inertia[j]
        else:
            n, to_i, to_j = -self.normal[j - self.n], self.radius[i], self.radius[i] * 0
            other, spin, mass, inertia = np.zeros(3), np.zeros(3), 0.0, 0.0
        relative = other - self.v[i]
        closing = relative @ n
        lightness = 1 / self.mass[i] + mass
        normal = -(1 + law.restitution) * closing / lightness
        slip = relative - closing * n - np.cross(to_i * self.spin[i] + to_j * spin, n)
        size = np.sqrt(slip @ slip)
        push = normal * n
        if size > 0.0:
            stopping = size / (lightness + to_i * to_i / self.inertia[i] + to_j * to_j * inertia)
            sticks = stopping <= law.static_friction * normal
            push = push - (stopping if sticks else law.kinetic_friction * normal) * slip / size
        self.v[i] -= push / self.mass[i]
        self.spin[i] -= to_i * np.cross(n, push) / self.inertia[i]
        if j < self.n:
            self.v[j] += push * mass
            self.spin[j] -= to_j * np.cross(n, push) * inertia


def solve(scene: Scene, times: FloatArray, budget: float) -> Solution:
    """Solve a scene from its start, at times in s; ``budget`` limits the seconds of computing.

    Raises
    ------
    ValueError
        If its bodies are fixed, damped, or attract each other in a uniform field or a periodic box.
    """
    pulled, bent = scene.gravity.constant > 0.0 and scene.gravity.method != "none", any(scene.gravity.uniform)
    periodic = scene.domain.boundary == "periodic"
    if scene.drag or any(body.fixed for body in scene.body) or (pulled and (bent or periodic)):
        raise ValueError(f"no independent solution of {scene.title}")
    return (_Pulled if pulled else _Free)(scene, times, budget).solve()


class _Solver:
    precision: type[Any] = np.float64

    def __init__(self, scene: Scene, times: FloatArray, budget: float) -> None:
        self.scene, self.times, self.deadline = scene, times, clock.process_time() + budget
        self.shortest = SHORTEST * scene.time.duration
        self.spheres = Spheres(scene, self.precision)
        self.samples: list[FloatArray] = []
        self.impacts: list[float] = []
        self.last: dict[tuple[int, int], float] = {}

    def solve(self) -> Solution:
        ended = self.go()
        shape = (len(self.samples), self.spheres.n, 3)
        return Solution(np.array(self.samples, dtype=float).reshape(shape), ended, self.impacts)

    def go(self) -> str:
        """Advance to the last time; return the reason if it ended before, otherwise nothing."""
        raise NotImplementedError

    def strike(self, time: float, i: int, j: int) -> bool:
        """Resolve an impact; return whether it followed the pair's last one so soon that the pair counts as resting."""
        soon = time - self.last.get((i, j), -np.inf) < self.shortest
        self.last[i, j] = time
        self.impacts.append(float(time))
        self.spheres.strike(i, j)
        return soon

    @property
    def is_late(self) -> bool:
        return clock.process_time() > self.deadline


class _Free(_Solver):
    """Spheres that do not attract each other: each moves on a parabola from its last impact on."""

    precision = np.longdouble

    def go(self) -> str:
        s = self.spheres
        self.field = np.array(self.scene.gravity.uniform, dtype=self.precision)
        self.time = self.precision(0.0)
        self.images = IMAGES if s.box is not None else IMAGES[13:14]
        due = np.full((s.n, s.n + s.p), np.inf, dtype=self.precision)
        if s.touches:
            for i in range(s.n):
                self.foresee(due, i)
        while True:
            flat = int(np.argmin(due))
            i, j = divmod(flat, s.n + s.p)
            upto = due[i, j]
            while len(self.samples) < len(self.times) and self.times[len(self.samples)] <= upto:
                self.move(self.precision(self.times[len(self.samples)]))
                self.samples.append(s.x.copy())
            if len(self.samples) == len(self.times):
                return ""
            if self.is_late:
                return "budget"
            self.move(upto)
            if self.strike(float(upto), i, j):
                return "rest"
            for body in (i, j) if j < s.n else (i,):
                self.foresee(due, body)

    def move(self, time: Any) -> None:
        s, dt = self.spheres, time - self.time
        s.x += dt * s.v + self.field * (dt * dt / 2)
        s.v += dt * self.field
        self.time = time

    def foresee(self, due: FloatArray, i: int) -> None:
        """Write the times at which body i meets each other body and plane."""
        s = self.spheres
        nearest, w, R = s.x - s.x[i], s.v - s.v[i], s.radius + s.radius[i]
        if s.box is not None:
            nearest -= s.box * np.round(nearest / s.box)
        a = (w * w).sum(1)
        after = np.full(s.n, np.inf, dtype=self.precision)
        for image in self.images:
            d = nearest if s.box is None else nearest + image * s.box
            b, c = (d * w).sum(1), (d * d).sum(1) - R * R
            root = b * b - a * c
            meets = np.flatnonzero((b < 0) & (root >= 0))
            sooner = np.maximum(c[meets] / (np.sqrt(root[meets]) - b[meets]), 0)
            after[meets] = np.minimum(after[meets], sooner)
        met = self.time + after
        due[i, : s.n] = np.where(np.arange(s.n) > i, met, np.inf)
        due[:i, i] = met[:i]
        if s.p:
            height, speed, pull = s.normal @ s.x[i] - s.offset - s.radius[i], s.normal @ s.v[i], s.normal @ self.field
            due[i, s.n :] = [self.time + _fall(h, u, g) for h, u, g in zip(height, speed, pull, strict=True)]


def _fall(height: Any, speed: Any, pull: Any) -> Any:
    """Return the first time in s at which height + speed t + pull t²/2 is 0 and falls."""
    root = speed * speed - 2 * pull * height
    if root < 0 or (pull >= 0 and speed >= 0):
        return np.inf
    if speed < 0:
        return max(2 * height / (np.sqrt(root) - speed), height * 0)
    return (speed + np.sqrt(root)) / -pull


class _Pulled(_Solver):
    """Spheres that attract each other, integrated by IAS15."""

    def go(self) -> str:
        s = self.spheres
        simulation, self.time = self.begin(0.0), 0.0
        ups, downs = np.triu_indices(s.n, 1)
        end = float(self.times[-1])
        while True:
            before, (x, v) = simulation.copy(), self.state(simulation)
            simulation.steps(1)
            after, (y, w) = simulation.t, self.state(simulation)
            found = self.first_touch(after - self.time, (x, v), (y, w), (ups, downs)) if s.touches else None
            if found:
                after, (y, w) = self.refine(before, *found)
            while len(self.samples) < len(self.times) and self.times[len(self.samples)] <= after:
                self.samples.append(self.at(before, float(self.times[len(self.samples)]))[0])
            if after >= end:
                return ""
            if self.is_late:
                return "budget"
            self.time = after
            if found:
                s.x, s.v = y, w
                if self.strike(after, *found[1]):
                    return "rest"
                simulation = self.begin(after)

    def begin(self, time: float) -> Any:
        simulation, s = rebound.Simulation(), self.spheres
        simulation.G, simulation.softening = self.scene.gravity.constant, self.scene.gravity.softening
        simulation.integrator = "ias15"
        for m, (x, y, z), (vx, vy, vz) in zip(s.mass.tolist(), s.x.tolist(), s.v.tolist(), strict=True):
            simulation.add(m=m, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
        simulation.t, simulation.dt = time, FIRST_STEP * self.scene.time.duration
        return simulation

    def state(self, simulation: Any) -> tuple[FloatArray, FloatArray]:
        x, v = np.empty((2, self.spheres.n, 3))
        simulation.serialize_particle_data(xyz=x, vxvyvz=v)
        return x, v

    def at(self, before: Any, time: float) -> tuple[FloatArray, FloatArray]:
        """Return the state at a time within the step that begins at the state of a simulation."""
        if time <= before.t:
            return self.state(before)
        inner = before.copy()
        inner.dt = time - before.t
        inner.integrate(time, exact_finish_time=1)
        return self.state(inner)

    def pull(self, x: FloatArray) -> FloatArray:
        d = x[None] - x[:, None]
        square = (d * d).sum(2) + self.scene.gravity.softening**2
        np.fill_diagonal(square, 1.0)
        weight = self.scene.gravity.constant * self.spheres.mass / (square * np.sqrt(square))
        return np.asarray(np.einsum("ij,ijk->ik", weight, d))

    def first_touch(
        self,
        dt: float,
        begin: tuple[FloatArray, FloatArray],
        end: tuple[FloatArray, FloatArray],
        pairs: tuple[NDArray[np.int64], NDArray[np.int64]],
    ) -> tuple[float, tuple[int, int]] | None:
        """Return the time (s) at which a pair first touches within a step, and the pair."""
        s = self.spheres
        way = _quintic(dt, *begin, self.pull(begin[0]), *end, self.pull(end[0]))  # (6, n, 3)
        reach = 2.0 * float(np.sqrt((np.abs(way[1:]).sum(0) ** 2).sum(1)).max())
        i, j = pairs
        d = begin[0][j] - begin[0][i]
        near = np.flatnonzero(np.sqrt((d * d).sum(1)) - s.radius[i] - s.radius[j] <= reach)
        i, j = i[near], j[near]
        paths = [way[:, j] - way[:, i]]
        sums = [s.radius[i] + s.radius[j]]
        for p in range(s.p):
            height = way @ s.normal[p]
            height[0] -= s.offset[p]
            paths.append(height[..., None] * np.array([1.0, 0.0, 0.0]))
            sums.append(s.radius)
        path, touching = np.concatenate(paths, axis=1), np.concatenate(sums)
        bodies = np.concatenate((i, np.tile(np.arange(s.n), s.p)))
        others = np.concatenate((j, s.n + np.repeat(np.arange(s.p), s.n)))
        if not len(touching):
            return None
        powers = WITHIN[:, None] ** np.arange(6)
        gap = np.sqrt((np.einsum("hm,mck->hck", powers, path) ** 2).sum(2)) - touching
        rate = np.einsum("ck,ck->c", path[0], path[1])
        gap[0] = np.where((np.abs(gap[0]) < TOUCHING * touching) & (rate >= 0.0), TOUCHING, gap[0])
        best: tuple[float, tuple[int, int]] | None = None
        for c in np.flatnonzero((gap < (gap[:-1] - gap[1:]).max(0)).any(0)):
            h = _root(path[:, c], float(touching[c]), gap[:, c])
            if h is not None and (best is None or self.time + h * dt < best[0]):
                best = self.time + h * dt, (int(bodies[c]), int(others[c]))
        return best

    def refine(self, before: Any, time: float, pair: tuple[int, int]) -> tuple[float, tuple[FloatArray, FloatArray]]:
        """Return the time at which a pair touches, and the state there."""
        s, (i, j) = self.spheres, pair
        state = self.at(before, time)
        for _ in range(NEWTON):
            x, v = state
            if j < s.n:
                d, w, R = x[j] - x[i], v[j] - v[i], s.radius[i] + s.radius[j]
                distance = np.sqrt(d @ d)
                gap, rate = distance - R, d @ w / distance
            else:
                gap = s.normal[j - s.n] @ x[i] - s.offset[j - s.n] - s.radius[i]
                rate = s.normal[j - s.n] @ v[i]
            shift = -gap / rate if rate < 0.0 else 0.0
            later = max(time + shift, before.t)
            if later == time:
                break
            time, state = later, self.at(before, later)
        return time, state


def _quintic(
    dt: float, x: FloatArray, v: FloatArray, a: FloatArray, y: FloatArray, w: FloatArray, b: FloatArray
) -> FloatArray:
    """Return the coefficients in h, (6, n, 3), of the polynomial with given positions, velocities and accelerations."""
    c0, c1, c2 = x, dt * v, 0.5 * dt * dt * a
    p, q, r = y - c0 - c1 - c2, dt * w - c1 - 2.0 * c2, dt * dt * b - 2.0 * c2
    return np.array([c0, c1, c2, 10 * p - 4 * q + 0.5 * r, -15 * p + 7 * q - r, 6 * p - 3 * q + 0.5 * r])


def _root(path: FloatArray, touching: float, gap: FloatArray) -> float | None:
    """Return the first fraction of the step at which a pair touches while it closes."""

    def at(h: float) -> float:
        d = (h ** np.arange(6)) @ path
        return float(np.sqrt(d @ d)) - touching

    for k in range(1, len(WITHIN)):
        a, b = float(WITHIN[k - 1]), float(WITHIN[k])
        low = gap[k]
        if low > 0.0 and gap[k - 1] > 0.0 and k + 1 < len(WITHIN) and gap[k] <= gap[k - 1] and gap[k] <= gap[k + 1]:
            b = _lowest(at, a, float(WITHIN[k + 1]))
            low = at(b)
        if not (low < 0.0 <= gap[k - 1] or (k == 1 and gap[0] < 0.0)):
            continue
        if k == 1 and gap[0] < 0.0:
            return 0.0
        for _ in range(60):
            h = 0.5 * (a + b)
            a, b = (h, b) if at(h) > 0.0 else (a, h)
        return b
    return None


def _lowest(at: Any, a: float, b: float) -> float:
    """Return the position of a function's minimum in an interval, by golden-section search."""
    golden = (5.0**0.5 - 1.0) / 2.0
    for _ in range(40):
        p, q = b - golden * (b - a), a + golden * (b - a)
        a, b = (a, q) if at(p) < at(q) else (p, b)
    return 0.5 * (a + b)
