"""Coarse-graining on a grid: bodies and contacts become densities that are constant in each cell.

The method is Goldhirsch's, Granular Matter 12, 239 (2010). Its function φ(r - r') is 1/V if r' is in the cell of r,
whose volume is V, and 0 elsewhere. It is the only φ that needs no bodies beyond a wall and makes sums over the cells
exactly equal to sums over the bodies. Contacts transfer momentum along branch vectors. A branch vector counts in each
cell with the fraction of its length that lies in the cell: this is the integral of φ along the vector.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.scene.schema.shear import Shear


@dataclass(frozen=True)
class Grid:
    """Equal cells that fill a box; along periodic axes they repeat."""

    origin: FloatArray  # (3,) m, the corner with the lowest coordinates
    cell: FloatArray  # (3,) m, edges of each cell
    shape: tuple[int, int, int]  # cells along x, y and z
    periodic: tuple[bool, bool, bool]
    shear: Shear | None = None  # shear of the periodic box

    @cached_property
    def count(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    @cached_property
    def volume(self) -> float:
        """Volume of a cell, m³."""
        return float(np.prod(self.cell))

    @cached_property
    def size(self) -> FloatArray:
        """Edges of the whole grid, (3,) m."""
        return self.cell * self.shape

    def centres(self, axis: int) -> FloatArray:
        """Return the coordinates (m) of the cells' centres along an axis."""
        return np.asarray(self.origin[axis] + self.cell[axis] * (np.arange(self.shape[axis]) + 0.5))

    def shift(self, time: FloatArray) -> FloatArray:
        """Return how far (m) the next image of a sheared box is displaced along the flow, at some times (s)."""
        shear = self.shear
        assert shear is not None, "only a sheared box has images that move"
        flow, gradient = shear.axes
        path, width = shear.rate * self.size[gradient] * time, self.size[flow]
        return np.asarray(path - width * np.floor(path / width + 0.5))

    def cells(self, point: FloatArray, time: FloatArray) -> IntArray:
        """Return the numbers of the cells that contain points, (k, 3) m, at times (k,) s; bodies on a face count once.

        A body that overlaps a wall may have its centre outside a face that is not periodic; it then counts in the cell
        inside that face.
        """
        place = point - self.origin
        if self.shear is not None:
            flow, gradient = self.shear.axes
            place[:, flow] -= np.floor(place[:, gradient] / self.size[gradient]) * self.shift(time)
        number = np.zeros(len(point), np.int64)
        for axis, count in enumerate(self.shape):
            along = np.floor(place[:, axis] / self.cell[axis]).astype(np.int64)
            along = along % count if self.periodic[axis] else np.clip(along, 0, count - 1)
            number = number * count + along
        return number

    def cut(self, start: FloatArray, reach: FloatArray, time: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Cut branch vectors at the faces of the cells.

        Parameters
        ----------
        start, reach
            Starting points of the branch vectors, and the vectors themselves, (k, 3) m each.
        time
            Time of each vector, (k,) s.

        Returns
        -------
        branch, cell, fraction
            For each piece, (p,): the row of its branch, the number of its cell, and its fraction of the branch's
            length.
        """
        ends = [np.zeros(len(start)), np.ones(len(start))]
        for axis in range(3):
            first = (start[:, axis] - self.origin[axis]) / self.cell[axis]
            offsets = [np.zeros(len(start))]
            # the cells of both neighbouring images along the gradient are displaced along the flow
            if self.shear is not None and axis == self.shear.axes[0]:
                moved = self.shift(time) / self.cell[axis]
                offsets += [moved, -moved]
            for offset in offsets:
                ends += _crossings(first - offset, reach[:, axis] / self.cell[axis])
        cuts = np.sort(np.stack(ends, axis=1), axis=1)
        fraction = np.diff(cuts, axis=1)
        branch, piece = np.nonzero(fraction)
        middle = (cuts[branch, piece] + cuts[branch, piece + 1]) / 2
        cell = self.cells(start[branch] + middle[:, None] * reach[branch], time[branch])
        return branch, cell, fraction[branch, piece]


def _crossings(first: FloatArray, reach: FloatArray) -> list[FloatArray]:
    """Return where lines cross whole numbers, as fractions of their reach, padded with ones."""
    low = np.floor(np.minimum(first, first + reach)) + 1.0
    most = int(np.max(np.ceil(np.maximum(first, first + reach)) - low, initial=0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = [np.nan_to_num((low + number - first) / reach, nan=1.0) for number in range(most)]
    return [np.clip(each, 0.0, 1.0) for each in found]


class Branches(NamedTuple):
    """Branch vectors: lines along which contacts transfer momentum between moving bodies, or to a wall's surface."""

    start: FloatArray  # (k, 3) m
    reach: FloatArray  # (k, 3) m
    impulse: FloatArray  # (k, 3) N s, impulse towards the end
    time: FloatArray  # (k,) s

    @classmethod
    def of(
        cls,
        start: FloatArray,
        whole: FloatArray,
        impulse: FloatArray,
        time: FloatArray,
        share: FloatArray,
        moves: tuple[BoolArray, BoolArray],
    ) -> Branches:
        """Leave out the part of each line inside a fixed body, since that body is a wall (Weinhart et al. 2012).

        Parameters
        ----------
        start, whole
            Centre of body i, (k, 3) m, and vector to the centre of body j, or to the surface of a plane or wall.
        impulse
            Impulse on body j, (k, 3) N s.
        time
            Time of each line, (k,) s.
        share
            Fraction of the vector inside body i, (k,); 1 at a plane or wall.
        moves
            Whether i and whether j are bodies that move, (k,) each.
        """
        low, high = np.where(moves[0], 0.0, share), np.where(moves[1], 1.0, share)
        kept = high > low
        start, whole, low, high = start[kept], whole[kept], low[kept, None], high[kept, None]
        return cls(start + low * whole, (high - low) * whole, impulse[kept], time[kept])


class BodySums:
    """Sums over moving bodies at several moments, by cell."""

    def __init__(self, grid: Grid) -> None:
        self.grid, self.moments = grid, 0
        self.number = np.zeros(grid.count)
        self.volume = np.zeros(grid.count)  # m³
        self.mass = np.zeros(grid.count)  # kg
        self.momentum = np.zeros((grid.count, 3))  # kg m/s
        self.kinetic = np.zeros((grid.count, 3, 3))  # J, Σ m c ⊗ c about the mean velocity of the cell so far
        # number of contacts of the cell's bodies, at moments when contacts are known
        self.contacts = np.zeros(grid.count)

    def add(
        self, position: FloatArray, velocity: FloatArray, mass: FloatArray, radius: FloatArray, time: float
    ) -> IntArray:
        """Add bodies at a time (s): positions, velocities (n, 3), masses and radii (n,), all in SI; return their cells.

        Sums of squares are about the mean, and sums at two times are combined as in Chan, Golub & LeVeque (1983). The
        rounding of a common velocity then does not change a temperature.
        """
        cell = self.grid.cells(position, np.full(len(position), time))
        used, place = np.unique(cell, return_inverse=True)

        def summed(values: FloatArray) -> FloatArray:
            return np.bincount(place, values, len(used)).astype(np.float64)

        own = summed(mass)
        carried = np.stack([summed(mass * velocity[:, a]) for a in range(3)], axis=1)
        mean = carried / own[:, None]
        about = velocity - mean[place]
        before = self.mass[used]
        with np.errstate(invalid="ignore"):
            moved = np.where(before[:, None] > 0.0, self.momentum[used] / before[:, None] - mean, 0.0)
        joined = (before * own / (before + own))[:, None, None] * moved[:, :, None] * moved[:, None, :]
        for a in range(3):
            for b in range(3):
                joined[:, a, b] += summed(mass * about[:, a] * about[:, b])
        self.kinetic[used] += joined
        self.number[used] += summed(np.ones(len(cell)))
        self.volume[used] += summed(4.0 / 3.0 * np.pi * radius**3)
        self.mass[used] += own
        self.momentum[used] += carried
        self.moments += 1
        return cell


def add_transferred(total: FloatArray, grid: Grid, branches: Branches) -> None:
    """Add Σ ℓ ⊗ J of branch vectors to sums over cells, (cells, 3, 3) J; ℓ is a vector's part inside the cell."""
    if len(branches.start):
        row, cell, fraction = grid.cut(branches.start, branches.reach, branches.time)
        used, place = np.unique(cell, return_inverse=True)
        reach, impulse = fraction[:, None] * branches.reach[row], branches.impulse[row]
        for a in range(3):
            for b in range(3):
                total[used, a, b] += np.bincount(place, reach[:, a] * impulse[:, b], len(used))
