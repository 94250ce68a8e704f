"""Jacobi coordinates: each body is seen from the centre of mass of those before it; row 0 is that of all."""

from __future__ import annotations

from carom.arrays import FloatArray, IntArray
from carom.physics.integrators.orbit_arrays import Orbits
from carom.physics.jit.decorators import unowned
from carom.physics.vector import vector, write


@unowned
def from_jacobi(x: FloatArray, share: FloatArray, place: FloatArray) -> None:
    """Turn Jacobi coordinates or their rates into Cartesian ones about the centre of mass."""
    rx, ry, rz = 0.0, 0.0, 0.0  # centre of mass of the bodies up to i
    for i in range(len(x) - 1, 0, -1):
        px, py, pz = vector(x, i)
        rx, ry, rz = rx - share[i] * px, ry - share[i] * py, rz - share[i] * pz
        write(place, i, rx + px, ry + py, rz + pz)
    write(place, 0, rx, ry, rz)


@unowned
def to_jacobi(place: FloatArray, order: IntArray, share: FloatArray, x: FloatArray) -> None:
    """Turn Cartesian coordinates or rates, in the order of the scene, into Jacobi ones."""
    first = order[0]
    rx, ry, rz = vector(place, first)
    for i in range(1, len(x)):
        j = order[i]
        px, py, pz = vector(place, j)
        px, py, pz = px - rx, py - ry, pz - rz
        write(x, i, px, py, pz)
        rx, ry, rz = rx + share[i] * px, ry + share[i] * py, rz + share[i] * pz
    write(x, 0, rx, ry, rz)


@unowned
def put(o: Orbits, x: FloatArray, place: FloatArray, into: FloatArray) -> None:
    """Write Jacobi coordinates or rates in the order of the scene."""
    from_jacobi(x, o.share, place)
    for i in range(len(x)):
        for k in range(3):
            into[o.order[i], k] = place[i, k] + x[0, k]
