"""Conjugate gradients for contacts that last, where sweeps hand a load on too slowly.

After the sweeps it is mostly known which contacts carry a load and which of these stick. For those the conditions of
`lasting` are equations,

    v_n + c = 0,    u = 0        or  A s = -(v + c),  A = G M⁻¹ Gᵀ,

with s the change of the impulses. Conjugate gradients (Hestenes & Stiefel 1952) solve them, preconditioned by the
diagonal of A; a contact that would pull is then let go, and sweeps say anew which contacts carry a load (projected
Gauss-Seidel with subspace minimisation; Silcowitz, Niebe & Erleben 2010).

A stack of n spheres takes some n iterations, and about n² sweeps; so does a load on spheres that are much lighter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.load import (
    ALLOWED,
    ALPHA,
    APPROACH,
    BETA,
    CHANGE,
    CLOSING,
    DIRECTION,
    DRIFT,
    DT,
    FARTHEST,
    FREE_NORMAL,
    FREE_TANGENT,
    NEGLIGIBLE,
    OVERLAP,
    PULL_MOST,
    PUSH_MOST,
    RESIDUAL,
    REST,
    SEARCH,
    SPINS,
    STEP,
    SWEEP,
    TOLERANCE,
)
from carom.physics.contact.velocity import bend, give
from carom.physics.parallel.jit import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# What a contact may close at when the search ends, in m/s. It begins where one closes at `crew.BAD_ENOUGH` times
# as much. Chosen so that the columns of tests/physics/test_convergence.py stand; with a tenth of the first number
# cloud-collapse takes twice as long, and none of its errors changes by a tenth.
PART_OF_REST = 0.3  # of the speed at which a contact at rest closes without an impulse
PART_OF_APPROACH = 0.03  # of the speed at which an impact closed
PART_OF_RADIUS = 3e-5  # of the smaller radius in a step
DEEP = 5e-3  # of the smaller radius: what rests so deep has sunk, little by little, and may close at
PART_WHEN_DEEP = 1e-2  # of the speed at rest only


@kernel
def measure(
    lo: int,
    hi: int,
    piece: int,
    pairs: IntArray,
    C: FloatArray,
    cold: FloatArray,
    V: FloatArray,
    law: FloatArray,
    found: FloatArray,
    flags: IntArray,
    numbers: FloatArray,
) -> None:
    """Find by how much, in m/s, a contact misses its condition by more than is tolerated; 0 if none does."""
    drift, bodies = numbers[DRIFT], len(V) - (len(law) - 1)
    tolerance, negligible = numbers[TOLERANCE], numbers[NEGLIGIBLE]
    excess = 0.0
    for c in range(lo, hi):
        if C[c, 7] == np.inf:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz, Jn = C[c, 0], C[c, 1], C[c, 2], C[c, 8]
        ux, uy, uz = V[j, 0] - V[i, 0], V[j, 1] - V[i, 1], V[j, 2] - V[i, 2]
        vn = ux * nx + uy * ny + uz * nz
        ux, uy, uz = ux - vn * nx, uy - vn * ny, uz - vn * nz
        allowed = C[c, 7]
        if drift > 0.0 and j < bodies:
            allowed += bend(C[c, 3] + C[c, 4] - allowed * drift, (ux * ux + uy * uy + uz * uz) * drift * drift, drift)
        missed = -(vn + allowed)
        if Jn > 0.0:
            missed = abs(missed)
        small = min(C[c, 3], C[c, 4]) if C[c, 4] > 0.0 else C[c, 3]
        # Before a drift the approach is that of the step before, which no checkpoint keeps.
        approach = 0.0 if drift > 0.0 else cold[c, APPROACH]
        allowed = tolerated(cold[c, REST], approach, cold[c, OVERLAP] / small, small / numbers[DT])
        excess = max(excess, missed - (tolerance * allowed + negligible))
    found[piece, CHANGE] = excess


@kernel
def tolerated(rest_speed: float, approach: float, depth: float, radius_per_step: float) -> float:
    """Return the speed at which a contact may close, in m/s, given its depth in radii and m/s for a radius a step."""
    if approach <= rest_speed and depth > DEEP:
        return PART_WHEN_DEEP * rest_speed
    return min(max(PART_OF_REST * rest_speed, PART_OF_APPROACH * approach), PART_OF_RADIUS * radius_per_step)


@kernel
def descend(
    lo: int,
    hi: int,
    piece: int,
    pairs: IntArray,
    C: FloatArray,
    S: FloatArray,
    V: FloatArray,
    law: FloatArray,
    found: FloatArray,
    flags: IntArray,
    numbers: FloatArray,
) -> None:
    """Go α along the direction; find the residual r = -(v + c) there, and the sum of r z, z = r / diag(A)."""
    spins, alpha = flags[SPINS] != 0, numbers[ALPHA]
    if flags[SWEEP] == 0:
        begin_search(lo, hi, pairs, C, S, V, law, spins, numbers[DRIFT])
    total, most, least = 0.0, 0.0, 0.0
    for c in range(lo, hi):
        normal, tangent = S[c, FREE_NORMAL] > 0.0, S[c, FREE_TANGENT] > 0.0
        if not (normal or tangent):
            continue
        if flags[SWEEP] > 0:
            for k in range(4):
                S[c, STEP + k] += alpha * S[c, DIRECTION + k]
            i, j = pairs[c, 0], pairs[c, 1]
            nx, ny, nz, ri, rj = C[c, 0], C[c, 1], C[c, 2], C[c, 3], C[c, 4]
            px, py, pz = V[j, 8] - V[i, 8], V[j, 9] - V[i, 9], V[j, 10] - V[i, 10]
            pn = px * nx + py * ny + pz * nz
            if normal:
                S[c, RESIDUAL] -= alpha * pn
            if tangent:
                wx, wy, wz = ri * V[i, 11] + rj * V[j, 11], ri * V[i, 12] + rj * V[j, 12], ri * V[i, 13] + rj * V[j, 13]
                S[c, RESIDUAL + 1] -= alpha * (px - pn * nx - (wy * nz - wz * ny))
                S[c, RESIDUAL + 2] -= alpha * (py - pn * ny - (wz * nx - wx * nz))
                S[c, RESIDUAL + 3] -= alpha * (pz - pn * nz - (wx * ny - wy * nx))
        most, least = max(most, C[c, 8] + S[c, STEP]), min(least, C[c, 8] + S[c, STEP])
        total += S[c, RESIDUAL] * S[c, RESIDUAL] * C[c, 5]
        rx, ry, rz = S[c, RESIDUAL + 1], S[c, RESIDUAL + 2], S[c, RESIDUAL + 3]
        total += (rx * rx + ry * ry + rz * rz) * C[c, 6]
    found[piece, CHANGE], found[piece, PUSH_MOST], found[piece, PULL_MOST] = total, most, -least


@kernel
def begin_search(
    lo: int,
    hi: int,
    pairs: IntArray,
    C: FloatArray,
    S: FloatArray,
    V: FloatArray,
    law: FloatArray,
    spins: bool,
    drift: float,
) -> None:
    """Find which impulses are free: normal ones of contacts that push or close, tangential ones of those that stick."""
    bodies = len(V) - (len(law) - 1)
    for c in range(lo, hi):
        for k in range(SEARCH):
            S[c, k] = 0.0
        if C[c, 7] == np.inf:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz, ri, rj = C[c, 0], C[c, 1], C[c, 2], C[c, 3], C[c, 4]
        ux, uy, uz = V[j, 0] - V[i, 0], V[j, 1] - V[i, 1], V[j, 2] - V[i, 2]
        vn = ux * nx + uy * ny + uz * nz
        ux, uy, uz = ux - vn * nx, uy - vn * ny, uz - vn * nz
        allowed = C[c, 7]
        if drift > 0.0 and j < bodies:
            allowed += bend(ri + rj - allowed * drift, (ux * ux + uy * uy + uz * uz) * drift * drift, drift)
        S[c, ALLOWED] = allowed
        if C[c, 8] > 0.0 or vn + allowed <= 0.0:
            S[c, FREE_NORMAL], S[c, RESIDUAL] = 1.0, -(vn + allowed)
        if spins:
            most = law[max(0, j - bodies + 1), 1] * C[c, 8]
            if C[c, 9] * C[c, 9] + C[c, 10] * C[c, 10] + C[c, 11] * C[c, 11] < most * most:
                wx, wy, wz = ri * V[i, 3] + rj * V[j, 3], ri * V[i, 4] + rj * V[j, 4], ri * V[i, 5] + rj * V[j, 5]
                S[c, FREE_TANGENT] = 1.0
                S[c, RESIDUAL + 1] = -(ux - (wy * nz - wz * ny))
                S[c, RESIDUAL + 2] = -(uy - (wz * nx - wx * nz))
                S[c, RESIDUAL + 3] = -(uz - (wx * ny - wy * nx))


@kernel
def spread(
    lo: int,
    hi: int,
    pairs: IntArray,
    C: FloatArray,
    S: FloatArray,
    V: FloatArray,
    flags: IntArray,
    numbers: FloatArray,
) -> None:
    """Turn the direction, d = z + β d, and add up by how much it changes the velocities of the bodies, p and t."""
    spins, beta = flags[SPINS] != 0, numbers[BETA]
    for c in range(lo, hi):
        if S[c, FREE_NORMAL] > 0.0 or S[c, FREE_TANGENT] > 0.0:
            S[c, DIRECTION] = C[c, 5] * S[c, RESIDUAL] + beta * S[c, DIRECTION]
            for k in range(1, 4):
                S[c, DIRECTION + k] = C[c, 6] * S[c, RESIDUAL + k] + beta * S[c, DIRECTION + k]
            d = S[c, DIRECTION], S[c, DIRECTION + 1], S[c, DIRECTION + 2], S[c, DIRECTION + 3]
            give(c, 8, pairs, C, V, spins, *d)


@kernel
def project(
    lo: int,
    hi: int,
    piece: int,
    pairs: IntArray,
    C: FloatArray,
    S: FloatArray,
    V: FloatArray,
    found: FloatArray,
    flags: IntArray,
) -> None:
    """Let go of contacts that would pull, and lay out what is left of the change for a line search."""
    spins, slope = flags[SPINS] != 0, 0.0
    for c in range(lo, hi):
        for k in range(4):
            C[c, 12 + k] = S[c, STEP + k]
        if C[c, 8] + C[c, 12] < 0.0:
            for k in range(4):
                C[c, 12 + k] = -C[c, 8 + k]
        if C[c, 7] != np.inf:
            slope += C[c, 12] * S[c, ALLOWED]
            give(c, 8, pairs, C, V, spins, C[c, 12], C[c, 13], C[c, 14], C[c, 15])
    found[piece, FARTHEST], found[piece, CLOSING] = 1.0, slope
