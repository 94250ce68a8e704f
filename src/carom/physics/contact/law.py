"""The contact law: how far a contact rebounds, and what friction it can carry.

    v_n' = -e v_n                                   restitution (Newton), for impacts
    |J_t| ≤ μ_s J_n where the contact sticks,  |J_t| = μ_k J_n against the slip where it slides     (Coulomb)

The helpers take and return numbers, are inlined by Numba, and so cost nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.jit import inline

Records = NDArray[np.void]

MATERIAL = np.dtype([(name, np.float64) for name in ("restitution", "static_friction", "kinetic_friction")], align=True)


def materials_of(rows: NDArray[np.float64]) -> Records:
    """Return records, (k,), given (k, 3) restitution, static and kinetic friction of each material."""
    return np.ascontiguousarray(rows, dtype=np.float64).view(MATERIAL)[:, 0]


@inline
def material_index(j: int, bodies: int) -> int:
    """Return the material of a contact whose second end is j: 0 between bodies, 1 + p at plane p."""
    return max(0, j - bodies + 1)


@inline
def slip_velocity(
    tx: float, ty: float, tz: float, nx: float, ny: float, nz: float, wx: float, wy: float, wz: float
) -> tuple[float, float, float]:
    """Return the slip at the contact point, u = v_t - w × n.

    Parameters
    ----------
    tx, ty, tz
        m/s, v_t, the tangential part of the centres' relative velocity.
    nx, ny, nz
        The normal, from i to j.
    wx, wy, wz
        m/s, w = ρ_i ω_i + ρ_j ω_j, with the lever arms ρ.
    """
    return tx - (wy * nz - wz * ny), ty - (wz * nx - wx * nz), tz - (wx * ny - wy * nx)


@inline
def friction_impulse(sticking: float, normal: float, static_friction: float, kinetic_friction: float) -> float:
    """Return |J_t|, given the impulse that would end the slip and the normal impulse; all in N s."""
    return kinetic_friction * normal if sticking > static_friction * normal else sticking


@inline
def within_friction_cone(
    tx: float, ty: float, tz: float, normal: float, static_friction: float, kinetic_friction: float
) -> tuple[float, float, float]:
    """Return a tangential impulse as it is where the contact sticks with it, or the kinetic friction along it.

    The total impulse of a lasting contact is clamped, not what an iteration changes of it.
    """
    squared = tx * tx + ty * ty + tz * tz
    most = static_friction * normal
    if squared > most * most:
        scale = kinetic_friction * normal / np.sqrt(squared)
        tx, ty, tz = scale * tx, scale * ty, scale * tz
    return tx, ty, tz


@inline
def sticks(tx: float, ty: float, tz: float, normal: float, static_friction: float) -> bool:
    """Tell whether a tangential impulse is inside of the friction cone."""
    most = static_friction * normal
    return tx * tx + ty * ty + tz * tz < most * most
