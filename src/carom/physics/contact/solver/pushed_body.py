"""Positions and velocities of the bodies in contact, as records, while the position correction pushes them apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.index import from_front
from carom.physics.vector import vector, write

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

NEVER = -2  # of a body that was not pushed; less than any iteration - 1


@long_kernel
def gather_positions(
    lo: int,
    hi: int,
    active: IntArray,
    x: FloatArray,
    v: FloatArray,
    radius: FloatArray,
    inverse_mass: FloatArray,
    bodies: Records,
    pushed_in: IntArray,
) -> None:
    """Copy the active bodies and planes [lo, hi) into `PUSHED_BODY`; none of them was pushed yet."""
    for k in range(lo, hi):
        b = from_front(active[k])
        body = bodies[b]
        if b < len(x):  # planes have no position
            body.x, body.y, body.z = vector(x, b)
        body.vx, body.vy, body.vz = vector(v, b)
        body.radius, body.inverse_mass = radius[b], inverse_mass[b]
        pushed_in[b] = NEVER


@long_kernel
def scatter_positions(
    lo: int, hi: int, active: IntArray, bodies: Records, pushed_in: IntArray, x: FloatArray, v: FloatArray
) -> None:
    """Copy positions and velocities of the active bodies [lo, hi) that were pushed back into the arrays."""
    for k in range(lo, hi):
        b = from_front(active[k])
        if pushed_in[b] != NEVER:
            body = bodies[b]
            write(x, b, body.x, body.y, body.z)
            write(v, b, body.vx, body.vy, body.vz)
