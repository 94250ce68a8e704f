"""Two ends that touch: their relative velocity, and an impulse on both.

For what happens once a kick. Sweeps over contacts write both out again (`solver`, `sweep`), since Numba counts
references to every array that is handed to a function: 65 instead of 28 ns a contact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]


@kernel
def relative(
    c: int, i: int, j: int, normals: FloatArray, arms: FloatArray, velocity: FloatArray, angular_velocity: FloatArray
) -> tuple[float, float, float, float]:
    """Return v_n, and the slip u of j's contact point as seen from i's, in m/s."""
    nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
    vx = velocity[j, 0] - velocity[i, 0]
    vy = velocity[j, 1] - velocity[i, 1]
    vz = velocity[j, 2] - velocity[i, 2]
    vn = vx * nx + vy * ny + vz * nz
    vx, vy, vz = vx - vn * nx, vy - vn * ny, vz - vn * nz
    if len(angular_velocity) > 0:
        ri, rj = arms[c, 0], arms[c, 1]
        wx = ri * angular_velocity[i, 0] + rj * angular_velocity[j, 0]
        wy = ri * angular_velocity[i, 1] + rj * angular_velocity[j, 1]
        wz = ri * angular_velocity[i, 2] + rj * angular_velocity[j, 2]
        vx, vy, vz = vx - (wy * nz - wz * ny), vy - (wz * nx - wx * nz), vz - (wx * ny - wy * nx)
    return vn, vx, vy, vz


@kernel
def apply(
    c: int,
    i: int,
    j: int,
    Jx: float,
    Jy: float,
    Jz: float,
    normals: FloatArray,
    arms: FloatArray,
    velocity: FloatArray,
    angular_velocity: FloatArray,
    inverse_mass: FloatArray,
    inverse_inertia: FloatArray,
) -> None:
    """Δv = J/m, Δω = I⁻¹ (r × J): J on j, -J on i."""
    velocity[i, 0] -= Jx * inverse_mass[i]
    velocity[i, 1] -= Jy * inverse_mass[i]
    velocity[i, 2] -= Jz * inverse_mass[i]
    velocity[j, 0] += Jx * inverse_mass[j]
    velocity[j, 1] += Jy * inverse_mass[j]
    velocity[j, 2] += Jz * inverse_mass[j]
    if len(angular_velocity) > 0:
        nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
        tx, ty, tz = nz * Jy - ny * Jz, nx * Jz - nz * Jx, ny * Jx - nx * Jy
        si, sj = arms[c, 0] * inverse_inertia[i], arms[c, 1] * inverse_inertia[j]
        angular_velocity[i, 0] += si * tx
        angular_velocity[i, 1] += si * ty
        angular_velocity[i, 2] += si * tz
        angular_velocity[j, 0] += sj * tx
        angular_velocity[j, 1] += sj * ty
        angular_velocity[j, 2] += sj * tz
