"""A list of pairs that is searched again only when bodies have moved far enough to need it (Verlet 1967).

The list has the pairs within a margin of what was asked for. If no body has moved by more than d since, two bodies
have come closer by at most 2d, so all pairs within reach are in the list as long as 2d is within the margin. They get
the exact test of the search, in the order of the list. The pairs are therefore those of a search.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.broad_phase.hierarchical_grid import HierarchicalGrid
from carom.physics.parallel.jit import long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MARGIN = 0.2  # of the smallest radius; 1.3 times as many pairs in a heap
LEAST_CALLS = 4  # that a list must be good for at the present pace; a list costs as much as one and a half searches
ROUNDING = 1e-14  # of the largest coordinate and distance; the test of a pair errs by some 1e-16


class PairList:
    """Finds the pairs of n spheres that touch, in open space; see `Search`.

    Parameters
    ----------
    grid
        Searches for the list.
    radius
        (n,) m
    """

    def __init__(self, grid: HierarchicalGrid, radius: FloatArray) -> None:
        self._grid, self._radius = grid, radius
        self._smallest, self._largest = float(radius.min()), float(radius.max())
        self._listed = np.empty((0, 2), dtype=np.int64)
        self._start = np.full((len(radius), 3), np.inf)  # m, positions for which the list was made, or of the last call
        self._scale, self._skin = 0.0, -np.inf  # within which the list has all pairs
        self._calls = 1  # since then
        _within_reach(self._listed, self._start, radius, 1.0, 0.0, self._listed)  # loads the kernel

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        moved, size = _farthest_move(position, self._start)
        wider = 2.0 * self._largest * max(0.0, scale - self._scale) + skin
        closer = 2.0 * moved + ROUNDING * (size + 2.0 * self._largest * scale + skin)
        if not wider + closer <= self._skin:
            margin = MARGIN * self._smallest
            pays = 2.0 * moved / self._calls * LEAST_CALLS <= margin
            np.copyto(self._start, position)
            self._calls = 1
            if not pays:
                self._skin = -np.inf
                return self._grid.pairs(position, scale, skin)
            self._scale, self._skin = scale, skin + margin
            self._listed = self._grid.pairs(position, self._scale, self._skin)
        self._calls += 1
        found = np.empty_like(self._listed)
        count = _within_reach(self._listed, position, self._radius, scale, skin, found)
        return found[:count].copy()


@long_kernel
def _farthest_move(position: FloatArray, start: FloatArray) -> tuple[float, float]:
    """Return the farthest distance of a body from its start, and the largest coordinate by magnitude, in m."""
    farthest, size = 0.0, 0.0
    for i in range(len(position)):
        d2 = 0.0
        for k in range(3):
            d = position[i, k] - start[i, k]
            d2 += d * d
            size = max(size, abs(position[i, k]))
        farthest = max(farthest, d2)
    return np.sqrt(farthest), size


@long_kernel
def _within_reach(
    listed: IntArray, position: FloatArray, radius: FloatArray, scale: float, skin: float, found: IntArray
) -> int:
    """Copy the listed pairs that are within reach, by the test of `hierarchical_grid.search`; return their number."""
    m = 0
    for c in range(len(listed)):
        i, j = listed[c, 0], listed[c, 1]
        dx, dy, dz = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
        touch = (radius[i] + radius[j]) * scale + skin
        if dx * dx + dy * dy + dz * dz <= touch * touch:
            found[m, 0], found[m, 1] = i, j
            m += 1
    return m
