"""Gravity as a direct sum over all pairs, in strict arithmetic.

    a_i = Σ_j a_ij      φ_i = Σ_j φ_ij,  j ≠ i      U = ½ Σ_i m_i φ_i        (`pair` has a_ij and φ_ij)

Bodies are processed in blocks of 32. The targets of a block are in the SIMD lanes, and the bodies of a later block are
the sources, one after another. Accelerations of the targets and reactions on each source are summed lane by lane. The
lanes of a source are summed in a fixed order at the end of its block. The number of bodies therefore fixes the order of
every sum: the bits are the same at any SIMD width and any number of threads.

Up to 32 bodies form one block, without lanes: `sum_few` computes each pair once and adds in the same order, with the
same bits. Three bodies take 20 ns instead of 2 µs, 32 bodies take 2.8 µs instead of 5 µs.

Directed pairs per second at 1024, 4096 and 16384 bodies on one core (Zen 5 with AVX-512, which computes 2.7 × 10⁹ roots
and divisions per second): 3.0, 3.2 and 3.4 × 10⁹.

Rejected: each body summing over all others (2.4 × 10⁹; faster below 200 bodies, by a microsecond); one source at a time
(2.3, 2.9 and 3.2 × 10⁹; two sources share the loads and stores of the lanes); sums in arrays passed as arguments (2.5 ×
10⁹ at most, because the compiler must assume that they overlap); approximate reciprocal roots (slower, with other
bits); a reduction over sources (other bits).
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.physics.aligned import CACHE_LINE
from carom.physics.forces.gravity.pair import attraction, mutual_attraction
from carom.physics.jit.decorators import kernel, long_kernel_with_arrays
from carom.physics.jit.team import SOLO, Team
from carom.scene.schema import Gravity

X, Y, Z, MASS = range(4)  # rows of the sources
AX, AY, AZ, PHI = range(4)  # rows of the sums

LANES = 32
MAX_IN_ONE_BLOCK = LANES  # largest number of bodies in a single block
# with fewer bodies, waking threads costs as much time as it saves, and the recorder needs the other core
PARALLEL_FROM = 2048
SLABS = 16  # number of slabs of equal work, each with its own sums; more threads than slabs cannot be used


class DirectGravity:
    """Direct gravity between n bodies, with its workspace."""

    def __init__(self, mass: FloatArray, constant: float, softening: float, team: Team = SOLO):
        n = len(mass)
        self._is_few = n <= MAX_IN_ONE_BLOCK
        blocks = -(-n // LANES)
        self._mass = mass
        self._constant = constant
        self._softening_squared = softening * softening
        self._source = np.zeros((4, blocks * LANES))  # the padding of the last block has mass 0
        self._source[MASS, :n] = mass
        # slabs of blocks with about equal work; each block is paired with itself and all earlier blocks
        slabs, work = SLABS if n >= PARALLEL_FROM else 1, np.cumsum(np.arange(1, blocks + 1))
        edges = np.searchsorted(work, work[-1] * np.arange(1, slabs) / slabs)
        self._edges = np.concatenate(([0], edges, [blocks]))
        self._sums = np.empty((len(self._edges) - 1, 4, blocks * LANES))
        self._potential = np.zeros(n)
        self._team = team if n >= PARALLEL_FROM else SOLO

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the accelerations; see `GravityMethod`. The energy takes about a fifth more time."""
        if self._is_few:
            law = self._constant, self._softening_squared
            sum_few(position, self._mass, *law, acceleration, self._potential)
        else:
            self._source[X : Z + 1, : len(position)] = position.T
            into = self._potential if potential else None
            sources = len(self._mass), self._source, self._softening_squared
            self._team.divide(len(self._edges) - 1, 1, _sum_blocks, self._edges, *sources, self._sums, into)
            results = acceleration, self._potential, potential
            _total(self._edges, self._sums, self._constant, self._softening_squared, self._mass, *results)
        return potential_energy(self._mass, self._potential) if potential else None


