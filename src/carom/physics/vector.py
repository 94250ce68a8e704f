"""Vectors in the rows of an array, (n, 3), by name: inlined into kernels, as fast as indices and with the same bits."""

from __future__ import annotations

from carom.arrays import FloatArray
from carom.physics.jit.decorators import inline

Vector = tuple[float, float, float]


@inline
def vector(v: FloatArray, i: int) -> Vector:
    """Return vector i."""
    return v[i, 0], v[i, 1], v[i, 2]


@inline
def between(v: FloatArray, i: int, j: int) -> Vector:
    """Return the difference from vector i to vector j."""
    return v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]


@inline
def along(v: FloatArray, rate: FloatArray, i: int, s: float) -> Vector:
    """Return vector i after a time s at its present rate."""
    return v[i, 0] + rate[i, 0] * s, v[i, 1] + rate[i, 1] * s, v[i, 2] + rate[i, 2] * s


@inline
def square(v: FloatArray, i: int) -> float:
    """Return the square of the length of vector i."""
    x, y, z = v[i, 0], v[i, 1], v[i, 2]
    return float(x * x + y * y + z * z)


@inline
def write(v: FloatArray, i: int, x: float, y: float, z: float) -> None:
    """Replace vector i."""
    v[i, 0], v[i, 1], v[i, 2] = x, y, z


@inline
def add(v: FloatArray, i: int, s: float, x: float, y: float, z: float) -> None:
    """Add s times a vector to vector i."""
    v[i, 0], v[i, 1], v[i, 2] = v[i, 0] + s * x, v[i, 1] + s * y, v[i, 2] + s * z
