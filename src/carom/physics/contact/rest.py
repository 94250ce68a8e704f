"""When a contact is at rest rather than an impact.

A contact at rest closes no faster than gravity makes it close in a step. Bodies that rest on each other share a load,
so the acceleration that counts is the largest in the whole pile that they belong to, not their own: in its middle
nothing accelerates and the load is greatest. The pile is the connected component of the collision graph; another pile,
however heavy, has no say. The uniform field pulls all alike and does not count. Without gravity the speed is 0: every
contact is an impact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def rest_speeds(pairs: IntArray, acceleration: FloatArray, field: FloatArray, dt: float) -> FloatArray:
    """Return the speed up to which each contact is at rest: 2 |a|max dt of its pile.

    Two bodies that rest on each other close at most that fast at the end of a step that began without motion.

    Parameters
    ----------
    pairs
        (m, 2) contacts.
    acceleration
        (n, 3) m/s², with the uniform field in it.
    field
        (3,) m/s².

    Returns
    -------
    speeds
        (m,) m/s.
    """
    n = len(acceleration)
    speeds = np.empty(len(pairs))
    _rest_speeds(pairs, acceleration, field, dt, np.arange(n), np.zeros(n), speeds)
    return speeds


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
    field: FloatArray,
    dt: float,
    parent: IntArray,
    largest: FloatArray,
    speeds: FloatArray,
) -> None:
    for c in range(len(pairs)):
        i, j = _root(parent, pairs[c, 0]), _root(parent, pairs[c, 1])
        parent[max(i, j)] = min(i, j)
    for c in range(len(pairs)):
        pile = _root(parent, pairs[c, 0])
        for end in range(2):
            i = pairs[c, end]
            a2 = 0.0
            for k in range(3):
                a = acceleration[i, k] - field[k]
                a2 += a * a
            largest[pile] = max(largest[pile], a2)
    for c in range(len(pairs)):
        speeds[c] = 2.0 * np.sqrt(largest[_root(parent, pairs[c, 0])]) * dt
