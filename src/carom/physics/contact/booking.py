"""What the impulses of contacts that last did to the energy and to the spins.

What an impulse takes out is -J·(v + v')/2, of the velocities before and after it. After the first kick there is one
more thing: gravity's work in the drift that follows is done on the velocity with J in it, but half of that work stands
in the first kick, which did not know J. The difference, J·Δv with Δv = (a_j - a_i) h, is booked with the impulse:

    lost_n = -λ_n ((v_n + v_n')/2 - Δv_n),    lost_t = -λ_t·((u + u')/2 - Δu)        Δv = 0 after the last kick

A body that lies still then loses in the one kick what it gains in the other, and nothing in all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.solver import FRICTION, RESTITUTION, STABILISATION
from carom.physics.contact.touch import relative
from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def book(
    pairs: IntArray,
    normals: FloatArray,
    arms: FloatArray,
    closing: FloatArray,
    before: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    angular_velocity: FloatArray,
    kick: float,
    impulse: FloatArray,
    ledger: FloatArray,
    angular_impulse: FloatArray,
) -> None:
    """Write what the impulses did to the energy and to the spins."""
    for c in range(len(pairs)):
        Jn = impulse[c, 0]
        if Jn == 0.0:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
        vn, ux, uy, uz = relative(c, i, j, normals, arms, velocity, angular_velocity)
        kx = (acceleration[j, 0] - acceleration[i, 0]) * kick
        ky = (acceleration[j, 1] - acceleration[i, 1]) * kick
        kz = (acceleration[j, 2] - acceleration[i, 2]) * kick
        kn = kx * nx + ky * ny + kz * nz
        if closing[c] < 0.0:  # the bias made it leave; without the bias it would have stayed
            ledger[c, RESTITUTION] -= Jn * (0.5 * before[c, 0] - kn)
            ledger[c, STABILISATION] += 0.5 * Jn * vn
        else:
            ledger[c, RESTITUTION] -= Jn * (0.5 * (before[c, 0] + vn) - kn)
        if len(angular_velocity) == 0:
            continue
        Jx, Jy, Jz = impulse[c, 1], impulse[c, 2], impulse[c, 3]
        ledger[c, FRICTION] -= (
            Jx * (0.5 * (before[c, 1] + ux) - (kx - kn * nx))
            + Jy * (0.5 * (before[c, 2] + uy) - (ky - kn * ny))
            + Jz * (0.5 * (before[c, 3] + uz) - (kz - kn * nz))
        )
        # r × J is -ρ n × J for both ends: the arms point in opposite directions, and so do the impulses
        for end in range(2):
            body, rho = pairs[c, end], arms[c, end]
            angular_impulse[body, 0] -= rho * (ny * Jz - nz * Jy)
            angular_impulse[body, 1] -= rho * (nz * Jx - nx * Jz)
            angular_impulse[body, 2] -= rho * (nx * Jy - ny * Jx)
