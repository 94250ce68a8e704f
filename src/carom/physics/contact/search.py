"""Finding contacts: a broad phase where there are many bodies, then the exact test."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel
from carom.scene.neighbours import overlapping_pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def find_pairs(position: FloatArray, radius: FloatArray, box: FloatArray, broad_phase: bool) -> IntArray:
    """Find all pairs that touch or overlap, (m, 2), sorted by (i, j).

    Parameters
    ----------
    position, radius
        (n, 3) m and (n,) m.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    broad_phase
        Whether k-d trees narrow the candidates down first; the result is the same.
    """
    if broad_phase:
        return overlapping_pairs(position, radius, box if box[0] > 0.0 else None)
    n = len(radius)
    pairs = np.empty((n * (n - 1) // 2, 2), dtype=np.int64)
    return pairs[: _all_pairs(position, radius, box, pairs)].copy()


def contact_geometry(
    pairs: IntArray, position: FloatArray, radius: FloatArray, box: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return normals from i to j, (m, 3), centre distances, (m,) m, and overlaps, (m,) m."""
    m = len(pairs)
    normals, distances, overlaps = np.empty((m, 3)), np.empty(m), np.empty(m)
    _geometry(pairs, position, radius, box, normals, distances, overlaps)
    return normals, distances, overlaps


@kernel
def _all_pairs(position: FloatArray, radius: FloatArray, box: FloatArray, pairs: IntArray) -> int:
    found = 0
    for i in range(len(radius)):
        for j in range(i + 1, len(radius)):
            d2 = 0.0
            for k in range(3):
                d = position[j, k] - position[i, k]
                if box[k] > 0.0:
                    d -= box[k] * np.floor(d / box[k] + 0.5)
                d2 += d * d
            reach = radius[i] + radius[j]
            if d2 <= reach * reach:
                pairs[found, 0], pairs[found, 1] = i, j
                found += 1
    return found


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
