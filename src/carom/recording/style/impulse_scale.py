"""The scale of drawn contacts and impacts: eight widths and colours for impulses of any size.

A magnitude m is drawn by u = s / (1 + s), s = (m / m_ref)^⅓, like the lengths of arrows (`arrows`). The eight levels of
u have equal widths. They save 6 of 8 bytes per contact in the file, because neighbours often have the same level.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.recording.style.arrows import part_of_longest
from carom.recording.style.line_radii import line_radii
from carom.recording.style.single_precision import single

FloatArray = NDArray[np.float64]

# Matplotlib's inferno from 0.3 to 1, perceptually uniform; its dark end would be invisible on the dark background.
COLOURS = np.array(
    [0x6A176EFF, 0x932667FF, 0xBC3754FF, 0xDD513AFF, 0xF37819FF, 0xFCA50AFF, 0xF6D746FF, 0xFCFFA4FF], dtype=np.uint32
)
LEVELS = len(COLOURS)
_THINNEST, _THICKEST = 0.06, 0.30  # radius of an edge, in median body radii
_SMALLEST, _LARGEST = 0.12, 0.60  # radius of the point at an impact, in median body radii
REACH = 2.0  # L_max of an arrow in median body radii


def edge_radii(radius: FloatArray) -> NDArray[np.float32]:
    """Return the radius of an edge at each level, (8,), as `line_radii` does."""
    return line_radii(np.linspace(_THINNEST, _THICKEST, LEVELS), float(np.median(radius)))


def point_radii(radius: FloatArray) -> NDArray[np.float32]:
    """Return the radius of an impact's point at each level, (8,) m."""
    return single(np.median(radius) * np.linspace(_SMALLEST, _LARGEST, LEVELS))


def level(magnitude: FloatArray, reference: float) -> NDArray[np.int64]:
    """Return the level of each magnitude, 0 to 7; 0 for magnitudes up to zero."""
    u = part_of_longest(np.maximum(magnitude, 0.0), reference)
    levels: NDArray[np.int64] = np.minimum((LEVELS * u).astype(np.int64), LEVELS - 1)
    return levels
