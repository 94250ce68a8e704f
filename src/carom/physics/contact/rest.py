"""When a contact is at rest rather than an impact.

A contact at rest closes no faster than gravity makes it close in a step. Bodies that rest on each other share a load,
so the acceleration that counts is the largest in the whole pile that they belong to, not their own: in its middle
nothing accelerates and the load is greatest. The pile is the connected component of the collision graph without what is
fixed; another pile, however heavy, has no say. The uniform field pulls all alike and does not count, unless something
is fixed and does not fall with the rest. Without gravity the speed is 0: every contact is an impact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def rest_speeds(
    pairs: IntArray, acceleration: FloatArray, inverse_mass: FloatArray, field: FloatArray, dt: float
) -> FloatArray:
    """Return the speed up to which each contact is at rest: 2 |a|max dt of its pile.

    Two bodies that rest on each other close at most that fast at the end of a step that began without motion.

    Parameters
    ----------
    pairs
        (m, 2) contacts.
    acceleration
        (n + p, 3) m/s² of bodies and planes, with the uniform field in it.
    inverse_mass
        (n + p,) 1/kg; what does not move passes no load on.
    field
        (3,) m/s², as far as it pulls all alike.

    Returns
    -------
    speeds
        (m,) m/s.
    """
    n = len(acceleration)
    speeds = np.empty(len(pairs))
    parent, largest = np.empty(n, dtype=np.int64), np.empty(n)  # touched only where contacts are
    _rest_speeds(pairs, acceleration, inverse_mass, field, dt, parent, largest, speeds)
    return speeds


@kernel
def pile_speeds(
    pairs: IntArray,
    x: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    stretch: float,
    slack: float,
    acceleration: FloatArray,
    inverse_mass: FloatArray,
    field: FloatArray,
    dt: float,
    speeds: FloatArray,
) -> None:
    """Write 2 |a|max dt of the pile of each body, (n + p,) m/s, given all pairs that may touch; 0 for what is fixed.

    Those no farther apart than ``(r_i + r_j) stretch + slack`` do.
    """
    n = len(x)
    parent = np.arange(n)
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        if inverse_mass[i] == 0.0 or inverse_mass[j] == 0.0:
            continue
        d2 = 0.0
        for k in range(3):
            d = x[j, k] - x[i, k]
            if box[k] > 0.0:
                d -= box[k] * np.floor(d / box[k] + 0.5)
            d2 += d * d
        near = (radius[i] + radius[j]) * stretch + slack
        if d2 <= near * near:
            i, j = _root(parent, i), _root(parent, j)
            parent[max(i, j)] = min(i, j)
    for i in range(n):
        a2 = 0.0
        for k in range(3):
            a = acceleration[i, k] - field[k]
            a2 += a * a
        speeds[i] = 2.0 * np.sqrt(a2) * dt if inverse_mass[i] > 0.0 else 0.0
    for i in range(n):
        pile = _root(parent, i)
        speeds[pile] = max(speeds[pile], speeds[i])
    for i in range(n):
        speeds[i] = speeds[_root(parent, i)]


@kernel
def largest_square(acceleration: FloatArray, field: FloatArray) -> float:
    """Return |a|² of the body that the field alone explains least, in m²/s⁴."""
    largest = 0.0
    for i in range(len(acceleration)):
        a2 = 0.0
        for k in range(3):
            a = acceleration[i, k] - field[k]
            a2 += a * a
        largest = max(largest, a2)
    return largest


@kernel
def largest_coordinate(position: FloatArray) -> float:
    """Return how far the farthest body is from the origin along an axis, in m."""
    largest = 0.0
    for i in range(len(position)):
        for k in range(3):
            largest = max(largest, abs(position[i, k]))
    return largest


@kernel
def _root(parent: IntArray, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _rest_speeds(
    pairs: IntArray,
    acceleration: FloatArray,
    inverse_mass: FloatArray,
    field: FloatArray,
    dt: float,
    parent: IntArray,
    largest: FloatArray,
    speeds: FloatArray,
) -> None:
    for c in range(len(pairs)):
        for end in range(2):
            parent[pairs[c, end]], largest[pairs[c, end]] = pairs[c, end], 0.0
    for c in range(len(pairs)):
        if inverse_mass[pairs[c, 0]] > 0.0 and inverse_mass[pairs[c, 1]] > 0.0:
            i, j = _root(parent, pairs[c, 0]), _root(parent, pairs[c, 1])
            parent[max(i, j)] = min(i, j)
    for c in range(len(pairs)):
        for end in range(2):
            i = pairs[c, end]
            if inverse_mass[i] == 0.0:
                continue
            pile = _root(parent, i)
            a2 = 0.0
            for k in range(3):
                a = acceleration[i, k] - field[k]
                a2 += a * a
            largest[pile] = max(largest[pile], a2)
    for c in range(len(pairs)):
        mover = pairs[c, 0] if inverse_mass[pairs[c, 0]] > 0.0 else pairs[c, 1]
        speeds[c] = 2.0 * np.sqrt(largest[_root(parent, mover)]) * dt
