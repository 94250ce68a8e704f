"""Broad phase: a hashed grid for each octave of radius, and the exact test on what its cells hold.

A body lies in a cell of its own octave's grid, whose cells are as wide as the largest body of that octave. It can
then touch bodies of its octave in the 27 cells around it only, and bodies of a larger octave in the few cells that its
reach meets. Each pair is found once: by the smaller body, or within an octave from the cell that comes first.

Cells are hashed, so that a small cluster in a huge empty space costs what it holds and not what it spans. The cells of
a row along x lie side by side in the table and are scanned in one go. Rejected: a dense grid (blows up with empty
space), one width of cells for all radii (n² candidates as soon as one body is huge), a table lookup for each of the 27
cells (twice as slow).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import inline, kernel, long_kernel
from carom.physics.machine import atomic_add
from carom.physics.team import Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

WIDER = 1.0 + 1e-6  # cells are wider than the bodies need, so that no rounding moves a neighbour out of reach
MOST_CELLS = 2**30  # along an axis: with more, the rounding of a cell's index nears that margin
SMALLEST_TABLE = 16
CLAIM = 256  # rows of the buffer that a searcher claims at a time


class Grid:
    """Finds the pairs of n spheres that touch; keeps its tables from step to step.

    Parameters
    ----------
    radius
        (n,) m; they do not change.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    team
        Who searches; nobody but the caller if left out.
    """

    def __init__(self, radius: FloatArray, box: FloatArray, team: Team | None = None) -> None:
        n = len(radius)
        self._team = team or Team(1)
        self._radius = radius
        self._box = box
        octave = np.frexp(radius / (radius.max() * WIDER))[1]
        _, level = np.unique(-octave, return_inverse=True)  # 0 is the octave of the largest bodies
        population = np.bincount(level)
        tables = np.array([max(SMALLEST_TABLE, 1 << (2 * int(count) - 1).bit_length()) for count in population])
        self._level = level.astype(np.int64)
        self._diameter = np.array([2.0 * radius[level == k].max() * WIDER for k in range(len(population))])
        self._table = np.column_stack((np.cumsum(tables) - tables, tables)).astype(np.int64)  # first bucket, buckets
        self._origin = np.zeros(3)  # m, the corner from which cells are counted
        self._density = np.zeros((len(population), 3))  # cells in a metre
        self._count = np.zeros((len(population), 3), dtype=np.int64)  # cells along each axis of a periodic box
        self._buckets = np.empty(n, dtype=np.int64)
        self._ends = np.zeros(int(tables.sum()) + 2, dtype=np.int64)
        self._bodies = np.empty(n, dtype=np.int64)  # in the order of the table, like the two below
        self._cells = np.empty((n, 3), dtype=np.int64)  # x, row, level
        self._spheres = np.empty((n, 4))  # x, y, z, radius
        self._counts = np.zeros(n + 1, dtype=np.int64)
        self._taken = np.zeros(1, dtype=np.int64)  # rows of the buffer that searchers have claimed
        self._found = np.empty((2, 2 * n + 64, 2), dtype=np.int64)  # pairs, and room to sort them

    def pairs(self, position: FloatArray, stretch: float = 1.0, slack: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) stretch + slack``, (m, 2), sorted by (i, j).

        Parameters
        ----------
        position
            (n, 3) m, finite; in a periodic box anywhere, not only inside.
        stretch
            At least 1.
        slack
            m, not negative.
        """
        m = self._find(position, stretch, slack)
        if self._taken[0] > self._found.shape[1]:
            self._found = np.empty((2, 3 * self._taken[0] // 2, 2), dtype=np.int64)
            m = self._find(position, stretch, slack)
        return self._found[0, :m].copy()

    def _find(self, position: FloatArray, stretch: float, slack: float) -> int:
        """Fill the first half of the buffer; return how many pairs there are, if they fitted."""
        ends, bodies, cells, spheres = self._ends, self._bodies, self._cells, self._spheres
        taken, found = self._taken, self._found
        _lay(position, self._box, self._diameter, stretch, slack, self._origin, self._density, self._count)
        _fill(
            position,
            self._radius,
            self._level,
            self._table,
            self._origin,
            self._density,
            self._count,
            self._buckets,
            ends,
            bodies,
            cells,
            spheres,
        )
        taken[0] = 0
        grids = (self._diameter, self._table, self._origin, self._density, stretch, slack, taken, found)
        if self._box[0] > 0.0:
            self._team.divide(len(bodies), _search_box, ends, bodies, cells, spheres, self._box, self._count, *grids)
        else:
            self._team.divide(len(bodies), _search, ends, bodies, cells, spheres, *grids)
        m: int = _sort_pairs(taken[0], found, self._counts)
        return m


@kernel
def _lay(
    position: FloatArray,
    box: FloatArray,
    diameter: FloatArray,
    stretch: float,
    slack: float,
    origin: FloatArray,
    density: FloatArray,
    count: IntArray,
) -> None:
    """Lay the grids: the corner, and for each octave how many cells a metre has and, in a box, how many there are."""
    for k in range(3):
        least, most = position[0, k], position[0, k]
        for i in range(len(position)):
            least, most = min(least, position[i, k]), max(most, position[i, k])
        origin[k] = -0.5 * box[k] if box[k] > 0.0 else least
        for L in range(len(diameter)):
            width = diameter[L] * stretch + slack
            if box[k] > 0.0:
                count[L, k] = np.int64(min(max(1.0, np.floor(box[k] / width)), MOST_CELLS))
                density[L, k] = count[L, k] / box[k]
            else:
                density[L, k] = 1.0 / max(width, (most - least) / MOST_CELLS)


@inline
def _cell(offset: float, density: float, count: int) -> int:
    cell = math.floor(offset * density)
    return cell % count if count > 0 else cell


@inline
def _row(iy: int, iz: int) -> int:
    return iy * (2 * MOST_CELLS) + iz


@inline
def _hashed(row: int) -> int:
    """Spread the rows over the table: Knuth's multiplicative hash, its upper half."""
    return (row * 0x1E3779B97F4A7C15) >> 32


@kernel
def _fill(
    position: FloatArray,
    radius: FloatArray,
    level: IntArray,
    table: IntArray,
    origin: FloatArray,
    density: FloatArray,
    count: IntArray,
    buckets: IntArray,
    ends: IntArray,
    bodies: IntArray,
    cells: IntArray,
    spheres: FloatArray,
) -> None:
    """Sort the bodies into the table: bucket b holds ``bodies[ends[b + 1]:ends[b + 2]]``, in rising order."""
    for b in range(len(ends)):
        ends[b] = 0
    for i in range(len(radius)):
        L = level[i]
        ix = _cell(position[i, 0] - origin[0], density[L, 0], count[L, 0])
        iy = _cell(position[i, 1] - origin[1], density[L, 1], count[L, 1])
        iz = _cell(position[i, 2] - origin[2], density[L, 2], count[L, 2])
        buckets[i] = table[L, 0] + ((_hashed(_row(iy, iz)) + ix) & (table[L, 1] - 1))
        ends[buckets[i] + 1] += 1
    for b in range(1, len(ends)):
        ends[b] += ends[b - 1]
    for i in range(len(radius) - 1, -1, -1):
        L = level[i]
        ends[buckets[i] + 1] -= 1
        slot = ends[buckets[i] + 1]
        bodies[slot] = i
        for k in range(3):
            spheres[slot, k] = position[i, k]
        spheres[slot, 3] = radius[i]
        iy = _cell(position[i, 1] - origin[1], density[L, 1], count[L, 1])
        iz = _cell(position[i, 2] - origin[2], density[L, 2], count[L, 2])
        cells[slot, 0] = _cell(position[i, 0] - origin[0], density[L, 0], count[L, 0])
        cells[slot, 1] = _row(iy, iz)
        cells[slot, 2] = L


@long_kernel
def _search(
    lo: int,
    hi: int,
    ends: IntArray,
    bodies: IntArray,
    cells: IntArray,
    spheres: FloatArray,
    diameter: FloatArray,
    table: IntArray,
    origin: FloatArray,
    density: FloatArray,
    stretch: float,
    slack: float,
    taken: IntArray,
    found: IntArray,
) -> None:
    """Note the pairs of bodies [lo, hi) of the table in open space: each against the rows of cells within its reach.

    The distance is compared first: nearly all that a row's buckets hold is near. Only what touches has to prove that
    it lies in the row, and not in another one with the same hash, where it is or was found, too.
    """
    m, end = 0, 0
    for a in range(lo, hi):
        x, y, z, r = spheres[a, 0], spheres[a, 1], spheres[a, 2], spheres[a, 3]
        for L in range(cells[a, 2] + 1):
            after = a + 1 if cells[a, 2] == L else 0  # within an octave each pair once
            first, buckets = table[L, 0], table[L, 1]
            reach = WIDER * ((r + 0.5 * diameter[L]) * stretch + slack)
            fx, lx = _span(x - origin[0], reach, density[L, 0])
            fy, ly = _span(y - origin[1], reach, density[L, 1])
            fz, lz = _span(z - origin[2], reach, density[L, 2])
            for iz in range(fz, lz):
                for iy in range(fy, ly):
                    row = _row(iy, iz)
                    start = (_hashed(row) + fx) & (buckets - 1)
                    whole = min(lx - fx, buckets - start)
                    for part in range(2):  # the row's buckets, and those beyond the end of the table, from its start
                        lo = first + start if part == 0 else first
                        hi = lo + whole if part == 0 else lo + (lx - fx - whole)
                        for b in range(max(after, ends[lo + 1]), ends[hi + 1]):
                            dx, dy, dz = spheres[b, 0] - x, spheres[b, 1] - y, spheres[b, 2] - z
                            touch = (r + spheres[b, 3]) * stretch + slack
                            near = dx * dx + dy * dy + dz * dz <= touch * touch
                            if near and cells[b, 1] == row and fx <= cells[b, 0] < lx:
                                m, end = _note(bodies[a], bodies[b], taken, found, m, end)
    _leave(found, m, end)


@long_kernel
def _search_box(
    lo: int,
    hi: int,
    ends: IntArray,
    bodies: IntArray,
    cells: IntArray,
    spheres: FloatArray,
    box: FloatArray,
    count: IntArray,
    diameter: FloatArray,
    table: IntArray,
    origin: FloatArray,
    density: FloatArray,
    stretch: float,
    slack: float,
    taken: IntArray,
    found: IntArray,
) -> None:
    """Note the pairs of bodies [lo, hi) in a periodic box, cell by cell; where it is narrow no cell twice."""
    m, end = 0, 0
    for a in range(lo, hi):
        x, y, z, r = spheres[a, 0], spheres[a, 1], spheres[a, 2], spheres[a, 3]
        for L in range(cells[a, 2] + 1):
            after = a + 1 if cells[a, 2] == L else 0
            reach = WIDER * ((r + 0.5 * diameter[L]) * stretch + slack)
            fx, lx = _span(x - origin[0], reach, density[L, 0])
            fy, ly = _span(y - origin[1], reach, density[L, 1])
            fz, lz = _span(z - origin[2], reach, density[L, 2])
            for iz in range(fz, min(lz, fz + count[L, 2])):
                for iy in range(fy, min(ly, fy + count[L, 1])):
                    row = _row(iy % count[L, 1], iz % count[L, 2])
                    for ix in range(fx, min(lx, fx + count[L, 0])):
                        cell = ix % count[L, 0]
                        bucket = table[L, 0] + ((_hashed(row) + cell) & (table[L, 1] - 1))
                        for b in range(max(after, ends[bucket + 1]), ends[bucket + 2]):
                            dx, dy, dz = spheres[b, 0] - x, spheres[b, 1] - y, spheres[b, 2] - z
                            dx -= box[0] * np.floor(dx / box[0] + 0.5)
                            dy -= box[1] * np.floor(dy / box[1] + 0.5)
                            dz -= box[2] * np.floor(dz / box[2] + 0.5)
                            touch = (r + spheres[b, 3]) * stretch + slack
                            near = dx * dx + dy * dy + dz * dz <= touch * touch
                            if near and cells[b, 1] == row and cells[b, 0] == cell:
                                m, end = _note(bodies[a], bodies[b], taken, found, m, end)
    _leave(found, m, end)


@inline
def _span(offset: float, reach: float, density: float) -> tuple[int, int]:
    """Return the first cell that a reach meets along an axis, and the one after the last."""
    return math.floor((offset - reach) * density), math.floor((offset + reach) * density) + 1


@inline
def _note(i: int, j: int, taken: IntArray, found: IntArray, m: int, end: int) -> tuple[int, int]:
    """Write a pair into row m, or a row of new ones if that is the end; return the next row, and the end."""
    if m == end:
        m = atomic_add(taken, 0, CLAIM)
        end = m + CLAIM
    if m < found.shape[1]:
        found[0, m, 0] = min(i, j)
        found[0, m, 1] = max(i, j)
    return m + 1, end


@kernel
def _leave(found: IntArray, m: int, end: int) -> None:
    """Mark the rows that were claimed but not needed."""
    for row in range(m, min(end, found.shape[1])):
        found[0, row, 1] = -1


@kernel
def _sort_pairs(rows: int, found: IntArray, counts: IntArray) -> int:
    """Sort what the rows hold by (i, j), if they are all there: by j into the second half of the buffer, by i back.

    Returns
    -------
    m
        How many pairs they hold.
    """
    if rows > found.shape[1]:
        return 0
    m = _sort_by(1, rows, found[0], found[1], counts)
    return _sort_by(0, m, found[1], found[0], counts)


@kernel
def _sort_by(end: int, rows: int, pairs: IntArray, ordered: IntArray, counts: IntArray) -> int:
    """Sort by one of the ends, keeping the order of equals and leaving out what is no pair; return how many are."""
    for i in range(len(counts)):
        counts[i] = 0
    for c in range(rows):
        if pairs[c, 1] >= 0:
            counts[pairs[c, end] + 1] += 1
    for i in range(1, len(counts)):
        counts[i] += counts[i - 1]
    m: int = counts[len(counts) - 1]
    for c in range(rows):
        if pairs[c, 1] >= 0:
            slot = counts[pairs[c, end]]
            counts[pairs[c, end]] += 1
            ordered[slot, 0], ordered[slot, 1] = pairs[c, 0], pairs[c, 1]
    return m