def make(gravity: Gravity, mass: FloatArray, team: Team) -> DirectGravity:
    """Return the direct sum for a scene's gravity section."""
    return DirectGravity(mass, gravity.constant, gravity.softening, team)


@kernel
def _lanes(count: int) -> FloatArray:
    """Allocate floats that are aligned to a cache line; lanes that straddle two lines take twice as long.

    The kernel itself allocates the lanes, so that the compiler knows that they do not overlap. This function is not
    inlined: a dozen copies would take half a second to compile.
    """
    buffer = np.empty(count + CACHE_LINE // 8)
    start = (CACHE_LINE - buffer.ctypes.data % CACHE_LINE) % CACHE_LINE // 8
    return buffer[start : start + count]


@kernel
def sum_few(
    x: FloatArray, m: FloatArray, G: float, eps2: float, acceleration: FloatArray, potential: FloatArray
) -> None:
    """Write acceleration, (n, 3) m/s², and potential, (n,) J/kg, of at most `MAX_IN_ONE_BLOCK` bodies.

    Like the code for lanes, this code adds a body's terms in the order of their sources, and adds reactions in the
    order of the rows.
    """
    n = len(m)
    own = attraction(1.0, eps2)
    for i in range(n):
        acceleration[i, 0] = acceleration[i, 1] = acceleration[i, 2] = potential[i] = 0.0
    for i in range(n):
        xi, yi, zi, mi = x[i, 0], x[i, 1], x[i, 2], m[i]
        ax, ay, az, p = acceleration[i, 0], acceleration[i, 1], acceleration[i, 2], potential[i]
        p += mi * own * eps2  # the body's own term with softening, at its place in the sum
        for j in range(i + 1, n):
            dx, dy, dz = x[j, 0] - xi, x[j, 1] - yi, x[j, 2] - zi
            f, g, r2 = mutual_attraction(dx, dy, dz, mi, m[j], eps2)
            ax += f * dx
            ay += f * dy
            az += f * dz
            p += f * r2
            acceleration[j, 0] -= g * dx
            acceleration[j, 1] -= g * dy
            acceleration[j, 2] -= g * dz
            potential[j] += g * r2
        acceleration[i, 0], acceleration[i, 1], acceleration[i, 2] = G * ax, G * ay, G * az
        potential[i] = -G * (p - mi * own * eps2)


@long_kernel_with_arrays
def _sum_blocks(
    lo: int,
    hi: int,
    edges: IntArray,
    n: int,
    source: FloatArray,
    eps2: float,
    sums: FloatArray,
    potential: FloatArray | None,
) -> None:
    """Write Σ m d/R³ and Σ m/R between the blocks of the slabs [lo, hi) and all blocks before them."""
    L, H = np.uint64(LANES), np.uint64(LANES // 2)
    tx, ty, tz, tm = _lanes(LANES), _lanes(LANES), _lanes(LANES), _lanes(LANES)
    ax, ay, az, ap = _lanes(LANES), _lanes(LANES), _lanes(LANES), _lanes(LANES)
    bx, by, bz, bp = _lanes(LANES * LANES), _lanes(LANES * LANES), _lanes(LANES * LANES), _lanes(LANES * LANES)
    for s in range(lo, hi):
        slab = sums[s]
        for k in range(edges[s + 1] * LANES):
            slab[AX, k] = slab[AY, k] = slab[AZ, k] = slab[PHI, k] = 0.0
        for block in range(edges[s], edges[s + 1]):
            first = np.uint64(block) * L
            twos = np.uint64((min(LANES, n - block * LANES) + 1) // 2)
            for k in range((twos + twos) * L):
                bx[k] = by[k] = bz[k] = bp[k] = 0.0
            for targets in range(block + 1):
                i = np.uint64(targets) * L
                weight = 1.0 if i < first else 0.0  # within a block, each body is a source once, without reactions
                for k in range(L):
                    tx[k], ty[k], tz[k] = source[X, i + k], source[Y, i + k], source[Z, i + k]
                    tm[k] = weight * source[MASS, i + k]
                    ax[k] = ay[k] = az[k] = ap[k] = 0.0
                for two in range(twos):  # two sources share the loads and stores of the lanes
                    j = first + two + two
                    q = (two + two) * L
                    jj = j + np.uint64(1)
                    xj, yj, zj, mj = source[X, j], source[Y, j], source[Z, j], source[MASS, j]
                    xx, yy, zz, mm = source[X, jj], source[Y, jj], source[Z, jj], source[MASS, jj]
                    for k in range(L):
                        dx, dy, dz = xj - tx[k], yj - ty[k], zj - tz[k]
                        ex, ey, ez = xx - tx[k], yy - ty[k], zz - tz[k]
                        f, by_f, d2 = mutual_attraction(dx, dy, dz, tm[k], mj, eps2)
                        g, by_g, e2 = mutual_attraction(ex, ey, ez, tm[k], mm, eps2)
                        ax[k] = ax[k] + f * dx + g * ex
                        ay[k] = ay[k] + f * dy + g * ey
                        az[k] = az[k] + f * dz + g * ez
                        if potential is not None:
                            ap[k] = ap[k] + f * d2 + g * e2
                        bx[q + k] -= by_f * dx
                        by[q + k] -= by_f * dy
                        bz[q + k] -= by_f * dz
                        bx[q + L + k] -= by_g * ex
                        by[q + L + k] -= by_g * ey
                        bz[q + L + k] -= by_g * ez
                        if potential is not None:
                            bp[q + k] += by_f * d2
                            bp[q + L + k] += by_g * e2
                for k in range(L):
                    slab[AX, i + k] += ax[k]
                    slab[AY, i + k] += ay[k]
                    slab[AZ, i + k] += az[k]
                    if potential is not None:
                        slab[PHI, i + k] += ap[k]
            for row in range(twos + twos):
                j, q = first + row, row * L
                h = H
                while h > np.uint64(0):
                    for k in range(h):
                        bx[q + k] += bx[q + h + k]
                        by[q + k] += by[q + h + k]
                        bz[q + k] += bz[q + h + k]
                        if potential is not None:
                            bp[q + k] += bp[q + h + k]
                    h = h // np.uint64(2)
                slab[AX, j] += bx[q]
                slab[AY, j] += by[q]
                slab[AZ, j] += bz[q]
                if potential is not None:
                    slab[PHI, j] += bp[q]


@kernel
def _total(
    edges: IntArray,
    sums: FloatArray,
    G: float,
    eps2: float,
    m: FloatArray,
    acceleration: FloatArray,
    potential: FloatArray,
    wanted: bool,
) -> None:
    """Add the slabs; each has sums for its blocks and all blocks before them."""
    # with softening, each body has added its own potential, m/ε; subtract it with the same rounding
    own = attraction(1.0, eps2)
    slab = 0
    for i in range(len(m)):
        while edges[slab + 1] * LANES <= i:
            slab += 1
        ax = ay = az = p = 0.0
        for s in range(slab, len(sums)):
            ax += sums[s, AX, i]
            ay += sums[s, AY, i]
            az += sums[s, AZ, i]
            if wanted:
                p += sums[s, PHI, i]
        acceleration[i, 0] = G * ax
        acceleration[i, 1] = G * ay
        acceleration[i, 2] = G * az
        if wanted:
            potential[i] = -G * (p - m[i] * own * eps2)


@kernel
def potential_energy(m: FloatArray, potential: FloatArray) -> float:
    """Return ½ Σ m φ in joules."""
    total = 0.0
    for i in range(len(m)):
        total += m[i] * potential[i]
    return 0.5 * total
