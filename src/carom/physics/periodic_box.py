"""The periodic box: distances go to the nearest image."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.jit.decorators import inline
from carom.physics.vector import Vector


@inline
def sizes(box: FloatArray) -> Vector:
    """Return the size of a box, (3,) m, as numbers; zeros in open space."""
    return box[0], box[1], box[2]


@inline
def minimum_image(d: float, L: float) -> float:
    """Return one coordinate of a separation, d m, to the nearest image in a box of size L m: d - L ⌊d/L + ½⌋."""
    nearest: float = d - L * np.floor(d / L + 0.5)
    return nearest


@inline
def nearest_image(dx: float, dy: float, dz: float, Lx: float, Ly: float, Lz: float) -> tuple[float, float, float]:
    """Return a separation to the nearest image in a box of (Lx, Ly, Lz) m; see `minimum_image`."""
    return minimum_image(dx, Lx), minimum_image(dy, Ly), minimum_image(dz, Lz)


def minimum_images(d: FloatArray, box: FloatArray) -> FloatArray:
    """Return separations, (..., 3) m, to the nearest images in a box, (3,) m."""
    return d - box * np.floor(d / box + 0.5)
