"""Bodies sorted into the cells of grids, one grid for each octave of radius.

The cells of an octave are as wide as its largest body, so its bodies touch only bodies in neighbouring cells. An octave
whose bodies would hardly ever share a cell uses the grid of the next larger octave. If a grid has only a few times as
many cells as bodies, its cells are numbered row by row, and neighbours in space are neighbours in memory. If it would
have many more cells, they are widened or hashed. The cost of a small cluster in a huge empty space then depends on its
bodies, not on its extent.

Visiting a row of cells costs as much as testing some bodies. Where most cells are empty, they are therefore broader
across the rows and shorter along the rows, which makes fewer rows (10⁵ radii from 1 to 100: 10.7 instead of 13.2 ms).
In dense regions such cells cost a tenth more.

Bodies rarely change cells from step to step, so a sort that starts from the order of the previous step reads and writes
them nearly in order. Renumbering the bodies along a space-filling curve would gain nothing more.

Rejected: always hashing (neighbours in space are then anywhere in memory); one cell width for all radii (n² candidates
as soon as one body is huge).
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import BoolArray, FloatArray, Int32Array, IntArray, RecordArray, dtype_of
from carom.physics.jit.decorators import inline, kernel, long_kernel
from carom.physics.jit.instructions import AHEAD, atomic_add, prefetch
from carom.physics.jit.team import Team
from carom.physics.vector import Vector, is_periodic, sizes, vector
from carom.scene.portable_math import ENDLESS

WIDER = 1.0 + 1e-6  # margin of the cell width, so that rounding cannot move a neighbour beyond the neighbouring cells
MOST_CELLS = 2**30  # limit on cells along an axis; with more, the rounding of a cell index would exceed `WIDER`
MAX_CELLS_PER_BODY = 16  # largest number of cells per body in a grid that is numbered row by row
SPARSE = 2.5  # number of cells per body above which cells are broader across rows
BROAD = 1.75  # factor on the width of cells across rows; the length of cells along rows is divided by its square
WIDE = 2.0  # factor on the cell width if a grid would otherwise exceed `MAX_CELLS_PER_BODY`
MAX_SHARED_BODIES = 0.5  # bodies per cell above which octaves do not share a grid
MAX_PAIRS_PER_BODY = 1.0  # pairs per body within cells, above which an octave gets its own cells of the smallest width
STRIP = 64  # length of a strip: cells that are neighbours in a row, and also in a hashed table
MAX_ROWS_PER_BODY = 8.0  # mean number of rows that a small body searches in the grid of much larger bodies
MIN_BODIES_PER_TASK = 1000


class OctaveRecord(Protocol):
    """The bodies of an octave of diameters."""

    diameter: float  # m, diameter of the octave's largest body, slightly enlarged
    begin: int  # range of the octave's bodies in the order of the table
    end: int
    crowded: bool  # whether the octave has exceeded `MAX_PAIRS_PER_BODY`


class GridRecord(Protocol):
    """A grid: cells of one width."""

    diameter: float  # m, diameter of the grid's largest body, slightly enlarged
    begin: int  # range of the grid's bodies in the order of the table
    end: int
    first_bucket: int
    end_bucket: int
    kx: float  # cells per metre along each axis
    ky: float
    kz: float
    nx: int  # cells along each axis
    ny: int
    nz: int
    mask: int  # mask of the hash, if cells are hashed
    hashed: bool  # whether cells are hashed; otherwise, they are numbered row by row
    crowded: bool  # whether the largest octave is crowded


class SphereRecord(Protocol):
    """A body in the order of the table."""

    x: float  # m
    y: float
    z: float
    radius: float  # m


OCTAVE = dtype_of(OctaveRecord)
GRID = dtype_of(GridRecord)
SPHERE = dtype_of(SphereRecord)


class Layout(NamedTuple):
    """The g grids of a step, beginning with the grid of the largest bodies; there is room for k."""

    grids: IntArray  # (1,) number of grids, g
    grid: RecordArray[GridRecord]  # (k,)
    into: BoolArray  # (k, k) whether the bodies of a grid search another grid
    origin: FloatArray  # (3,) m, position of the corner where cells begin
    box: FloatArray  # (3,) m, size of the periodic box; zeros in open space


class Table(NamedTuple):
    """The bodies of a step in the order of their buckets."""

    ends: Int32Array  # (buckets + 1,) first body of each bucket, then n
    body: Int32Array  # (n,)
    sphere: RecordArray[SphereRecord]  # (n,)


class Cells:
    """Sorts n bodies of constant radii into cells; keeps its tables from step to step."""

    def __init__(self, radius: FloatArray, box: FloatArray, team: Team) -> None:
        n = len(radius)
        self._team = team
        self._radius = radius
        octave = np.unique(-np.frexp(radius / (radius.max() * WIDER))[1], return_inverse=True)[1]
        population = np.bincount(octave)
        k, after = len(population), np.cumsum(population)
        self._octave = octave.astype(np.int16)
        self._octaves = np.zeros(k, dtype=OCTAVE)
        self._octaves["diameter"] = 2.0 * WIDER * np.array([radius[octave == L].max() for L in range(k)])
        self._octaves["begin"], self._octaves["end"] = after - population, after
        self.layout = Layout(
            grids=np.zeros(1, dtype=np.int64),
            grid=np.zeros(k, dtype=GRID),
            into=np.zeros((k, k), dtype=np.bool_),
            origin=np.zeros(3),
            box=box,
        )
        ends = np.empty(MAX_CELLS_PER_BODY * n + 2 * STRIP * k + 1, dtype=np.int32)
        self.table, self._spare = (
            Table(ends, np.empty(n, dtype=np.int32), np.empty(n, dtype=SPHERE)) for _ in range(2)
        )
        self._bucket, self._rank = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)

    def sort(self, position: FloatArray, scale: float, skin: float) -> Table:
        """Return the table of bodies at positions (n, 3) m, in cells at least ``(r_i + r_j) scale + skin`` wide."""
        before, table, layout, n = self.table, self._spare, self.layout, len(position)
        extent = _measure_extent(position, layout.origin, layout.box)
        if _define_grids(extent, scale, skin, self._octaves, layout):
            before.body[:] = np.argsort(self._octave, kind="stable")
            before.sphere["radius"] = self._radius[before.body]
        table.ends[: layout.grid["end_bucket"][layout.grids[0] - 1] + 1] = 0
        self._team.divide(n, MIN_BODIES_PER_TASK, _assign, position, layout, before, self._bucket, self._rank)
        _add_up_counts(table.ends, self._octaves, layout)
        self._team.divide(n, MIN_BODIES_PER_TASK, _move, before, self._bucket, self._rank, table)
        self.table, self._spare = table, before
        return table


@inline
def repeats(size: float) -> bool:
    """Return whether space is periodic along an axis, given the box size there."""
    return 0.0 < size < ENDLESS


@kernel
def _measure_extent(position: FloatArray, origin: FloatArray, box: FloatArray) -> Vector:
    """Write the corner where cells begin; return the extent in m of the bodies, or of the box along periodic axes."""
    if repeats(box[0]) and repeats(box[1]) and repeats(box[2]):
        origin[:] = -0.5 * box
        return sizes(box)
    x0, y0, z0 = vector(position, 0)
    x1, y1, z1 = x0, y0, z0
    for i in range(len(position)):
        x, y, z = vector(position, i)
        x0, y0, z0 = min(x0, x), min(y0, y), min(z0, z)
        x1, y1, z1 = max(x1, x), max(y1, y), max(z1, z)
    origin[0], width = (-0.5 * box[0], box[0]) if repeats(box[0]) else (x0, x1 - x0)
    origin[1], depth = (-0.5 * box[1], box[1]) if repeats(box[1]) else (y0, y1 - y0)
    origin[2], height = (-0.5 * box[2], box[2]) if repeats(box[2]) else (z0, z1 - z0)
    return width, depth, height


@kernel
def _define_grids(
    extent: Vector, scale: float, skin: float, octaves: RecordArray[OctaveRecord], layout: Layout
) -> bool:
    """Define the grids, and which grids search which others.

    Return whether the assignment of octaves to grids has changed; if so, the bodies must be sorted again.
    """
    # each octave gets a grid, or shares the grid of the next larger octave
    count, cells, has_changed = 0, 0.0, False
    for L in range(len(octaves)):
        octave = octaves[L]
        if count == 0 or octave.end - layout.grid[count - 1].begin > MAX_SHARED_BODIES * cells or octave.crowded:
            grid = layout.grid[count]
            has_changed = has_changed or grid.begin != octave.begin
            grid.diameter, grid.begin, grid.crowded = octave.diameter, octave.begin, octave.crowded
            cells = _cut(grid.diameter * scale + skin, 1.0, extent, layout.box, grid)
            count += 1
        layout.grid[count - 1].end = octave.end
    has_changed = has_changed or layout.grids[0] != count
    layout.grids[0] = count
    # divide the grids into cells; a grid has one bucket per cell, or the buckets of a hash
    bucket = 0
    for L in range(count):
        grid = layout.grid[L]
        bodies, width = grid.end - grid.begin, grid.diameter * scale + skin
        most = MAX_CELLS_PER_BODY * bodies + STRIP
        cells = _cut(width, 1.0, extent, layout.box, grid)
        broader = BROAD if cells > SPARSE * bodies and not grid.crowded else 1.0
        cells = _cut(width, broader, extent, layout.box, grid)
        if cells > most and not grid.crowded:
            cells = _cut(WIDE * width, broader, extent, layout.box, grid)
        grid.first_bucket, grid.hashed = bucket, cells > most
        if grid.hashed:
            _cut(width, 1.0, extent, layout.box, grid)
            hashed = STRIP
            while hashed < 2 * bodies:
                hashed *= 2
            grid.mask = hashed - 1
            bucket += hashed + STRIP
        else:
            bucket += int(cells)
        grid.end_bucket = bucket
    # for each pair of grids, the bodies of one grid search the other grid
    for large in range(count):
        layout.into[large, large] = True
        upper = layout.grid[large]
        for small in range(large + 1, count):
            lower = layout.grid[small]
            rows = (upper.diameter * lower.ky + 2.0) * (upper.diameter * lower.kz + 2.0)
            down = (upper.end - upper.begin) * rows
            layout.into[large, small] = down < (lower.end - lower.begin) * MAX_ROWS_PER_BODY
            layout.into[small, large] = not layout.into[large, small]
    return has_changed


@kernel
def _cut(width: float, broader: float, extent: Vector, box: FloatArray, grid: GridRecord) -> float:
    """Divide a grid into cells, broader across the rows and shorter along them; return their number."""
    grid.nx, grid.kx = _cut_axis(extent[0], width / (broader * broader), repeats(box[0]))
    grid.ny, grid.ky = _cut_axis(extent[1], width * broader, repeats(box[1]))
    grid.nz, grid.kz = _cut_axis(extent[2], width * broader, repeats(box[2]))
    cells: float = 1.0 * grid.nx * grid.ny * grid.nz
    return cells


@kernel
def _cut_axis(extent: float, size: float, periodic: bool) -> tuple[int, float]:
    """Return the number of cells along an axis, in all and per metre; a cell is at least ``size`` (m) wide."""
    if periodic:
        cells = int(min(max(1.0, np.floor(extent / size)), MOST_CELLS))
        return cells, cells / extent
    density = 1.0 / max(size, extent / MOST_CELLS)
    return int(extent * density) + 1, density


@inline
def cell_of(ox: float, oy: float, oz: float, grid: GridRecord, periodic: bool) -> tuple[int, int, int]:
    """Return the cell of a point whose position (m) is relative to the corner where cells begin.

    In a periodic box, a cell along an axis that does not repeat is its own image.
    """
    ix, iy, iz = math.floor(ox * grid.kx), math.floor(oy * grid.ky), math.floor(oz * grid.kz)
    if periodic:
        ix, iy, iz = ix % grid.nx, iy % grid.ny, iz % grid.nz
    return ix, iy, iz


@inline
def bucket_of(ix: int, iy: int, iz: int, grid: GridRecord) -> int:
    """Return the bucket of a cell; consecutive cells of a strip have consecutive buckets."""
    if grid.hashed:
        # the upper half of Knuth's multiplicative hash of the strip
        strip = (((iz * (2 * MOST_CELLS) + iy) * 0x1E3779B97F4A7C15 + ix // STRIP) * 0x1E3779B97F4A7C15) >> 32
        hashed: int = grid.first_bucket + (strip & grid.mask) + ix % STRIP
        return hashed
    numbered: int = grid.first_bucket + (iz * grid.ny + iy) * grid.nx + ix
    return numbered


@long_kernel
def _assign(
    lo: int, hi: int, position: FloatArray, layout: Layout, before: Table, bucket: Int32Array, rank: Int32Array
) -> None:
    """Find each body's bucket, and its rank within the bucket; the rank depends on the order of the threads."""
    origin, ends, body = layout.origin, before.ends, before.body
    L, last = 0, len(body) - 1
    periodic = is_periodic(layout.box)
    for k in range(lo, hi):
        prefetch(position, body[min(last, k + AHEAD)], 0)
        while k >= layout.grid[L].end:
            L += 1
        grid = layout.grid[L]
        i = body[k]
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        sphere = before.sphere[k]
        sphere.x, sphere.y, sphere.z = x, y, z
        ix, iy, iz = cell_of(x - origin[0], y - origin[1], z - origin[2], grid, periodic)
        b = bucket_of(ix, iy, iz, grid)
        bucket[k] = b
        rank[k] = atomic_add(ends, b, np.int32(1))


@kernel
def _add_up_counts(ends: Int32Array, octaves: RecordArray[OctaveRecord], layout: Layout) -> None:
    """Replace each bucket's number of bodies by the index of its first body; mark crowded octaves."""
    total, last = np.int32(0), 0
    for L in range(layout.grids[0]):
        pairs = 0
        grid = layout.grid[L]
        for b in range(grid.first_bucket, grid.end_bucket):
            held = ends[b]
            ends[b] = total
            total += held
            pairs += held * (held - 1)
        if 0.5 * pairs > MAX_PAIRS_PER_BODY * (grid.end - grid.begin):
            for k in range(len(octaves)):
                if grid.begin <= octaves[k].begin < grid.end:
                    octaves[k].crowded = True
        last = grid.end_bucket
    ends[last] = total


@long_kernel
def _move(lo: int, hi: int, before: Table, bucket: Int32Array, rank: Int32Array, table: Table) -> None:
    """Copy the bodies to their places."""
    ends, body, sphere = table
    for k in range(lo, hi):
        slot = ends[bucket[k]] + rank[k]
        body[slot] = before.body[k]
        old, new = before.sphere[k], sphere[slot]
        new.x, new.y, new.z, new.radius = old.x, old.y, old.z, old.radius
