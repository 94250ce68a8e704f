"""Whether bodies on orbits come close to each other, or to the dominant one, within a step."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.integrators.orbit_arrays import Orbits
from carom.physics.jit.decorators import unowned
from carom.physics.vector import between, square

UNRESOLVED = 2.0  # a step longer than half of √(r³/μ) is an eighth of a turn or more


@unowned
def meets(o: Orbits, x: FloatArray, after: float, until: float, apart: float) -> bool:
    """Tell whether two bodies come close from a time after ``place`` until another, on straight lines, both in s.

    Close is nearer than ``apart`` times `Orbits.near`.
    """
    place, speed, near, reach = o.place, o.speed, o.near, o.reach
    longest = max(abs(after), abs(until))
    shortest = apart * UNRESOLVED * (until - after)
    n, widest = len(place), 0.0
    for i in range(1, n):
        widest = max(widest, near[i])
        r2 = square(x, i)
        if r2 * np.sqrt(r2) < shortest * shortest * o.mu[i]:
            return True
        reach[i] = longest * np.sqrt(square(speed, i))
    if not widest > 0.0:
        return False
    for i in range(2, n):
        own, far = near[i], reach[i]
        for j in range(1, i):
            dx, dy, dz = between(place, i, j)
            d2 = dx * dx + dy * dy + dz * dz
            close = apart * max(own, near[j])
            wide = close + far + reach[j]
            if d2 < wide * wide and _passes(speed, i, j, dx, dy, dz, close, after, until):
                return True
    return False


@unowned
def _passes(
    speed: FloatArray, i: int, j: int, dx: float, dy: float, dz: float, close: float, after: float, until: float
) -> bool:
    """Tell whether the distance of two bodies falls below a length ``close`` in m."""
    ux, uy, uz = between(speed, i, j)
    u2 = ux * ux + uy * uy + uz * uz
    t = -(dx * ux + dy * uy + dz * uz) / u2 if u2 > 0.0 else after
    t = min(max(t, after), until)
    dx, dy, dz = dx + t * ux, dy + t * uy, dz + t * uz
    return dx * dx + dy * dy + dz * dz < close * close
