"""Finding contacts: which pairs touch, and the geometry of each contact."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.grid import Grid
from carom.physics.kernel import kernel
from carom.scene.neighbours import overlapping_pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Search(Protocol):
    """A way to find the pairs of spheres that touch."""

    def pairs(self, position: FloatArray, stretch: float = 1.0, slack: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) stretch + slack``, (m, 2), sorted by (i, j)."""
        ...


class KdTree:
    """The seed's broad phase, kept to compare with: 5 to 8 times slower than `Grid` (benchmarks/search.py)."""

    def __init__(self, radius: FloatArray, box: FloatArray) -> None:
        self._radius = radius
        self._box = box if box[0] > 0.0 else None

    def pairs(self, position: FloatArray, stretch: float = 1.0, slack: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) stretch + slack``, (m, 2), sorted by (i, j)."""
        return overlapping_pairs(position, self._radius * stretch + 0.5 * slack, self._box)


def search_by(method: str, radius: FloatArray, box: FloatArray) -> Search:
    """Return the search that a scene names in ``contact.search``."""
    return KdTree(radius, box) if method == "k-d-tree" else Grid(radius, box)


def contact_geometry(
    pairs: IntArray, position: FloatArray, radius: FloatArray, box: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return normals from i to j, (m, 3), centre distances, (m,) m, and overlaps, (m,) m."""
    m = len(pairs)
    normals, distances, overlaps = np.empty((m, 3)), np.empty(m), np.empty(m)
    _geometry(pairs, position, radius, box, normals, distances, overlaps)
    return normals, distances, overlaps


@kernel
def _geometry(
    pairs: IntArray,
    position: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    normals: FloatArray,
    distances: FloatArray,
    overlaps: FloatArray,
) -> None:
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        d2 = 0.0
        for k in range(3):
            d = position[j, k] - position[i, k]
            if box[k] > 0.0:
                d -= box[k] * np.floor(d / box[k] + 0.5)
            normals[c, k] = d
            d2 += d * d
        d = np.sqrt(d2)
        if d > 0.0:
            for k in range(3):
                normals[c, k] /= d
        else:  # coincident centres: any direction will do, as long as it is always the same
            normals[c, 0], normals[c, 1], normals[c, 2] = 1.0, 0.0, 0.0
        distances[c] = d
        overlaps[c] = radius[i] + radius[j] - d
