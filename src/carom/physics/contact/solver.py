"""Impacts: the contacts of a step, colour by colour, in sweeps until nothing approaches.

The equations stand in `impulse`. What each impulse does to the energy follows from the impulse itself,

    ΔE_n = J_n (v_n + ½ J_n / m_r),    1/m_r = 1/m_i + 1/m_j
    ΔE_t = -J_t (|u_t| - ½ J_t K_t),   K_t = 1/m_i + 1/m_j + ρ_i²/I_i + ρ_j²/I_j

and is summed for each contact: the loss by restitution, the loss by friction, and what the bias put in.

An impact is found at the end of a step, δ deep, where gravity has made it faster than it was at the surface and will
make the rebound slower. So that the pair leaves the surface with e times the speed at which it met it, the coefficient
at depth δ is

    e_δ² = e² + (1 - e²) · 2 a_n δ / v_n²,    a_n = (a_i - a_j)·n, where gravity presses them together

Without that the energy of every rebound is wrong by the potential over δ, in first order of the step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.continuous.trajectories import ROUNDING
from carom.physics.contact.load import (
    APART,
    APPROACH,
    BIAS,
    CHANGE,
    FASTEST,
    FOUND,
    IMPACTS_ONLY,
    LEDGER,
    OVERLAP,
    REST,
    RESTING,
    SPINS,
    SWEEP,
)
from carom.physics.ledger import FRICTION, RESTITUTION, STABILISATION
from carom.physics.parallel.jit import kernel, long_kernel
from carom.physics.parallel.prefetch import AHEAD, prefetch

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CONVERGED = 1e-9  # a sweep whose largest velocity change is this part of the first sweep's is the last


@kernel
def strike(
    lo: int,
    hi: int,
    piece: int,
    pairs: IntArray,
    C: FloatArray,
    cold: FloatArray,
    a: FloatArray,
    V: FloatArray,
    law: FloatArray,
    found: FloatArray,
    flags: IntArray,
    numbers: FloatArray,
) -> None:
    """Resolve a piece, once; note the largest change of a velocity.

    In the first sweep note the approach, too, the fastest one, and whether a contact is at rest. An impulse from a
    neighbour may make a contact close faster in a later sweep than it did at first: that is then its approach.

    ``C`` are the contacts' hot columns and ``V`` the bodies' motion, see `Load`.
    """
    spins, first, impacts_only = flags[SPINS] != 0, flags[SWEEP] == 0, flags[IMPACTS_ONLY] != 0
    bias_rate = numbers[BIAS]
    bodies = len(V) - (len(law) - 1)
    last = len(pairs) - 1
    largest_change, fastest, resting = 0.0, 0.0, False
    for c in range(lo, hi):
        prefetch(V, pairs[min(last, c + AHEAD), 0], 0)
        prefetch(V, pairs[min(last, c + AHEAD), 1], 0)
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz = C[c, 0], C[c, 1], C[c, 2]
        vx, vy, vz = V[j, 0] - V[i, 0], V[j, 1] - V[i, 1], V[j, 2] - V[i, 2]
        vn = vx * nx + vy * ny + vz * nz
        rests = -vn <= cold[c, REST]
        if first:
            cold[c, APPROACH] = max(0.0, -vn)
            fastest, resting = max(fastest, -vn), resting or rests
        if impacts_only and (
            rests or (cold[c, OVERLAP] < 0.0 and cold[c, APART] > 0.0)
        ):  # where contacts last, one across a gap has time
            continue
        material = max(0, j - bodies + 1)
        e = 0.0 if rests else law[material, 0]
        overlap = cold[c, FOUND]
        if first and e > 0.0 and overlap > 0.0:
            an = (a[i, 0] - a[j, 0]) * nx + (a[i, 1] - a[j, 1]) * ny + (a[i, 2] - a[j, 2]) * nz
            if an > 0.0:
                e = np.sqrt(e * e + (1.0 - e * e) * min(1.0, 2.0 * overlap * an / (vn * vn)))
        change = -(1.0 + e) * vn
        biased = change + bias_rate * overlap
        if biased <= 0.0:
            continue
        largest_change = max(largest_change, biased)
        if not rests and -vn > cold[c, APPROACH]:
            speeds = abs(V[i, 0]) + abs(V[i, 1]) + abs(V[i, 2]) + abs(V[j, 0]) + abs(V[j, 1]) + abs(V[j, 2])
            if -vn > ROUNDING * speeds:
                cold[c, APPROACH] = -vn
        mi, mj = V[i, 6], V[j, 6]
        Kn = mi + mj
        Jn = biased / Kn
        Jn_unbiased = max(0.0, change) / Kn
        lost = -Jn_unbiased * (vn + 0.5 * Jn_unbiased * Kn)
        cold[c, LEDGER + RESTITUTION] += lost
        cold[c, LEDGER + STABILISATION] += Jn * (vn + 0.5 * Jn * Kn) + lost
        Jx, Jy, Jz = Jn * nx, Jn * ny, Jn * nz
        if spins:
            ri, rj = C[c, 3], C[c, 4]
            wx, wy, wz = ri * V[i, 3] + rj * V[j, 3], ri * V[i, 4] + rj * V[j, 4], ri * V[i, 5] + rj * V[j, 5]
            ux = vx - vn * nx - (wy * nz - wz * ny)
            uy = vy - vn * ny - (wz * nx - wx * nz)
            uz = vz - vn * nz - (wx * ny - wy * nx)
            slip = np.sqrt(ux * ux + uy * uy + uz * uz)
            if slip > 0.0:
                Kt = Kn + ri * ri * V[i, 7] + rj * rj * V[j, 7]
                Jt = slip / Kt
                if Jt > law[material, 1] * Jn:
                    Jt = law[material, 2] * Jn
                cold[c, LEDGER + FRICTION] += Jt * (slip - 0.5 * Jt * Kt)
                dx, dy, dz = Jt * (ux / slip), Jt * (uy / slip), Jt * (uz / slip)
                Jx, Jy, Jz = Jx - dx, Jy - dy, Jz - dz
                # r × J is -ρ n × J_t for both bodies: the arms point in opposite directions, and so do the impulses
                tx, ty, tz = ny * dz - nz * dy, nz * dx - nx * dz, nx * dy - ny * dx
                si, sj = ri * V[i, 7], rj * V[j, 7]
                if si > 0.0:
                    V[i, 3] += si * tx
                    V[i, 4] += si * ty
                    V[i, 5] += si * tz
                if sj > 0.0:
                    V[j, 3] += sj * tx
                    V[j, 4] += sj * ty
                    V[j, 5] += sj * tz
        # What does not move is left alone: contacts of a colour may share it, and threads would pass its line around.
        if mi > 0.0:
            V[i, 0] -= Jx * mi
            V[i, 1] -= Jy * mi
            V[i, 2] -= Jz * mi
        if mj > 0.0:
            V[j, 0] += Jx * mj
            V[j, 1] += Jy * mj
            V[j, 2] += Jz * mj
    found[piece, CHANGE] = largest_change
    if first:
        found[piece, FASTEST], found[piece, RESTING] = fastest, resting


@long_kernel
def look_for_closing(
    lo: int,
    hi: int,
    pairs: IntArray,
    C: FloatArray,
    cold: FloatArray,
    v: FloatArray,
    negligible: float,
    closing: NDArray[np.bool_],
) -> None:
    """Say so if one of the contacts [lo, hi) closes faster than one at rest, and than a negligible speed, in m/s."""
    for c in range(lo, hi):
        vn = 0.0
        for k in range(3):
            vn += (v[pairs[c, 1], k] - v[pairs[c, 0], k]) * C[c, k]
        if -vn > max(cold[c, REST], negligible):
            closing[0] = True
            return
