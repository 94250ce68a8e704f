"""Impacts at one moment: all pairs that touch are resolved one by one, repeatedly, until none closes.

If that has no end, contacts are held (`held_group`).

An integrator that ends its step at an impact calls this there. Positions and velocities are those of the impact, so
each impulse is that of the event loop. Rigid bodies have no unique answer where several pairs meet at once: as in the
event loop, pairs are taken in their order.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import IntArray, Records
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.events.event_loop import MAX_ELASTIC, MAX_IN_COLLAPSE, collide
from carom.physics.contact.events.held_group import MOST_CONTACTS, hold_group
from carom.physics.contact.events.trajectories import MOST_HOLDS, ROUNDING, Trajectories, arrive
from carom.physics.contact.law import dissipates, material_index
from carom.physics.jit.decorators import inline, long_kernel
from carom.physics.vector import between, vector

TOUCHING = 16 * 2.0**-53  # of the coordinates and of the sum of radii: a gap that is rounding


@long_kernel
def resolve_touching(T: Trajectories, pairs: IntArray, log: Records) -> int:
    """Resolve the impacts of all that touch; return their number.

    Parameters
    ----------
    T
        The bodies at the impact; `DRIFT` has the same time for clock and kick, and ``exhausted`` and ``strays`` 0.
    pairs
        (m, 2) room for the pairs that touch; the first row is one that does, whatever its gap. Without room nothing
        is done.
    log
        (k,) `IMPACT`, room for their log.
    """
    count, row = _find(T, pairs), 0
    for i in range(len(T.x) if count > 0 else 0):
        arrive(i, T)
    for sweep in range(MAX_ELASTIC + MOST_HOLDS):
        before = row
        for c in range(count):
            i, j = ends_of(pairs, c)
            speed, speeds = _closing(i, j, T)
            if not (speed > ROUNDING * speeds or (sweep == 0 and c == 0)):
                continue
            lossy = dissipates(T.materials[material_index(i, j, len(T.x), T.places)])
            if sweep < (MAX_IN_COLLAPSE if lossy else MAX_ELASTIC) and row < len(log) // 2:
                collide(i, j, log[row], T)
                row += 1
            elif row + MOST_CONTACTS <= len(log):
                _exhaust(i, T)
                _exhaust(j, T)
                row = hold_group(i, j, T.everyone, T, log, row)[1]
            else:
                T.drift[0].exhausted = 1
                return row
        if row == before:
            return row
    T.drift[0].exhausted = 1
    return row


@inline
def _exhaust(i: int, T: Trajectories) -> None:
    """Let the contacts of a body be held from now on."""
    if i < len(T.x):
        T.body[i].exhausted = T.inverse_mass[i] > 0.0


@inline
def _find(T: Trajectories, pairs: IntArray) -> int:
    """Write the other pairs that touch after the first one; return the number of all."""
    x, radius, offset, surface, n = T.x, T.radius, T.offset, T.surface, len(T.x)
    count = min(1, len(pairs))
    for i in range(n if count > 0 else 0):
        xi, yi, zi = vector(x, i)
        size = abs(xi) + abs(yi) + abs(zi)
        for j in range(i + 1, n):
            dx, dy, dz = between(x, i, j)
            R = radius[i] + radius[j]
            reach = R + TOUCHING * (R + size)
            if dx * dx + dy * dy + dz * dz <= reach * reach and T.inverse_mass[i] + T.inverse_mass[j] > 0.0:
                count = _add(i, j, count, pairs)
        for p in range(len(offset) if T.inverse_mass[i] > 0.0 else 0):
            nx, ny, nz = vector(surface, p)
            height = nx * xi + ny * yi + nz * zi - offset[p]
            if height - radius[i] <= TOUCHING * (radius[i] + size):
                count = _add(i, n + p, count, pairs)
    return count


@inline
def _add(i: int, j: int, count: int, pairs: IntArray) -> int:
    """Add a pair that is not the first one, if there is room."""
    if (i == pairs[0, 0] and j == pairs[0, 1]) or count == len(pairs):
        return count
    pairs[count, 0], pairs[count, 1] = i, j
    return count + 1


@inline
def _closing(i: int, j: int, T: Trajectories) -> tuple[float, float]:
    """Return the closing speed of a pair, and the sum of its speeds, in m/s."""
    x, v, n = T.x, T.v, len(T.x)
    rate, length, speeds = 0.0, 0.0, 0.0
    for k in range(3):
        d = -T.surface[j - n, k] if j >= n else x[j, k] - x[i, k]
        rate, length = rate + d * (v[j, k] - v[i, k]), length + d * d
        speeds += abs(v[i, k]) + abs(v[j, k])
    return -rate / np.sqrt(length), speeds
