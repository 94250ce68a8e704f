"""Hierarchical grid: each body searches the nearby cells in the grid of its own octave and in other grids.

A pair within an octave is found by the body in the earlier cell. A pair of two octaves is found by one of the bodies.
Either the smaller bodies search the few cells of larger bodies near them, or the larger bodies search the many cells
that they cover: whichever takes fewer cells in total. Gravel on a planet is an example of the first case, power-law
radii are an example of the second.

Rejected: searching from the smaller bodies always, with each octave in a hashed grid of its own (4 times the time for
10⁵ radii from 1 to 100).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import PhysicsError
from carom.physics.contact.broad_phase.cells import (
    STRIP,
    WIDER,
    Cells,
    GridRecord,
    Layout,
    SphereRecord,
    Table,
    bucket_of,
    cell_of,
    repeats,
)
from carom.physics.contact.geometry import are_near
from carom.physics.jit.decorators import inline, kernel, long_kernel
from carom.physics.jit.instructions import atomic_add
from carom.physics.jit.team import SOLO, Team
from carom.physics.vector import Vector, between, is_periodic, sizes

PAIRS_PER_CLAIM = 256  # rows of the buffer that a thread claims at a time
ALL_PAIRS_UP_TO = 100  # bodies up to which testing every pair is faster than sorting into cells
NARROW = 4  # number of cells within the search distance above which rows are shortened to their chords of the sphere
MIN_BODIES_PER_TASK = 200


class HierarchicalGrid:
    """Finds the touching pairs among n spheres of constant radii; keeps its tables from step to step.

    The argument ``box`` is the size of the periodic box, (3,) m; zeros in open space.
    """

    def __init__(self, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> None:
        n = len(radius)
        self._team = team
        self._radius, self._box = radius, box
        self._cells = Cells(radius, box, self._team) if n > ALL_PAIRS_UP_TO else None
        self._counts = np.zeros(n + 1, dtype=np.int64)
        self._claimed = np.zeros(1, dtype=np.int64)  # rows of the buffer that threads have claimed
        rows = 2 * n + 64 if n > ALL_PAIRS_UP_TO else n * (n - 1) // 2
        self._buffer = np.empty((2, rows, 2), dtype=np.int64)  # found pairs, and space to sort them

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j).

        Positions, (n, 3) m, are finite, and need not be inside a periodic box. ``scale`` is at least 1, and ``skin``
        (m) is not negative.
        """
        if self._cells is None:
            m = _all_pairs(position, self._radius, self._box, scale, skin, self._buffer[0])
            return self._buffer[0, :m].copy()
        table = self._cells.sort(position, scale, skin)
        m = self._list_pairs(table, self._cells.layout, scale, skin)
        if self._claimed[0] > self._buffer.shape[1]:
            self._buffer = _buffer_for(int(self._claimed[0]))
            m = self._list_pairs(table, self._cells.layout, scale, skin)
        return self._buffer[0, :m].copy()

    def _list_pairs(self, table: Table, layout: Layout, scale: float, skin: float) -> int:
        """Fill the first half of the buffer; return the number of pairs, if they fit."""
        claimed, buffer = self._claimed, self._buffer
        claimed[0] = 0
        self._team.divide(len(table.body), MIN_BODIES_PER_TASK, search, table, layout, scale, skin, claimed, buffer)
        m: int = sort_pairs(claimed[0], buffer, self._counts)
        return m


