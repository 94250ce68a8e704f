"""The sweeps that find the impulses of contacts that last; `lasting` has the equations.

A sweep hands a load on from contact to contact, and where a light body lies between heavy ones it hands on very little.
So after each sweep the change s that it made of all impulses is made once more, α times, as far as that brings the
contacts nearer to what is asked (an exact line search, with A s the velocities at the contacts that impulses s cause)
and no contact begins to pull (λ_n ≥ 0):

    α = -s·(v + c) / s·(A s),   v the velocities at the contacts, v_n and u

Summed over bodies, with p and t the changes of their velocities and spins by s, that is

    s·v = Σ m p·v + I t·ω,    s·A s = Σ m p² + I t²

A ball squeezed between two that are 10⁹ times heavier is then held to 10⁻¹¹ of its radius. Sweeps alone let it sink by
0.1 radii at 10², and 100 of them at 10³. A stack of 20 that begins without impulses sags with 10⁻⁶ of the energy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.load import (
    ALPHA,
    APART,
    BEFORE,
    BIAS,
    BLOCK,
    CHANGE,
    CLOSING,
    DRIFT,
    DT,
    FARTHEST,
    KICK,
    OVERLAP,
    REST,
    SPINS,
)
from carom.physics.contact.velocity import bend, give
from carom.physics.parallel.jit import kernel
from carom.physics.parallel.prefetch import AHEAD, prefetch

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

HELD = 1e-8  # a sweep that changes no velocity by more than this part of the largest that the contacts undo is the last
LOADED = 1e-5  # how much the velocity counts that an impulse gives to the lightest body: rounding is 1e-16 of it


@kernel
def begin(
    lo: int,
    hi: int,
    piece: int,
    pairs: IntArray,
    C: FloatArray,
    cold: FloatArray,
    V: FloatArray,
    found: FloatArray,
    flags: IntArray,
    numbers: FloatArray,
) -> None:
    """Write what does not change during the sweeps, and v_n and u before them; leave impacts alone."""
    spins = flags[SPINS] != 0
    dt, drift, kick, bias_rate = numbers[DT], numbers[DRIFT], numbers[KICK], numbers[BIAS]
    largest = 0.0  # m/s, the largest velocity that a contact undoes
    last = len(pairs) - 1
    for c in range(lo, hi):
        ahead = min(last, c + AHEAD)
        prefetch(V, pairs[ahead, 0], 0)
        prefetch(V, pairs[ahead, 1], 0)
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz, ri, rj = C[c, 0], C[c, 1], C[c, 2], C[c, 3], C[c, 4]
        Kn = V[i, 6] + V[j, 6]
        C[c, 5] = 1.0 / Kn
        ux, uy, uz = V[j, 0] - V[i, 0], V[j, 1] - V[i, 1], V[j, 2] - V[i, 2]
        vn = ux * nx + uy * ny + uz * nz
        cold[c, BEFORE] = vn
        if spins:
            C[c, 6] = 1.0 / (Kn + ri * ri * V[i, 7] + rj * rj * V[j, 7])
            ux, uy, uz = ux - vn * nx, uy - vn * ny, uz - vn * nz
            wx, wy, wz = ri * V[i, 3] + rj * V[j, 3], ri * V[i, 4] + rj * V[j, 4], ri * V[i, 5] + rj * V[j, 5]
            cold[c, BEFORE + 1] = ux - (wy * nz - wz * ny)
            cold[c, BEFORE + 2] = uy - (wz * nx - wx * nz)
            cold[c, BEFORE + 3] = uz - (wx * ny - wy * nx)
        gap, rest_speed = -cold[c, OVERLAP], cold[c, REST]
        if drift > 0.0:
            C[c, 7] = max(0.0, gap) / drift
            # at rest is what closes by no more than this kick has caused, and by what half a step's fall adds to that
            fastest = rest_speed * ((kick + 0.5 * drift) / dt)
        else:
            C[c, 7] = gap / dt if gap > 0.0 else bias_rate * gap
            fastest = rest_speed if gap > 0.0 and cold[c, APART] > 0.0 else np.inf  # what touched has been resolved
        if -vn > fastest:
            C[c, 7] = np.inf
            for k in range(4):
                C[c, 8 + k] = 0.0
        else:
            largest = max(largest, -vn, LOADED * C[c, 8] * Kn)
        for k in range(12, 16):
            C[c, k] = 0.0
    found[piece, CHANGE] = largest


@kernel
def press(lo: int, hi: int, pairs: IntArray, C: FloatArray, V: FloatArray, flags: IntArray) -> None:
    """Apply the impulses as they are: Δv = J/m, Δω = I⁻¹ (r × J), J on j and -J on i."""
    spins = flags[SPINS] != 0
    last = len(pairs) - 1
    for c in range(lo, hi):
        ahead = min(last, c + AHEAD)
        prefetch(V, pairs[ahead, 0], 0)
        prefetch(V, pairs[ahead, 1], 0)
        give(c, 0, pairs, C, V, spins, C[c, 8], C[c, 9], C[c, 10], C[c, 11])


@kernel
def relax(
    lo: int,
    hi: int,
    piece: int,
    pairs: IntArray,
    C: FloatArray,
    V: FloatArray,
    law: FloatArray,
    found: FloatArray,
    flags: IntArray,
    numbers: FloatArray,
    turning: tuple[()] | tuple[int],
) -> None:
    """Take contact after contact to where it neither closes nor pulls, at the velocities as they are."""
    spins, alpha, drift = len(turning) > 0, numbers[ALPHA], numbers[DRIFT]
    bodies = len(V) - (len(law) - 1)
    change, farthest, slope = 0.0, np.inf, 0.0
    last = len(pairs) - 1
    for c in range(lo, hi):
        ahead = min(last, c + AHEAD)
        i, j = pairs[ahead, 0], pairs[ahead, 1]
        prefetch(V, i, 0)
        prefetch(V, i, 8)
        prefetch(V, j, 0)
        prefetch(V, j, 8)
        may_close = C[c, 7]
        if may_close == np.inf:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz = C[c, 0], C[c, 1], C[c, 2]
        mi, mj = V[i, 6], V[j, 6]
        ux, uy, uz = V[j, 0] - V[i, 0], V[j, 1] - V[i, 1], V[j, 2] - V[i, 2]
        vn = ux * nx + uy * ny + uz * nz
        ux, uy, uz = ux - vn * nx, uy - vn * ny, uz - vn * nz
        if drift > 0.0 and j < bodies:
            way2 = (ux * ux + uy * uy + uz * uz) * drift * drift
            may_close += bend(C[c, 3] + C[c, 4] - may_close * drift, way2, drift)
        old = C[c, 8] + alpha * C[c, 12]
        Jn = max(0.0, old - (vn + may_close) * C[c, 5])
        more = Jn - old
        C[c, 8], C[c, 12] = Jn, more
        largest = abs(more)
        slope += more * may_close
        if more < 0.0:
            farthest = min(farthest, -Jn / more)
        Jx, Jy, Jz = more * nx, more * ny, more * nz
        if spins:
            ri, rj = C[c, 3], C[c, 4]
            wx, wy, wz = ri * V[i, 3] + rj * V[j, 3], ri * V[i, 4] + rj * V[j, 4], ri * V[i, 5] + rj * V[j, 5]
            ux, uy, uz = ux - (wy * nz - wz * ny), uy - (wz * nx - wx * nz), uz - (wx * ny - wy * nx)
            mt = C[c, 6]
            ox = C[c, 9] + alpha * C[c, 13]
            oy = C[c, 10] + alpha * C[c, 14]
            oz = C[c, 11] + alpha * C[c, 15]
            tx, ty, tz = ox - ux * mt, oy - uy * mt, oz - uz * mt
            size2 = tx * tx + ty * ty + tz * tz
            material = max(0, j - bodies + 1)
            most = law[material, 1] * Jn
            if size2 > most * most:
                scale = law[material, 2] * Jn / np.sqrt(size2)
                tx, ty, tz = scale * tx, scale * ty, scale * tz
            dx, dy, dz = tx - ox, ty - oy, tz - oz
            C[c, 9], C[c, 10], C[c, 11] = tx, ty, tz
            C[c, 13], C[c, 14], C[c, 15] = dx, dy, dz
            largest = max(largest, abs(dx), abs(dy), abs(dz))
            Jx, Jy, Jz = Jx + dx, Jy + dy, Jz + dz
            tx, ty, tz = nz * dy - ny * dz, nx * dz - nz * dx, ny * dx - nx * dy
            si, sj = ri * V[i, 7], rj * V[j, 7]
            if si > 0.0:
                V[i, 3] += si * tx
                V[i, 4] += si * ty
                V[i, 5] += si * tz
                V[i, 11] += si * tx
                V[i, 12] += si * ty
                V[i, 13] += si * tz
            if sj > 0.0:
                V[j, 3] += sj * tx
                V[j, 4] += sj * ty
                V[j, 5] += sj * tz
                V[j, 11] += sj * tx
                V[j, 12] += sj * ty
                V[j, 13] += sj * tz
        change = max(change, largest * (mi + mj))
        if mi > 0.0:
            V[i, 0] -= Jx * mi
            V[i, 1] -= Jy * mi
            V[i, 2] -= Jz * mi
            V[i, 8] -= Jx * mi
            V[i, 9] -= Jy * mi
            V[i, 10] -= Jz * mi
        if mj > 0.0:
            V[j, 0] += Jx * mj
            V[j, 1] += Jy * mj
            V[j, 2] += Jz * mj
            V[j, 8] += Jx * mj
            V[j, 9] += Jy * mj
            V[j, 10] += Jz * mj
    found[piece, CHANGE], found[piece, FARTHEST], found[piece, CLOSING] = change, farthest, slope


@kernel
def aim(block: int, V: FloatArray, who: IntArray, sums: FloatArray, flags: IntArray) -> None:
    """Sum m p·v + I t·ω, and m p² + I t²."""
    spins = flags[SPINS] != 0
    slope, curvature = 0.0, 0.0
    for k in range(block * BLOCK, min(len(who), (block + 1) * BLOCK)):
        b = who[k]
        if V[b, 6] > 0.0:
            px, py, pz, m = V[b, 8], V[b, 9], V[b, 10], 1.0 / V[b, 6]
            slope += (px * V[b, 0] + py * V[b, 1] + pz * V[b, 2]) * m
            curvature += (px * px + py * py + pz * pz) * m
        if spins and V[b, 7] > 0.0:
            tx, ty, tz, I = V[b, 11], V[b, 12], V[b, 13], 1.0 / V[b, 7]  # noqa: E741 - the symbol of the equation
            slope += (tx * V[b, 3] + ty * V[b, 4] + tz * V[b, 5]) * I
            curvature += (tx * tx + ty * ty + tz * tz) * I
    sums[block, 0], sums[block, 1] = slope, curvature


@kernel
def go(block: int, V: FloatArray, who: IntArray, flags: IntArray, alpha: float) -> None:
    """Change the velocities by α p and α t, and begin to sum those anew."""
    spins = flags[SPINS] != 0
    for k in range(block * BLOCK, min(len(who), (block + 1) * BLOCK)):
        b = who[k]
        for axis in range(3):
            V[b, axis] += alpha * V[b, 8 + axis]
            V[b, 8 + axis] = 0.0
        if spins:
            for axis in range(3, 6):
                V[b, axis] += alpha * V[b, 8 + axis]
                V[b, 8 + axis] = 0.0
