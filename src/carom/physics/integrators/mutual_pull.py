"""The kick by H_mutual: the pulls of all pairs, less those of the Kepler orbits."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.integrators.kepler import LANES
from carom.physics.integrators.orbit_arrays import Orbits
from carom.physics.jit.decorators import unowned
from carom.physics.vector import add, between, vector, write

LANES_FROM = 64  # bodies, from which pairs are summed in SIMD lanes


@unowned
def kick(o: Orbits, x: FloatArray, v: FloatArray, h: float) -> None:
    """Change the rates of Jacobi coordinates by H_mutual; `place` has to belong to x."""
    if len(x) < LANES_FROM:
        _mutual(o.place, o.pull, o.acceleration)
    else:
        _mutual_in_lanes(o.place, o.pull, o.acceleration, o.lanes)
    _turn(x, v, o.acceleration, o.share, o.mu, h)


@unowned
def _mutual(place: FloatArray, pull: FloatArray, a: FloatArray) -> None:
    """Write the accelerations by all pairs except the first two bodies, a_i = Σ_j G m_j d_ij / |d_ij|³."""
    n = len(place)
    for i in range(min(n, 2)):
        write(a, i, 0.0, 0.0, 0.0)
    for i in range(2, n):
        own = pull[i]
        px, py, pz = vector(place, i)
        ax, ay, az = 0.0, 0.0, 0.0
        for j in range(i):
            dx, dy, dz = vector(place, j)
            dx, dy, dz = dx - px, dy - py, dz - pz
            d2 = dx * dx + dy * dy + dz * dz
            d3 = 1.0 / (d2 * np.sqrt(d2))
            f, g = pull[j] * d3, own * d3
            ax, ay, az = ax + f * dx, ay + f * dy, az + f * dz
            add(a, j, -g, dx, dy, dz)
        write(a, i, ax, ay, az)


@unowned
def _mutual_in_lanes(place: FloatArray, pull: FloatArray, a: FloatArray, lanes: FloatArray) -> None:
    """Do the same for many bodies, with those that are pulled side by side in SIMD lanes."""
    n = len(place)
    sx, sy, sz = 0.0, 0.0, 0.0  # of the dominant one
    for i in range(1, n):
        dx, dy, dz = between(place, i, 0)
        d2 = dx * dx + dy * dy + dz * dz
        d3 = 1.0 / (d2 * np.sqrt(d2)) if i > 1 else 0.0
        f, g = pull[0] * d3, pull[i] * d3
        write(a, i, f * dx, f * dy, f * dz)
        sx, sy, sz = sx - g * dx, sy - g * dy, sz - g * dz
    write(a, 0, sx, sy, sz)
    for first in range(1, n, LANES):
        count = min(LANES, n - first)
        for k in range(count):
            for row in range(3):
                lanes[row * LANES + k] = place[first + k, row]
                lanes[(row + 3) * LANES + k] = 0.0
        for j in range(1, n):
            mj = pull[j]
            xj, yj, zj = vector(place, j)
            for k in range(count):
                dx, dy, dz = xj - lanes[k], yj - lanes[LANES + k], zj - lanes[2 * LANES + k]
                d2 = dx * dx + dy * dy + dz * dz
                f = mj / (d2 * np.sqrt(d2)) if d2 > 0.0 else 0.0
                lanes[3 * LANES + k] += f * dx
                lanes[4 * LANES + k] += f * dy
                lanes[5 * LANES + k] += f * dz
        for k in range(count):
            for row in range(3):
                a[first + k, row] += lanes[(row + 3) * LANES + k]


@unowned
def _turn(x: FloatArray, v: FloatArray, a: FloatArray, share: FloatArray, mu: FloatArray, h: float) -> None:
    """Change the rates of Jacobi coordinates by Cartesian accelerations, less those of the Kepler orbits."""
    rx, ry, rz = vector(a, 0)  # acceleration of the centre of mass of those before i
    for i in range(1, len(x)):
        ax, ay, az = vector(a, i)
        ax, ay, az = ax - rx, ay - ry, az - rz
        rx, ry, rz = rx + share[i] * ax, ry + share[i] * ay, rz + share[i] * az
        if i > 1:
            px, py, pz = vector(x, i)
            r2 = px * px + py * py + pz * pz
            back = mu[i] / (r2 * np.sqrt(r2))
            ax, ay, az = ax + back * px, ay + back * py, az + back * pz
        add(v, i, h, ax, ay, az)
