"""Velocities at a contact: what an impulse changes of them, and how fast a contact may close in a drift."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.jit import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def bend(R: float, t2: float, drift: float) -> float:
    """Return (R - √(R² - t²)) / dt, the closing speed that a way t along the tangent makes up for in a drift."""
    return t2 / ((R + np.sqrt(R * R - t2)) * drift) if 0.0 < t2 < R * R else 0.0


@kernel
def give(
    c: int,
    to: int,
    pairs: IntArray,
    C: FloatArray,
    V: FloatArray,
    spins: bool,
    Jn: float,
    tx: float,
    ty: float,
    tz: float,
) -> None:
    """Add what an impulse at a contact changes of the velocities, Δv = J/m and Δω = I⁻¹ (r × J), from a column on."""
    nx, ny, nz = C[c, 0], C[c, 1], C[c, 2]
    Jx, Jy, Jz = Jn * nx + tx, Jn * ny + ty, Jn * nz + tz
    tx, ty, tz = nz * ty - ny * tz, nx * tz - nz * tx, ny * tx - nx * ty
    for end in range(2):
        b = pairs[c, end]
        w = V[b, 6] if end == 1 else -V[b, 6]
        if w != 0.0:
            V[b, to] += Jx * w
            V[b, to + 1] += Jy * w
            V[b, to + 2] += Jz * w
            if spins:
                s = C[c, 3 + end] * V[b, 7]
                V[b, to + 3] += s * tx
                V[b, to + 4] += s * ty
                V[b, to + 5] += s * tz
