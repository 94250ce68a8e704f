"""Vectors in kernels: operations on rows of (n, 3) arrays, and separations in a periodic box.

The functions are inlined: they are as fast as indexing, and give the same bits.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.jit.decorators import inline

Vector = tuple[float, float, float]


@inline
def vector(v: FloatArray, i: int) -> Vector:
    """Return vector i."""
    return v[i, 0], v[i, 1], v[i, 2]


@inline
def between(v: FloatArray, i: int, j: int) -> Vector:
    """Return vector j minus vector i."""
    return v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]


@inline
def along(v: FloatArray, rate: FloatArray, i: int, s: float) -> Vector:
    """Return vector i after a time s at its present rate of change."""
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


@inline
def is_periodic(box: FloatArray | Vector) -> bool:
    """Return whether a box is periodic; open space has a box of zeros."""
    return bool(box[0] > 0.0)


@inline
def sizes(box: FloatArray) -> Vector:
    """Return the size of a box, (3,) m, as numbers; zeros in open space."""
    return box[0], box[1], box[2]


@inline
def minimum_image(d: float, L: float) -> float:
    """Return one coordinate of a separation (m) to the nearest image in a box of size L: d - L ⌊d/L + ½⌋."""
    nearest: float = d - L * np.floor(d / L + 0.5)
    return nearest


@inline
def nearest_image(dx: float, dy: float, dz: float, box: FloatArray | Vector) -> Vector:
    """Return a separation (m) to the nearest image in a box; unchanged in open space."""
    if box[0] > 0.0:
        dx, dy, dz = minimum_image(dx, box[0]), minimum_image(dy, box[1]), minimum_image(dz, box[2])
    return dx, dy, dz


def minimum_images(d: FloatArray, box: FloatArray) -> FloatArray:
    """Return separations, (..., 3) m, to the nearest images in a box; unchanged in open space.

    The box is its size, (3,) m, or the vectors to the next images in a sheared box (`Shear.cell`), (3, 3) m.
    """
    if box.ndim == 2:
        for axis in np.argsort(np.count_nonzero(box, axis=1) == 1, kind="stable"):  # the gradient comes first
            d = d - np.floor(d[..., axis, None] / box[axis, axis] + 0.5) * box[axis]
        return d
    return d - box * np.floor(d / box + 0.5) if box[0] > 0.0 else d
