"""Gravity as a direct sum over all pairs, in strict arithmetic.

    a_i = G Σ_j m_j d_ij / (d_ij² + ε²)^{3/2}        d_ij = x_j - x_i,  j ≠ i
    φ_i = -G Σ_j m_j / (d_ij² + ε²)^{1/2}             U = ½ Σ_i m_i φ_i

Without softening, coincident bodies neither pull each other nor have a potential: both are undefined.

A block of 64 targets lies in the SIMD lanes and every source is taken in turn, so each target sums its sources in
the order of their indices: the same bits on any SIMD width and any number of threads, at the speed of a reassociated
sum. Rejected: reducing over sources (needs reassociation), approximate reciprocal roots (slower here, and other bits).
"""

from __future__ import annotations

import itertools
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import inline, kernel, long_kernel

FloatArray = NDArray[np.float64]

LANES = 64
CACHE_LINE = 64  # bytes; lanes that straddle two of them take twice as long, and malloc decides
ROOM = LANES + CACHE_LINE // 8
PARALLEL_FROM = 2048  # bodies; below, waking threads costs what they save, and the recorder wants the other core


class DirectGravity:
    """Pull and potential of n bodies on each other, with the workspace they need."""

    def __init__(self, mass: FloatArray, constant: float, softening: float, executor: Executor | None, threads: int):
        n = len(mass)
        self._mass = mass
        self._constant = constant
        self._softening_squared = softening * softening
        self._sources = np.empty((3, n))
        self._potential = np.zeros(n)
        parallel = executor is not None and threads > 1 and n >= PARALLEL_FROM
        self._executor = executor if parallel else None
        self._chunks = _chunks(n, threads if parallel else 1)

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the acceleration of every body; return the potential energy in joules if it is asked for.

        Parameters
        ----------
        position
            (n, 3) m.
        acceleration
            (n, 3) m/s², overwritten.
        potential
            Costs about a tenth more.
        """
        self._sources[:] = position.T
        if self._executor is None:
            for lo, hi in self._chunks:
                self._sum(lo, hi, acceleration, potential)
        else:
            tasks = [self._executor.submit(self._sum, lo, hi, acceleration, potential) for lo, hi in self._chunks]
            for task in tasks:
                task.result()
        return potential_energy(self._mass, self._potential) if potential else None

    def _sum(self, lo: int, hi: int, acceleration: FloatArray, potential: bool) -> None:
        x, y, z = self._sources
        if potential:
            _pull_and_potential(
                lo,
                hi,
                x,
                y,
                z,
                self._mass,
                self._constant,
                self._softening_squared,
                acceleration,
                self._potential,
            )
        else:
            _pull(lo, hi, x, y, z, self._mass, self._constant, self._softening_squared, acceleration)


def _chunks(n: int, threads: int) -> list[tuple[int, int]]:
    """Split n targets into whole blocks of lanes, about equal for each thread."""
    blocks = -(-n // LANES)
    edges = [min(n, LANES * (blocks * k // threads)) for k in range(threads + 1)]
    return [(lo, hi) for lo, hi in itertools.pairwise(edges) if hi > lo]


@inline
def _aligned(buffer: FloatArray) -> np.uint64:
    """Return the index at which a buffer reaches a cache line, unsigned: a signed one would stop vectorisation."""
    return np.uint64((CACHE_LINE - buffer.ctypes.data % CACHE_LINE) % CACHE_LINE // 8)


@long_kernel
def _pull(
    lo: int,
    hi: int,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    m: FloatArray,
    G: float,
    eps2: float,
    acceleration: FloatArray,
) -> None:
    tx, ty, tz = np.empty(ROOM), np.empty(ROOM), np.empty(ROOM)
    ax, ay, az = np.empty(ROOM), np.empty(ROOM), np.empty(ROOM)
    bx, by, bz = _aligned(tx), _aligned(ty), _aligned(tz)
    cx, cy, cz = _aligned(ax), _aligned(ay), _aligned(az)
    for first in range(lo, hi, LANES):
        lanes = min(LANES, hi - first)
        for lane in range(LANES):
            q = np.uint64(lane)
            t = first + min(lane, lanes - 1)  # spare lanes repeat the last target and are thrown away
            tx[bx + q], ty[by + q], tz[bz + q] = x[t], y[t], z[t]
            ax[cx + q] = ay[cy + q] = az[cz + q] = 0.0
        for j in range(len(m)):
            xj, yj, zj, mj = x[j], y[j], z[j], m[j]
            for k in range(np.uint64(LANES)):
                dx, dy, dz = xj - tx[bx + k], yj - ty[by + k], zj - tz[bz + k]
                r2 = dx * dx + dy * dy + dz * dz + eps2
                s = mj / (r2 * np.sqrt(r2)) if r2 > 0.0 else 0.0
                ax[cx + k] += s * dx
                ay[cy + k] += s * dy
                az[cz + k] += s * dz
        for lane in range(lanes):
            i, q = first + lane, np.uint64(lane)
            acceleration[i, 0] = G * ax[cx + q]
            acceleration[i, 1] = G * ay[cy + q]
            acceleration[i, 2] = G * az[cz + q]


@long_kernel
def _pull_and_potential(
    lo: int,
    hi: int,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    m: FloatArray,
    G: float,
    eps2: float,
    acceleration: FloatArray,
    potential: FloatArray,
) -> None:
    own = eps2 / (eps2 * np.sqrt(eps2)) if eps2 > 0.0 else 0.0  # 1/ε: softened, a body would sit in its own potential
    tx, ty, tz = np.empty(ROOM), np.empty(ROOM), np.empty(ROOM)
    ax, ay, az = np.empty(ROOM), np.empty(ROOM), np.empty(ROOM)
    bx, by, bz = _aligned(tx), _aligned(ty), _aligned(tz)
    cx, cy, cz = _aligned(ax), _aligned(ay), _aligned(az)
    p = np.empty(ROOM)
    cp = _aligned(p)
    for first in range(lo, hi, LANES):
        lanes = min(LANES, hi - first)
        for lane in range(LANES):
            q = np.uint64(lane)
            t = first + min(lane, lanes - 1)  # spare lanes repeat the last target and are thrown away
            tx[bx + q], ty[by + q], tz[bz + q] = x[t], y[t], z[t]
            ax[cx + q] = ay[cy + q] = az[cz + q] = 0.0
            p[cp + q] = 0.0
        for j in range(len(m)):
            xj, yj, zj, mj = x[j], y[j], z[j], m[j]
            for k in range(np.uint64(LANES)):
                dx, dy, dz = xj - tx[bx + k], yj - ty[by + k], zj - tz[bz + k]
                r2 = dx * dx + dy * dy + dz * dz + eps2
                s = mj / (r2 * np.sqrt(r2)) if r2 > 0.0 else 0.0
                ax[cx + k] += s * dx
                ay[cy + k] += s * dy
                az[cz + k] += s * dz
                p[cp + k] += s * r2  # m/r from the same root and the same division
        for lane in range(lanes):
            i, q = first + lane, np.uint64(lane)
            acceleration[i, 0] = G * ax[cx + q]
            acceleration[i, 1] = G * ay[cy + q]
            acceleration[i, 2] = G * az[cz + q]
            potential[i] = -G * (p[cp + q] - own * m[i])


@kernel
def potential_energy(m: FloatArray, potential: FloatArray) -> float:
    """Return ½ Σ m φ in joules."""
    total = 0.0
    for i in range(len(m)):
        total += m[i] * potential[i]
    return 0.5 * total
