"""Which bodies touch: each looks into the cells within its reach, in the grid of its own octave and in some others.

Within an octave a pair is found from the cell that comes first. Of two octaves it is found from one of them: either
the smaller bodies look into the few cells of the larger ones that they meet, or the larger ones into the many cells
that they cover; whichever are fewer cells in all. Among radii by a power law it is the latter, in the gravel on a
planet the former. Rejected: the smaller ones always, each octave in a hashed grid of its own (4 times the time for 10⁵
radii from 1 to 100).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.broad_phase.cells import STRIP, WIDER, Cells, Layout, Table, strip_of
from carom.physics.parallel.atomics import atomic_add
from carom.physics.parallel.jit import kernel, long_kernel
from carom.physics.parallel.thread_team import SOLO, Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CLAIM = 256  # rows of the buffer that a searcher claims at a time
FEW = 100  # bodies, of which every pair is looked at sooner than they are sorted into cells
NARROW = 4  # cells; a wider reach is cut to the chord of each row


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

    def __init__(self, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> None:
        n = len(radius)
        self._team = team
        self._radius, self._box = radius, box
        self._cells = Cells(radius, box, self._team) if n > FEW else None
        self._counts = np.zeros(n + 1, dtype=np.int64)
        self._taken = np.zeros(1, dtype=np.int64)  # rows of the buffer that searchers have claimed
        rows = 2 * n + 64 if n > FEW else n * (n - 1) // 2
        self._found = np.empty((2, rows, 2), dtype=np.int64)  # pairs, and room to sort them

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
        if self._cells is None:
            m = _all_pairs(position, self._radius, self._box, stretch, slack, self._found[0])
            return self._found[0, :m].copy()
        table = self._cells.sort(position, stretch, slack)
        m = self._find(table, self._cells.layout, stretch, slack)
        if self._taken[0] > self._found.shape[1]:
            self._found = np.empty((2, 3 * self._taken[0] // 2, 2), dtype=np.int64)
            m = self._find(table, self._cells.layout, stretch, slack)
        return self._found[0, :m].copy()

    def _find(self, table: Table, layout: Layout, stretch: float, slack: float) -> int:
        """Fill the first half of the buffer; return how many pairs there are, if they fitted."""
        taken, found = self._taken, self._found
        taken[0] = 0
        self._team.divide(len(table.body), 200, search, table, layout, stretch, slack, taken, found)
        m: int = sort_pairs(taken[0], found, self._counts)
        return m


@long_kernel
def search(
    lo: int,
    hi: int,
    table: Table,
    layout: Layout,
    stretch: float,
    slack: float,
    taken: IntArray,
    found: IntArray,
) -> None:
    """Note the pairs of the bodies [lo, hi) of the table."""
    ends, body, sphere = table
    grids, diameter, begins, origin, density, count, first, mask, into, box = layout
    periodic = box[0] > 0.0
    m, end, K = 0, 0, 0
    for a in range(lo, hi):
        while a >= begins[K + 1]:
            K += 1
        x, y, z, r = sphere[a, 0], sphere[a, 1], sphere[a, 2], sphere[a, 3]
        ox, oy, oz = x - origin[0], y - origin[1], z - origin[2]
        for L in range(grids[0]):
            if not into[K, L]:
                continue
            reach = WIDER * ((r + 0.5 * diameter[L]) * stretch + slack)
            kx, ky, kz = density[L, 0], density[L, 1], density[L, 2]
            nx, ny, nz = count[L, 0], count[L, 1], count[L, 2]
            fx, lx = math.floor((ox - reach) * kx), math.floor((ox + reach) * kx) + 1
            fy, ly = math.floor((oy - reach) * ky), math.floor((oy + reach) * ky) + 1
            fz, lz = math.floor((oz - reach) * kz), math.floor((oz + reach) * kz) + 1
            whole = True
            if periodic:  # no cell twice
                whole = lx - fx <= nx and ly - fy <= ny and lz - fz <= nz
                lx, ly, lz = min(lx, fx + nx), min(ly, fy + ny), min(lz, fz + nz)
            else:
                fx, fy, fz = max(fx, 0), max(fy, 0), max(fz, 0)
                lx, ly, lz = min(lx, nx), min(ly, ny), min(lz, nz)
            # within an octave half of the neighbours; where a cell is its neighbour on both sides, later bodies of all
            half = K == L
            if half and periodic:
                most = WIDER * (diameter[L] * stretch + slack)
                half = 2.0 * (most * kx + 1.0) < nx and 2.0 * (most * ky + 1.0) < ny and 2.0 * (most * kz + 1.0) < nz
            later = K == L and not half
            cx, cy, cz = 0, 0, 0
            if half:
                cx, cy, cz = math.floor(ox * kx), math.floor(oy * ky), math.floor(oz * kz)
                fz = cz
            wide = lz - fz > NARROW and whole
            for iz in range(fz, lz):
                wz = iz % nz if periodic else iz
                for iy in range(cy if half and iz == cz else fy, ly):
                    wy = iy % ny if periodic else iy
                    ix, over = fx, lx
                    after = a + 1 if later else 0
                    if half and iz == cz and iy == cy:
                        ix, after = cx, a + 1
                    elif wide:
                        gy = max(0.0, iy / ky - oy, oy - (iy + 1) / ky)
                        gz = max(0.0, iz / kz - oz, oz - (iz + 1) / kz)
                        h2 = reach * reach - gy * gy - gz * gz
                        if h2 < 0.0:
                            continue
                        h = np.sqrt(h2)
                        ix, over = max(fx, math.floor((ox - h) * kx)), min(lx, math.floor((ox + h) * kx) + 1)
                    while ix < over:
                        wx = ix % nx if periodic else ix
                        cells = min(over - ix, nx - wx)
                        if mask[L] < 0:
                            bucket = first[L] + (wz * ny + wy) * nx + wx
                        else:
                            cells = min(cells, STRIP - wx % STRIP)
                            bucket = first[L] + (strip_of(wx, wy, wz) & mask[L]) + wx % STRIP
                        for b in range(max(after, ends[bucket]), ends[bucket + cells]):
                            dx, dy, dz = sphere[b, 0] - x, sphere[b, 1] - y, sphere[b, 2] - z
                            if periodic:
                                dx -= box[0] * np.floor(dx / box[0] + 0.5)
                                dy -= box[1] * np.floor(dy / box[1] + 0.5)
                                dz -= box[2] * np.floor(dz / box[2] + 0.5)
                            touch = (r + sphere[b, 3]) * stretch + slack
                            if dx * dx + dy * dy + dz * dz <= touch * touch:
                                if mask[L] >= 0:  # another cell may have the same hash
                                    bx = math.floor((sphere[b, 0] - origin[0]) * kx)
                                    by = math.floor((sphere[b, 1] - origin[1]) * ky)
                                    bz = math.floor((sphere[b, 2] - origin[2]) * kz)
                                    if periodic:
                                        bx, by, bz = bx % nx, by % ny, bz % nz
                                    if bz != wz or by != wy or bx < wx or bx >= wx + cells:
                                        continue
                                if m == end:
                                    m = atomic_add(taken, 0, CLAIM)
                                    end = m + CLAIM
                                if m < found.shape[1]:
                                    found[0, m, 0] = min(body[a], body[b])
                                    found[0, m, 1] = max(body[a], body[b])
                                m += 1
                        ix += cells
                        if half:
                            after = 0
    _leave(found, m, end)


@kernel
def _all_pairs(
    position: FloatArray, radius: FloatArray, box: FloatArray, stretch: float, slack: float, found: IntArray
) -> int:
    """Note the pairs of all bodies, and return how many there are."""
    m, periodic = 0, box[0] > 0.0
    for i in range(len(radius)):
        for j in range(i + 1, len(radius)):
            d2 = 0.0
            for k in range(3):
                d = position[j, k] - position[i, k]
                if periodic:
                    d -= box[k] * np.floor(d / box[k] + 0.5)
                d2 += d * d
            touch = (radius[i] + radius[j]) * stretch + slack
            if d2 <= touch * touch:
                found[m, 0], found[m, 1] = i, j
                m += 1
    return m


@kernel
def _leave(found: IntArray, m: int, end: int) -> None:
    """Mark the rows that were claimed but not needed."""
    for row in range(m, min(end, found.shape[1])):
        found[0, row, 1] = -1


@kernel
def sort_pairs(rows: int, found: IntArray, counts: IntArray) -> int:
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