def _buffer_for(pairs: int) -> IntArray:
    """Return a buffer for 1.5 times as many pairs. Raises PhysicsError if there is no memory for it."""
    try:
        return np.empty((2, 3 * pairs // 2, 2), dtype=np.int64)
    except MemoryError as error:
        raise PhysicsError(
            f"{pairs:.3g} pairs of bodies may touch within one step, and the list of them needs {48e-9 * pairs:.3g} "
            "GB; lower time.max_dt or time.fixed_dt, or move the bodies apart"
        ) from error


class Scope(NamedTuple):
    """Input of a search, and the buffer of its pairs."""

    table: Table
    layout: Layout
    scale: float
    skin: float  # m
    claimed: IntArray  # (1,) rows of the buffer that threads have claimed
    buffer: IntArray  # (2, k, 2) found pairs, and space to sort them


class Row(NamedTuple):
    """A run of cells along x in a grid."""

    first: int
    end: int
    y: int
    z: int


@long_kernel
def search(
    lo: int, hi: int, table: Table, layout: Layout, scale: float, skin: float, claimed: IntArray, buffer: IntArray
) -> None:
    """Store the pairs of bodies [lo, hi) of the table, and mark rows of the buffer that were claimed but not used."""
    scope = Scope(table, layout, scale, skin, claimed, buffer)
    box, periodic, origin = sizes(layout.box), is_periodic(layout.box), layout.origin
    m, end, K = 0, 0, 0
    for a in range(lo, hi):
        while a >= layout.grid[K].end:
            K += 1
        sphere = table.sphere[a]
        ox, oy, oz = sphere.x - origin[0], sphere.y - origin[1], sphere.z - origin[2]
        for L in range(layout.grids[0]):
            if not layout.into[K, L]:
                continue
            grid = layout.grid[L]
            search_radius = WIDER * ((sphere.radius + 0.5 * grid.diameter) * scale + skin)
            fx, lx, once_x = _cells_along(ox, search_radius, grid.kx, grid.nx, repeats(box[0]))
            fy, ly, once_y = _cells_along(oy, search_radius, grid.ky, grid.ny, repeats(box[1]))
            fz, lz, once_z = _cells_along(oz, search_radius, grid.kz, grid.nz, repeats(box[2]))
            # Within an octave, half of the neighbouring cells are searched. If a cell may be a neighbour on both sides,
            # all neighbouring cells are searched, but only for later bodies.
            half = K == L and not _meets_itself(grid, scale, skin, box)
            later = K == L and not half
            cx, cy, cz = 0, 0, 0
            if half:
                cx, cy, cz = cell_of(ox, oy, oz, grid, False)
                fz = cz
            wide = lz - fz > NARROW and once_x and once_y and once_z
            for iz in range(fz, lz):
                for iy in range(cy if half and iz == cz else fy, ly):
                    is_own = half and iz == cz and iy == cy
                    first, after = cx if is_own else fx, a + 1 if later or is_own else 0
                    row = Row(first, lx, iy, iz)
                    if wide and not is_own:
                        row = _chord(row, ox, oy, oz, search_radius, grid)
                    # a row may cross the periodic box, and strips of hashed cells
                    y, z = (row.y % grid.ny, row.z % grid.nz) if periodic else (row.y, row.z)
                    ix = row.first
                    while ix < row.end:
                        x = ix % grid.nx if periodic else ix
                        cells = min(row.end - ix, grid.nx - x)
                        if grid.hashed:
                            cells = min(cells, STRIP - x % STRIP)
                        m, end = _search_cells(a, Row(x, x + cells, y, z), after, grid, scope, m, end)
                        ix += cells
                        if half:
                            after = 0  # only the first cells of a row include the body's own cell
    for unused in range(m, min(end, buffer.shape[1])):
        buffer[0, unused, 1] = -1


@inline
def _chord(row: Row, ox: float, oy: float, oz: float, search_radius: float, grid: GridRecord) -> Row:
    """Return the cells of a row near a point (m from the grid's corner); none if the row is too far away."""
    gy, gz = _gap_to_cell(oy, row.y, grid.ky), _gap_to_cell(oz, row.z, grid.kz)
    squared = search_radius * search_radius - gy * gy - gz * gz
    if squared < 0.0:
        return Row(row.first, row.first, row.y, row.z)
    half = np.sqrt(squared)
    first, last = math.floor((ox - half) * grid.kx), math.floor((ox + half) * grid.kx)
    return Row(max(row.first, first), min(row.end, last + 1), row.y, row.z)


@inline
def _search_cells(a: int, row: Row, after: int, grid: GridRecord, scope: Scope, m: int, end: int) -> tuple[int, int]:
    """Store the pairs of a body with bodies in consecutive buckets, starting at an index of the table.

    ``m`` and ``end`` are the next row of the buffer and the end of the claimed rows; return both.
    """
    (ends, body, sphere), box, buffer = scope.table, sizes(scope.layout.box), scope.buffer
    own, bucket = sphere[a], bucket_of(row.first, row.y, row.z, grid)
    for b in range(max(after, ends[bucket]), ends[bucket + row.end - row.first]):
        other = sphere[b]
        dx, dy, dz = other.x - own.x, other.y - own.y, other.z - own.z
        near = are_near(dx, dy, dz, own.radius + other.radius, box, scope.scale, scope.skin)
        if near and (not grid.hashed or _is_in(other, row, grid, scope.layout)):
            if m == end:
                m = atomic_add(scope.claimed, 0, PAIRS_PER_CLAIM)
                end = m + PAIRS_PER_CLAIM
            if m < buffer.shape[1]:
                buffer[0, m, 0], buffer[0, m, 1] = min(body[a], body[b]), max(body[a], body[b])
            m += 1
    return m, end


@inline
def _is_in(sphere: SphereRecord, row: Row, grid: GridRecord, layout: Layout) -> bool:
    """Return whether a body is in a row of cells; bodies of other cells may share its bucket."""
    origin = layout.origin
    x, y, z = sphere.x - origin[0], sphere.y - origin[1], sphere.z - origin[2]
    bx, by, bz = cell_of(x, y, z, grid, is_periodic(layout.box))
    return bz == row.z and by == row.y and row.first <= bx < row.end


@inline
def _cells_along(o: float, search_radius: float, density: float, cells: int, periodic: bool) -> tuple[int, int, bool]:
    """Return the first nearby cell along an axis, the end of the range, and whether no cell occurs twice."""
    first, end = math.floor((o - search_radius) * density), math.floor((o + search_radius) * density) + 1
    if periodic:
        return first, min(end, first + cells), end - first <= cells
    return max(first, 0), min(end, cells), True


@inline
def _meets_itself(grid: GridRecord, scale: float, skin: float, box: Vector) -> bool:
    """Return whether a cell of a periodic grid may be a neighbour of another on both sides."""
    most = WIDER * (grid.diameter * scale + skin)
    return (
        (repeats(box[0]) and not 2.0 * (most * grid.kx + 1.0) < grid.nx)
        or (repeats(box[1]) and not 2.0 * (most * grid.ky + 1.0) < grid.ny)
        or (repeats(box[2]) and not 2.0 * (most * grid.kz + 1.0) < grid.nz)
    )


@inline
def _gap_to_cell(o: float, cell: int, density: float) -> float:
    """Return the distance of a point from a cell along an axis, in m; 0 within it."""
    return max(0.0, cell / density - o, o - (cell + 1) / density)


@long_kernel
def _all_pairs(
    position: FloatArray, radius: FloatArray, box: FloatArray, scale: float, skin: float, buffer: IntArray
) -> int:
    """Store the pairs of all bodies; return their number."""
    m, size = 0, sizes(box)
    for i in range(len(radius)):
        for j in range(i + 1, len(radius)):
            dx, dy, dz = between(position, i, j)
            if are_near(dx, dy, dz, radius[i] + radius[j], size, scale, skin):
                buffer[m, 0], buffer[m, 1] = i, j
                m += 1
    return m


@kernel
def sort_pairs(rows: int, buffer: IntArray, counts: IntArray) -> int:
    """Sort the pairs by (i, j), if they fit, with the second half of the buffer as workspace; return their number."""
    if rows > buffer.shape[1]:
        return 0
    m = _sort_by(1, rows, buffer[0], buffer[1], counts)
    return _sort_by(0, m, buffer[1], buffer[0], counts)


@kernel
def _sort_by(end: int, rows: int, pairs: IntArray, ordered: IntArray, counts: IntArray) -> int:
    """Sort stably by one end of the pairs, without unused rows; return the number of pairs."""
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
