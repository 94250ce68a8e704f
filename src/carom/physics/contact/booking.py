"""What the impulses of contacts that last did to the energy.

What an impulse takes out is -J·(v + v')/2, of the velocities before and after it. After the first kick there is one
more thing: gravity's work in the drift that follows is done on the velocity with J in it, but half of that work stands
in the first kick, which did not know J. The difference, J·Δv with Δv = (a_j - a_i) h, is booked with the impulse:

    lost_n = -λ_n ((v_n + v_n')/2 - Δv_n),    lost_t = -λ_t·((u + u')/2 - Δu)        Δv = 0 after the last kick

A body that lies still then loses in the one kick what it gains in the other, and nothing in all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.load import BEFORE, DRIFT, KICK, LEDGER, SPINS
from carom.physics.ledger import FRICTION, RESTITUTION, STABILISATION
from carom.physics.parallel.jit import kernel
from carom.physics.parallel.prefetch import AHEAD, prefetch

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def book(
    lo: int,
    hi: int,
    piece: int,
    pairs: IntArray,
    C: FloatArray,
    cold: FloatArray,
    a: FloatArray,
    V: FloatArray,
    found: FloatArray,
    flags: IntArray,
    numbers: FloatArray,
) -> None:
    """Write into the ledger what the impulses of a piece did, and the sums over the piece."""
    spins = flags[SPINS] != 0
    kick = numbers[KICK] if numbers[DRIFT] > 0.0 else 0.0
    bounced, rubbed, injected = 0.0, 0.0, 0.0
    last = len(pairs) - 1
    for c in range(lo, hi):
        ahead = min(last, c + AHEAD)
        prefetch(V, pairs[ahead, 0], 0)
        prefetch(V, pairs[ahead, 1], 0)
        Jn = C[c, 8]
        if Jn == 0.0:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz = C[c, 0], C[c, 1], C[c, 2]
        ux, uy, uz = V[j, 0] - V[i, 0], V[j, 1] - V[i, 1], V[j, 2] - V[i, 2]
        vn = ux * nx + uy * ny + uz * nz
        kx, ky, kz = (a[j, 0] - a[i, 0]) * kick, (a[j, 1] - a[i, 1]) * kick, (a[j, 2] - a[i, 2]) * kick
        kn = kx * nx + ky * ny + kz * nz
        if C[c, 7] < 0.0:  # the bias made it leave; without the bias it would have stayed
            lost = -Jn * (0.5 * cold[c, BEFORE] - kn)
            cold[c, LEDGER + STABILISATION] += 0.5 * Jn * vn
            injected += 0.5 * Jn * vn
        else:
            lost = -Jn * (0.5 * (cold[c, BEFORE] + vn) - kn)
        cold[c, LEDGER + RESTITUTION] += lost
        bounced += lost
        if not spins:
            continue
        ri, rj = C[c, 3], C[c, 4]
        wx, wy, wz = ri * V[i, 3] + rj * V[j, 3], ri * V[i, 4] + rj * V[j, 4], ri * V[i, 5] + rj * V[j, 5]
        ux = ux - vn * nx - (wy * nz - wz * ny)
        uy = uy - vn * ny - (wz * nx - wx * nz)
        uz = uz - vn * nz - (wx * ny - wy * nx)
        lost = -(
            C[c, 9] * (0.5 * (cold[c, BEFORE + 1] + ux) - (kx - kn * nx))
            + C[c, 10] * (0.5 * (cold[c, BEFORE + 2] + uy) - (ky - kn * ny))
            + C[c, 11] * (0.5 * (cold[c, BEFORE + 3] + uz) - (kz - kn * nz))
        )
        cold[c, LEDGER + FRICTION] += lost
        rubbed += lost
    found[piece, RESTITUTION], found[piece, FRICTION], found[piece, STABILISATION] = bounced, rubbed, injected
