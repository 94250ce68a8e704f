"""Event-driven drift in plain NumPy, the oracle of the kernels: no broad phase and no event queue.

After each impact it looks at all pairs, planes and images, moves all bodies to the first impact, and resolves that one
by the readable form of the impulse law.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.reference_api import BodyProxy, CollisionContext
from carom.physics.space import Space
from carom.scene.matter import pair_coefficients

FloatArray = NDArray[np.float64]


class Impact(NamedTuple):
    """One impact: its time in s from the beginning of the drift, its pair, and its closing speed in m/s."""

    time: float
    i: int
    j: int
    closing: float


def drift(bodies: Bodies, space: Space, kick: float, dt: float) -> list[Impact]:
    """Move bodies without friction on planes for dt after a kick; return the impacts in the order of time."""
    time = 0.0
    impacts: list[Impact] = []
    while True:
        found = _first(bodies, space, kick - time, dt - time)
        span = found[0] if found else dt - time
        bodies.position[:] += bodies.velocity * span
        if found is None:
            return impacts
        time += span
        _, i, j, normal, closing = found
        _strike(bodies, space, i, j, normal, time - kick)
        impacts.append(Impact(time, i, j, closing))


def _first(bodies: Bodies, space: Space, kick: float, span: float) -> tuple[float, int, int, FloatArray, float] | None:
    found = []
    n = len(bodies)
    for i, j in itertools.combinations(range(n), 2):
        for image in itertools.product((-1, 0, 1), repeat=3) if space.box is not None else [(0, 0, 0)]:
            d = bodies.position[j] - bodies.position[i]
            if space.box is not None:
                d = d - space.box * np.floor(d / space.box + 0.5) + np.array(image) * space.box
            v, a = bodies.velocity[j] - bodies.velocity[i], bodies.acceleration[j] - bodies.acceleration[i]
            R = bodies.radius[i] + bodies.radius[j]
            roots = np.roots([v @ v, 2 * d @ v, d @ d - R * R]) if v @ v > 0 and d @ v < 0 else np.empty(0)
            if len(roots) and abs(roots[0].imag) == 0.0:
                found.append((max(0.0, roots.real.min()), i, j, d, v, a))
    for i, p in itertools.product(range(n), range(len(space.planes))):
        N = space.planes.normal[p]
        rate = N @ bodies.velocity[i]
        if rate < 0.0:
            height = N @ bodies.position[i] - space.planes.offset[p] - bodies.radius[i]
            found.append((max(0.0, height / -rate), i, n + p, -N, -bodies.velocity[i], -bodies.acceleration[i]))
    for tau, i, j, d, v, a in sorted(found, key=lambda one: one[:3]):
        normal = d if j >= n else d + v * tau
        normal = normal / np.linalg.norm(normal)
        closing = -(v + a * (tau - kick)) @ normal
        noise = 1e-13 * (np.abs(bodies.velocity).sum())
        if tau <= span and closing > noise:
            return tau, i, j, normal, float(closing)
    return None


def _strike(bodies: Bodies, space: Space, i: int, j: int, n: FloatArray, since_kick: float) -> None:
    change = bodies.acceleration * since_kick
    bodies.velocity[:] += change
    if j >= len(bodies):
        e = pair_coefficients(space.scene).of(i, j).restitution
        bodies.velocity[i] -= (1 + e) * (bodies.velocity[i] @ n) * n
    else:
        b1, b2 = BodyProxy(bodies, i), BodyProxy(bodies, j)
        r1_vec, r2_vec = n * b1.radius, -n * b2.radius
        v1 = b1.velocity + np.cross(b1.angular_velocity, r1_vec)
        v2 = b2.velocity + np.cross(b2.angular_velocity, r2_vec)
        law = pair_coefficients(space.scene).of(i, j)
        context = CollisionContext(b1, b2, n, r1_vec, r2_vec, v2 - v1, 0.0)
        context.resolve(law.restitution, law.static_friction, law.kinetic_friction)
    bodies.velocity[:] -= change
