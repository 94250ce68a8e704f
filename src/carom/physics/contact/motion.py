"""The motion of the bodies at the ends of contacts, laid out so that a sweep finds each body in two cache lines.

Only bodies that touch anything are laid out: among 10⁶ in flight they are few.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.thread_team import Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SOME = 10_000  # contacts that are worth a part of their own


def those_that_touch(pairs: IntArray, ends: int, team: Team) -> IntArray:
    """Return the bodies and planes, out of so many, that are in a pair, in rising order."""
    touches = np.zeros(ends, dtype=np.bool_)
    team.divide(len(pairs), SOME, _mark, pairs, touches)
    return np.flatnonzero(touches)


@long_kernel
def _mark(lo: int, hi: int, pairs: IntArray, touches: NDArray[np.bool_]) -> None:
    for c in range(lo, hi):
        touches[pairs[c, 0]] = touches[pairs[c, 1]] = True


@long_kernel
def pack(
    lo: int,
    hi: int,
    who: IntArray,
    v: FloatArray,
    omega: FloatArray,
    inverse_mass: FloatArray,
    inverse_inertia: FloatArray,
    V: FloatArray,
) -> None:
    """Lay out the motion of the bodies [lo, hi) of those that touch; without spin ``omega`` has no rows."""
    for k in range(lo, hi):
        b = who[k]
        for axis in range(3):
            V[b, axis] = v[b, axis]
            V[b, 3 + axis] = omega[b, axis] if len(omega) > 0 else 0.0
            V[b, 8 + axis] = V[b, 11 + axis] = 0.0
        V[b, 6], V[b, 7] = inverse_mass[b], inverse_inertia[b]


@long_kernel
def unpack(lo: int, hi: int, who: IntArray, V: FloatArray, v: FloatArray, omega: FloatArray) -> None:
    """Write their velocities back."""
    for k in range(lo, hi):
        b = who[k]
        for axis in range(3):
            v[b, axis] = V[b, axis]
            if len(omega) > 0:
                omega[b, axis] = V[b, 3 + axis]
