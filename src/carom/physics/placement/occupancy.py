"""Which places accepted spheres leave free: a fast test of many candidates.

Two grids cover the region. In the coarse one a cell holds at most one centre, since accepted spheres do not overlap. In
the fine one a cell is marked if every centre in it would overlap an accepted sphere; a look at its own cell rejects
most candidates. The others are tested exactly against the centres in the cells around them, so the result is that of a
search through all spheres, bit by bit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.physics.placement.neighbours import squared_distance

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

FINE_CELL = 0.34  # of the smallest radius
MOST_CELLS = 100_000_000  # of the fine grid, one byte each
MOST_CELLS_PER_BODY = 4000  # a region with more is nearly empty: few candidates collide, and a search is quick
MARGIN = 1.0 + 1e-9  # for the rounding of positions of cells
PART = 4096  # spheres that are accepted together, some 10 MB of cells
CELLS_AT_ONCE = 16  # that are looked into; most candidates touch something in the first of them


class _Grid:
    """Cells of one edge length around a region, with enough of them around it for all offsets."""

    def __init__(self, low: FloatArray, high: FloatArray, cell: float, reach: float) -> None:
        self.cell = cell
        margin = math.ceil(reach / cell) + 1
        self._low = low - margin * cell
        self.shape = np.ceil((high - low) / cell).astype(np.int64) + 2 * margin + 1

    @property
    def size(self) -> int:
        """How many cells there are."""
        return math.prod(self.shape.tolist())

    def cells(self, position: FloatArray) -> IntArray:
        """Return the cell of each position, (k,)."""
        at = ((position - self._low) / self.cell).astype(np.int64)
        return np.asarray((at[:, 0] * self.shape[1] + at[:, 1]) * self.shape[2] + at[:, 2])

    def offsets(self, nearest: float, farthest: float) -> IntArray:
        """Return offsets to cells around one whose points have distances to its points in a range, the nearest first.

        Parameters
        ----------
        nearest
            m; two points of both cells may be as close as this.
        farthest
            m; no two points of both cells are farther apart.
        """
        steps = math.ceil(nearest / self.cell) + 1
        line = np.arange(-steps, steps + 1)
        x, y, z = (axis.ravel() for axis in np.meshgrid(line, line, line, indexing="ij"))
        apart = [np.maximum(np.abs(axis) - 1, 0) * self.cell for axis in (x, y, z)]
        across = [(np.abs(axis) + 1) * self.cell for axis in (x, y, z)]
        near = sum(axis * axis for axis in apart) <= (nearest * MARGIN) ** 2
        inside = sum(axis * axis for axis in across) * MARGIN**2 <= farthest**2
        chosen = near & inside
        order = np.argsort((x * x + y * y + z * z)[chosen], kind="stable")
        return np.asarray(((x * self.shape[1] + y) * self.shape[2] + z)[chosen][order])


class Occupancy:
    """The accepted spheres of one size class, whose radii differ by less than a factor of two.

    Parameters
    ----------
    low, high
        (3,) m, corners of the region.
    radius
        (n,) m, of all spheres of the class.
    """

    def __init__(self, low: FloatArray, high: FloatArray, radius: FloatArray) -> None:
        self._smallest, reach = float(radius.min()), 2.0 * float(radius.max())
        self._coarse = _Grid(low, high, 2.0 * self._smallest / (math.sqrt(3.0) * MARGIN), reach)
        self._fine = _Grid(low, high, FINE_CELL * self._smallest, reach)
        self._around = self._coarse.offsets(reach, math.inf)
        self._covered = self._fine.offsets(reach, 2.0 * self._smallest)
        self._owner = np.full(self._coarse.size, -1, dtype=np.int32)
        self._taken = np.zeros(self._fine.size, dtype=np.bool_)
        self._position = np.empty((0, 3))
        self._radius = np.empty(0)

    @staticmethod
    def pays(low: FloatArray, high: FloatArray, radius: FloatArray) -> bool:
        """Tell whether the grids are small enough for the memory and for the number of spheres."""
        cells = math.prod(((high - low) / (FINE_CELL * radius.min()) + 12.0).tolist())
        return bool(cells < min(MOST_CELLS, MOST_CELLS_PER_BODY * len(radius)))

    def add(self, position: FloatArray, radius: FloatArray) -> None:
        """Accept spheres that touch none of those before."""
        first = len(self._position)
        self._owner[self._coarse.cells(position)] = np.arange(first, first + len(position))
        cells = self._fine.cells(position)
        for lo in range(0, len(cells), PART):
            self._taken[cells[lo : lo + PART, None] + self._covered] = True
        self._position = np.concatenate((self._position, position))
        self._radius = np.concatenate((self._radius, radius))

    def touches(self, position: FloatArray, radius: FloatArray) -> Flags:
        """Tell which candidates touch or overlap an accepted sphere, (k,)."""
        touching = self._taken[self._fine.cells(position)]
        left = np.flatnonzero(~touching)
        cells = self._coarse.cells(position[left])
        for first in range(0, len(self._around), CELLS_AT_ONCE):
            owner = self._owner[cells[:, None] + self._around[first : first + CELLS_AT_ONCE]]
            row, column = np.nonzero(owner >= 0)
            i, j = left[row], owner[row, column]
            hit = squared_distance(position[i], self._position[j], None) <= (radius[i] + self._radius[j]) ** 2
            touching[i[hit]] = True
            still = ~touching[left]
            left, cells = left[still], cells[still]
        return touching
