"""Finding contacts: which pairs touch, and the geometry of each contact."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.grid import Grid
from carom.physics.kernel import kernel
from carom.scene.halfspace import HalfSpaces
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


class PlaneSearch:
    """Adds the contacts (i, n + k) of bodies with planes k, and drops those of two fixed bodies.

    Parameters
    ----------
    radius
        (n,) m.
    inverse_mass
        (n + p,) 1/kg; what is fixed touches nothing else that is.
    planes
        The half-spaces.
    """

    def __init__(self, radius: FloatArray, inverse_mass: FloatArray, planes: HalfSpaces) -> None:
        self._radius = radius
        self._inverse_mass = inverse_mass
        self._planes = planes

    def merged(self, pairs: IntArray, position: FloatArray, stretch: float, slack: float) -> IntArray:
        """Return the pairs, (m, 2) sorted by (i, j), with those of bodies and planes among them, in order."""
        n, p = len(self._radius), len(self._planes)
        merged = np.empty((len(pairs) + n * p, 2), dtype=np.int64)
        m = _merge(
            pairs,
            position,
            self._radius,
            self._inverse_mass,
            self._planes.normal,
            self._planes.offset,
            stretch,
            slack,
            merged,
        )
        return merged[:m].copy()


def contact_geometry(
    pairs: IntArray, position: FloatArray, radius: FloatArray, box: FloatArray, planes: HalfSpaces | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return normals from i to j, (m, 3), lever arms, (m, 2) m, and overlaps, (m,) m.

    Both bodies share one contact point on the line of centres, d r_i/(r_i + r_j) from i and the rest of d from j. A
    plane is touched at the foot of the perpendicular and has no lever arm.
    """
    m = len(pairs)
    normals, arms, overlaps = np.empty((m, 3)), np.empty((m, 2)), np.empty(m)
    surface, offset = (np.empty((0, 3)), np.empty(0)) if planes is None else (planes.normal, planes.offset)
    _geometry(pairs, position, radius, box, surface, offset, normals, arms, overlaps)
    return normals, arms, overlaps


@kernel
def _merge(
    pairs: IntArray,
    position: FloatArray,
    radius: FloatArray,
    inverse_mass: FloatArray,
    normal: FloatArray,
    offset: FloatArray,
    stretch: float,
    slack: float,
    merged: IntArray,
) -> int:
    m, c = 0, 0
    for i in range(len(radius)):
        while c < len(pairs) and pairs[c, 0] == i:
            if inverse_mass[i] + inverse_mass[pairs[c, 1]] > 0.0:
                merged[m, 0], merged[m, 1] = i, pairs[c, 1]
                m += 1
            c += 1
        if inverse_mass[i] == 0.0:
            continue
        for k in range(len(offset)):
            height = -offset[k]
            for axis in range(3):
                height += normal[k, axis] * position[i, axis]
            if height <= radius[i] * stretch + slack:
                merged[m, 0], merged[m, 1] = i, len(radius) + k
                m += 1
    return m


@kernel
def _geometry(
    pairs: IntArray,
    position: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    surface: FloatArray,
    offset: FloatArray,
    normals: FloatArray,
    arms: FloatArray,
    overlaps: FloatArray,
) -> None:
    n = len(radius)
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        if j >= n:
            height = -offset[j - n]
            for k in range(3):
                height += surface[j - n, k] * position[i, k]
                normals[c, k] = -surface[j - n, k]
            arms[c, 0], arms[c, 1] = max(0.0, height), 0.0
            overlaps[c] = radius[i] - height
            continue
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
        share = d / (radius[i] + radius[j])
        arms[c, 0], arms[c, 1] = share * radius[i], share * radius[j]
        overlaps[c] = radius[i] + radius[j] - d
