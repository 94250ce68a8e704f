"""The bodies in the order of the cells of grids, one for each octave of radius.

The cells of an octave are as wide as its largest body, so that its bodies touch in neighbouring cells only. An octave
whose bodies would hardly ever share a cell joins the grid of the next larger one. Where a grid has few more cells than
bodies its cells are numbered row by row, and what is near in space is near in memory. Where it would have many more,
cells are wider, or they are hashed, so that a small cluster in a huge empty space costs what it holds and not what it
spans.

A row that is looked into costs as much as some bodies do. Where most cells are empty they are therefore broader across
the rows and shorter along them: fewer rows (10⁵ radii from 1 to 100: 10.7 instead of 13.2 ms). Crowds take a tenth
longer with such cells.

From step to step bodies hardly change cells. Sorted in the order of the step before they are read and written nearly in
order; to renumber the bodies themselves along a space-filling curve would gain nothing more.

Rejected: hashing always (what is near in space is then anywhere in memory), one width of cells for all radii (n²
candidates as soon as one body is huge).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.atomics import atomic_add
from carom.physics.parallel.jit import inline, kernel, long_kernel
from carom.physics.parallel.prefetch import AHEAD, prefetch
from carom.physics.parallel.thread_team import Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]

WIDER = 1.0 + 1e-6  # cells are wider than the bodies need, so that no rounding moves a neighbour out of reach
MOST_CELLS = 2**30  # along an axis: with more, the rounding of a cell's index nears that margin
ROOM = 16  # cells for each body, at most, that are numbered row by row
SPARSE = 2.5  # cells for each body, from which on they are
BROAD = 1.75  # times broader across rows, and shorter along them, so that there are as many
WIDE = 2.0  # times wider cells are tried where there would be more
SHARED = 0.5  # bodies in a cell, on average, up to which octaves share a grid
CROWDED = 1.0  # pairs in a cell for each body, from which on its octave neither joins others nor has wide cells again
STRIP = 64  # cells of a row that lie side by side where cells are hashed
UPWARDS = 8.0  # rows of cells that a small body meets in the grid of much larger ones, on average
SOME = 1000  # bodies that are worth a part of their own


class Octaves(NamedTuple):
    """The bodies by k octaves of radius, from the largest on."""

    diameter: FloatArray  # (k,) m, of the largest body, and a little more
    begins: IntArray  # (k + 1,) first body in the order of the table, and n
    crowded: NDArray[np.bool_]  # (k,) whether wide cells once held too many of them


class Layout(NamedTuple):
    """The g grids of a step, at most k, from that of the largest bodies on."""

    grids: IntArray  # (1,) g
    diameter: FloatArray  # (k,) m, of the largest body, and a little more
    begins: IntArray  # (k + 1,) first body of each grid in the order of the table, and n
    origin: FloatArray  # (3,) m, the corner from which cells are counted
    density: FloatArray  # (k, 3) cells in a metre
    cells: IntArray  # (k, 3) along each axis
    first: IntArray  # (k + 1,) first bucket of each grid, and the number of them all
    mask: IntArray  # (k,) the hashed part of a bucket's number, or -1 where cells are numbered row by row
    into: NDArray[np.bool_]  # (k, k) whether the bodies of a grid look into another
    box: FloatArray  # (3,) m, zeros in open space


class Table(NamedTuple):
    """The bodies of a step in the order of their buckets."""

    ends: Int32Array  # (buckets + 1,) first body of each, and n
    body: Int32Array  # (n,)
    sphere: FloatArray  # (n, 4) x, y, z, radius


class Cells:
    """Sorts n bodies into cells; keeps its tables from step to step.

    Parameters
    ----------
    radius
        (n,) m; they do not change.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    team
        Who sorts.
    """

    def __init__(self, radius: FloatArray, box: FloatArray, team: Team) -> None:
        n = len(radius)
        self._team = team
        self._radius = radius
        octave = np.unique(-np.frexp(radius / (radius.max() * WIDER))[1], return_inverse=True)[1]
        population = np.bincount(octave)
        k = len(population)
        self._octave = octave.astype(np.int16)
        self._octaves = Octaves(
            diameter=2.0 * WIDER * np.array([radius[octave == L].max() for L in range(k)]),
            begins=np.concatenate(([0], np.cumsum(population))).astype(np.int64),
            crowded=np.zeros(k, dtype=np.bool_),
        )
        self.layout = Layout(
            grids=np.zeros(1, dtype=np.int64),
            diameter=np.empty(k),
            begins=np.zeros(k + 1, dtype=np.int64),
            origin=np.zeros(3),
            density=np.zeros((k, 3)),
            cells=np.zeros((k, 3), dtype=np.int64),
            first=np.zeros(k + 1, dtype=np.int64),
            mask=np.zeros(k, dtype=np.int64),
            into=np.zeros((k, k), dtype=np.bool_),
            box=box,
        )
        ends = np.empty(ROOM * n + 2 * STRIP * k + 1, dtype=np.int32)
        self.table, self._spare = (Table(ends, np.empty(n, dtype=np.int32), np.empty((n, 4))) for _ in range(2))
        self._bucket, self._rank = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)

    def sort(self, position: FloatArray, stretch: float, slack: float) -> Table:
        """Return the table of bodies at (n, 3) m, in cells as wide as (r_i + r_j) stretch + slack."""
        before, table, layout, n = self.table, self._spare, self.layout, len(position)
        extent = _span(position, layout.origin, layout.box)
        if _lay(extent, stretch, slack, self._octaves, layout):
            before.body[:] = np.argsort(self._octave, kind="stable")
            before.sphere[:, 3] = self._radius[before.body]
        table.ends[: layout.first[layout.grids[0]] + 1] = 0
        self._team.divide(n, SOME, _assign, position, layout, before, self._bucket, self._rank)
        _add_up(table.ends, self._octaves, layout)
        self._team.divide(n, SOME, _move, before, self._bucket, self._rank, table)
        self.table, self._spare = table, before
        return table


@kernel
def _span(position: FloatArray, origin: FloatArray, box: FloatArray) -> tuple[float, float, float]:
    """Write where cells are counted from; return the extent of the bodies, or of the box, in m."""
    if box[0] > 0.0:
        for k in range(3):
            origin[k] = -0.5 * box[k]
        return box[0], box[1], box[2]
    x0, y0, z0 = position[0, 0], position[0, 1], position[0, 2]
    x1, y1, z1 = x0, y0, z0
    for i in range(len(position)):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        x0, y0, z0 = min(x0, x), min(y0, y), min(z0, z)
        x1, y1, z1 = max(x1, x), max(y1, y), max(z1, z)
    origin[0], origin[1], origin[2] = x0, y0, z0
    return x1 - x0, y1 - y0, z1 - z0


@kernel
def _lay(extent: tuple[float, float, float], stretch: float, slack: float, octaves: Octaves, layout: Layout) -> bool:
    """Lay the grids, and say which bodies look into which of them.

    Returns
    -------
    anew
        Whether octaves share grids in another way than before: bodies then have to be put in their order again.
    """
    grids, diameter, begins, _, density, _, first, mask, into, _ = layout
    g, cells, anew = 0, 0.0, False
    for L in range(len(octaves.diameter)):
        end = octaves.begins[L + 1]
        if g == 0 or end - begins[g - 1] > SHARED * cells or octaves.crowded[L]:
            anew = anew or begins[g] != octaves.begins[L]
            diameter[g], begins[g] = octaves.diameter[L], octaves.begins[L]
            cells = _cut(diameter[g] * stretch + slack, 1.0, g, extent, layout)
            g += 1
    anew = anew or grids[0] != g
    grids[0], begins[g] = g, octaves.begins[len(octaves.diameter)]
    for L in range(g):
        bodies, width = begins[L + 1] - begins[L], diameter[L] * stretch + slack
        room, crowded = ROOM * bodies + STRIP, octaves.crowded[np.searchsorted(octaves.begins, begins[L])]
        cells = _cut(width, 1.0, L, extent, layout)
        broader = BROAD if cells > SPARSE * bodies and not crowded else 1.0
        cells = _cut(width, broader, L, extent, layout)
        if cells > room and not crowded:
            cells = _cut(WIDE * width, broader, L, extent, layout)
        if cells <= room:
            first[L + 1], mask[L] = first[L] + np.int64(cells), -1
        else:
            _cut(width, 1.0, L, extent, layout)
            hashed = STRIP
            while hashed < 2 * bodies:
                hashed *= 2
            first[L + 1], mask[L] = first[L] + hashed + STRIP, hashed - 1
    for large in range(g):
        into[large, large] = True
        for small in range(large + 1, g):
            rows = (diameter[large] * density[small, 1] + 2.0) * (diameter[large] * density[small, 2] + 2.0)
            down = (begins[large + 1] - begins[large]) * rows
            into[large, small] = down < (begins[small + 1] - begins[small]) * UPWARDS
            into[small, large] = not into[large, small]
    return anew


@kernel
def _cut(width: float, broader: float, L: int, extent: tuple[float, float, float], layout: Layout) -> float:
    """Cut a grid into cells of a width, or a little more, broader across the rows and shorter along them.

    Returns
    -------
    cells
        How many there are.
    """
    cells = 1.0
    for k in range(3):
        size = width / (broader * broader) if k == 0 else width * broader
        if layout.box[0] > 0.0:
            layout.cells[L, k] = np.int64(min(max(1.0, np.floor(extent[k] / size)), MOST_CELLS))
            layout.density[L, k] = layout.cells[L, k] / extent[k]
        else:
            layout.density[L, k] = 1.0 / max(size, extent[k] / MOST_CELLS)
            layout.cells[L, k] = np.int64(extent[k] * layout.density[L, k]) + 1
        cells *= layout.cells[L, k]
    return cells


@inline
def strip_of(ix: int, iy: int, iz: int) -> int:
    """Spread the strips of rows over a table: Knuth's multiplicative hash, its upper half."""
    return (((iz * (2 * MOST_CELLS) + iy) * 0x1E3779B97F4A7C15 + ix // STRIP) * 0x1E3779B97F4A7C15) >> 32


@long_kernel
def _assign(
    lo: int,
    hi: int,
    position: FloatArray,
    layout: Layout,
    before: Table,
    bucket: Int32Array,
    rank: Int32Array,
) -> None:
    """Find the bucket of each body, and how many others are in it already; which are, is left to chance."""
    _, _, begins, origin, density, count, first, mask, _, box = layout
    ends, body, sphere = before
    L, last = 0, len(body) - 1
    for k in range(lo, hi):
        prefetch(position, body[min(last, k + AHEAD)], 0)
        while k >= begins[L + 1]:
            L += 1
        i = body[k]
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        sphere[k, 0], sphere[k, 1], sphere[k, 2] = x, y, z
        ix = math.floor((x - origin[0]) * density[L, 0])
        iy = math.floor((y - origin[1]) * density[L, 1])
        iz = math.floor((z - origin[2]) * density[L, 2])
        if box[0] > 0.0:
            ix, iy, iz = ix % count[L, 0], iy % count[L, 1], iz % count[L, 2]
        if mask[L] < 0:
            b = first[L] + (iz * count[L, 1] + iy) * count[L, 0] + ix
        else:
            b = first[L] + (strip_of(ix, iy, iz) & mask[L]) + ix % STRIP
        bucket[k] = b
        rank[k] = atomic_add(ends, b, np.int32(1))


@kernel
def _add_up(ends: Int32Array, octaves: Octaves, layout: Layout) -> None:
    """Turn how many bodies each bucket holds into where they begin; take note of octaves that are crowded."""
    total = np.int32(0)
    for L in range(layout.grids[0]):
        pairs = 0
        for b in range(layout.first[L], layout.first[L + 1]):
            held = ends[b]
            ends[b] = total
            total += held
            pairs += held * (held - 1)
        lo, hi = layout.begins[L], layout.begins[L + 1]
        if 0.5 * pairs > CROWDED * (hi - lo):
            for k in range(len(octaves.diameter)):
                if lo <= octaves.begins[k] < hi:
                    octaves.crowded[k] = True
    ends[layout.first[layout.grids[0]]] = total


@long_kernel
def _move(lo: int, hi: int, before: Table, bucket: Int32Array, rank: Int32Array, table: Table) -> None:
    """Move the bodies to their places."""
    ends, body, sphere = table
    for k in range(lo, hi):
        slot = ends[bucket[k]] + rank[k]
        body[slot] = before.body[k]
        for axis in range(4):
            sphere[slot, axis] = before.sphere[k, axis]
