"""The scale by which contacts and impacts are drawn: impulses of all sizes on eight widths and colours.

A magnitude m is drawn at u = s / (1 + s), s = (m / m_ref)^⅓, as the length of an arrow is (`arrows`). The eight levels
of u are equally wide. They save 6 of 8 bytes a contact in the file: neighbours often share one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Matplotlib's inferno from 0.3 to 1, perceptually uniform, without the end that cannot be seen on a dark ground.
COLOURS = np.array(
    [0x6A176EFF, 0x932667FF, 0xBC3754FF, 0xDD513AFF, 0xF37819FF, 0xFCA50AFF, 0xF6D746FF, 0xFCFFA4FF], dtype=np.uint32
)
LEVELS = len(COLOURS)
_THINNEST, _THICKEST = 0.06, 0.30  # radius of an edge, in median body radii
_SMALLEST, _LARGEST = 0.12, 0.60  # radius of the point at an impact, likewise
REACH = 2.0  # L_max of an arrow in median body radii


def edge_radii(radius: FloatArray) -> NDArray[np.float32]:
    """Return the radius of an edge at each level, (8,) m."""
    return _between(_THINNEST, _THICKEST, radius)


def point_radii(radius: FloatArray) -> NDArray[np.float32]:
    """Return the radius of an impact's point at each level, (8,) m."""
    return _between(_SMALLEST, _LARGEST, radius)


def level(magnitude: FloatArray, reference: float) -> NDArray[np.int64]:
    """Return the level, 0 to 7, of each magnitude; those up to zero have level 0."""
    s = np.cbrt(np.maximum(magnitude, 0.0) / reference)
    u = 1.0 - 1.0 / (1.0 + s)  # 1 where s is infinite
    return np.minimum((LEVELS * u).astype(np.int64), LEVELS - 1)


def _between(least: float, most: float, radius: FloatArray) -> NDArray[np.float32]:
    return (np.median(radius) * np.linspace(least, most, LEVELS)).astype(np.float32)
