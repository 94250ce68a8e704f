"""Jacobi coordinates: each body is seen from the centre of mass of those before it; row 0 is that of all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.integrators.orbit_arrays import Orbits
from carom.physics.parallel.jit import unowned

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@unowned
def from_jacobi(x: FloatArray, share: FloatArray, place: FloatArray) -> None:
    """Turn Jacobi coordinates or their rates into Cartesian ones about the centre of mass."""
    rx, ry, rz = 0.0, 0.0, 0.0  # centre of mass of the bodies up to i
    for i in range(len(x) - 1, 0, -1):
        rx, ry, rz = rx - share[i] * x[i, 0], ry - share[i] * x[i, 1], rz - share[i] * x[i, 2]
        place[i, 0], place[i, 1], place[i, 2] = rx + x[i, 0], ry + x[i, 1], rz + x[i, 2]
    place[0, 0], place[0, 1], place[0, 2] = rx, ry, rz


@unowned
def to_jacobi(place: FloatArray, order: IntArray, share: FloatArray, x: FloatArray) -> None:
    """Turn Cartesian coordinates or rates, in the order of the scene, into Jacobi ones."""
    first = order[0]
    rx, ry, rz = place[first, 0], place[first, 1], place[first, 2]
    for i in range(1, len(x)):
        j = order[i]
        x[i, 0], x[i, 1], x[i, 2] = place[j, 0] - rx, place[j, 1] - ry, place[j, 2] - rz
        rx, ry, rz = rx + share[i] * x[i, 0], ry + share[i] * x[i, 1], rz + share[i] * x[i, 2]
    x[0, 0], x[0, 1], x[0, 2] = rx, ry, rz


@unowned
def put(o: Orbits, x: FloatArray, place: FloatArray, into: FloatArray) -> None:
    """Write Jacobi coordinates or rates in the order of the scene."""
    from_jacobi(x, o.share, place)
    for i in range(len(x)):
        for k in range(3):
            into[o.order[i], k] = place[i, k] + x[0, k]
