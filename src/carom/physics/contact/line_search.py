"""Between two sweeps: what the last one changed is changed once more, as far as that helps.

A sweep hands a load on from contact to contact, and where a light body lies between heavy ones it hands on very little.
So after each sweep the change s that it made of all impulses is made once more, α times, as far as that brings the
contacts nearer to what is asked (an exact line search, with A s the velocities at the contacts that impulses s cause)
and no contact begins to pull (λ_n ≥ 0):

    α = -s·(v + c) / s·(A s),   v the velocities at the contacts, v_n and u

A ball squeezed between two that are 10⁹ times heavier is then held to 10⁻¹¹ of its radius. Sweeps alone let it sink by
0.1 radii at 10², and 100 of them at 10³. A stack of 20 that begins without impulses sags with 10⁻⁶ of the energy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def push(
    pairs: IntArray,
    normals: FloatArray,
    arms: FloatArray,
    inverse_mass: FloatArray,
    inverse_inertia: FloatArray,
    step: FloatArray,
    pushed: FloatArray,
    turned: FloatArray,
) -> None:
    """Write the velocities that the impulses ``step`` cause."""
    for i in range(len(pushed)):
        pushed[i, 0] = pushed[i, 1] = pushed[i, 2] = 0.0
    for i in range(len(turned)):
        turned[i, 0] = turned[i, 1] = turned[i, 2] = 0.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz, Jn = normals[c, 0], normals[c, 1], normals[c, 2], step[c, 0]
        Jx, Jy, Jz = step[c, 1] + Jn * nx, step[c, 2] + Jn * ny, step[c, 3] + Jn * nz
        for k, J in enumerate((Jx, Jy, Jz)):
            pushed[i, k] -= J * inverse_mass[i]
            pushed[j, k] += J * inverse_mass[j]
        if len(turned) > 0:
            si, sj = arms[c, 0] * inverse_inertia[i], arms[c, 1] * inverse_inertia[j]
            for k, t in enumerate((nz * Jy - ny * Jz, nx * Jz - nz * Jx, ny * Jx - nx * Jy)):
                turned[i, k] += si * t
                turned[j, k] += sj * t


@kernel
def farther(
    pairs: IntArray,
    normals: FloatArray,
    arms: FloatArray,
    closing: FloatArray,
    dt: float,
    velocity: FloatArray,
    angular_velocity: FloatArray,
    bodies: int,
    impulse: FloatArray,
    step: FloatArray,
    pushed: FloatArray,
    turned: FloatArray,
) -> float:
    """Return how many times over what a sweep changed should be changed again: α, or 0 where that would not help."""
    slope, curvature, farthest = 0.0, 0.0, np.inf
    spins = len(turned) > 0
    for c in range(len(pairs)):
        if closing[c] == np.inf:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz, sn = normals[c, 0], normals[c, 1], normals[c, 2], step[c, 0]
        # s·v = J·(v_j - v_i) - (ρ_i ω_i + ρ_j ω_j)·(n × J_t), with J = s_n n + s_t
        tx, ty, tz = step[c, 1], step[c, 2], step[c, 3]
        Jx, Jy, Jz = tx + sn * nx, ty + sn * ny, tz + sn * nz
        vx, vy, vz = velocity[j, 0] - velocity[i, 0], velocity[j, 1] - velocity[i, 1], velocity[j, 2] - velocity[i, 2]
        px, py, pz = pushed[j, 0] - pushed[i, 0], pushed[j, 1] - pushed[i, 1], pushed[j, 2] - pushed[i, 2]
        may_close = closing[c]
        if dt > 0.0 and j < bodies:
            vn = vx * nx + vy * ny + vz * nz
            R, t2 = arms[c, 0] + arms[c, 1] - may_close * dt, (vx * vx + vy * vy + vz * vz - vn * vn) * dt * dt
            if 0.0 < t2 < R * R:
                may_close += t2 / ((R + np.sqrt(R * R - t2)) * dt)
        slope += Jx * vx + Jy * vy + Jz * vz + sn * may_close
        curvature += Jx * px + Jy * py + Jz * pz
        if spins:
            ri, rj = arms[c, 0], arms[c, 1]
            cx, cy, cz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
            for k, turn in enumerate((cx, cy, cz)):
                slope -= (ri * angular_velocity[i, k] + rj * angular_velocity[j, k]) * turn
                curvature -= (ri * turned[i, k] + rj * turned[j, k]) * turn
        if sn < 0.0:
            farthest = min(farthest, -impulse[c, 0] / sn)
    if slope >= 0.0 or curvature <= 0.0:
        return 0.0
    return min(-slope / curvature, farthest)
