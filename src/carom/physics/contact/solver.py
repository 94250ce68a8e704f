"""Staged impulses: the contacts of a step, colour by colour, in sweeps until nothing approaches.

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

from carom.physics.kernel import kernel, long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

RESTITUTION, FRICTION, STABILISATION = 0, 1, 2  # columns of a contact's ledger

CONVERGED = 1e-9  # a sweep whose largest velocity change is this part of the first sweep's is the last


@long_kernel
def resolve_contacts(
    order: IntArray,
    pairs: IntArray,
    normals: FloatArray,
    arms: FloatArray,
    overlaps: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    angular_velocity: FloatArray,
    inverse_mass: FloatArray,
    inverse_inertia: FloatArray,
    law: FloatArray,
    rest_speed: FloatArray,
    impacts_only: bool,
    bias_rate: float,
    most_sweeps: int,
    ledger: FloatArray,
    approach: FloatArray,
    angular_impulse: FloatArray,
) -> int:
    """Resolve the contacts of a step and return the number of sweeps.

    Sweeps end when one of them changes next to nothing, or at ``most_sweeps``.

    Parameters
    ----------
    order
        (m,) contacts in the order of their stages.
    pairs, normals, arms, overlaps
        Geometry of the contacts, (m, 2), (m, 3), (m, 2), (m,).
    velocity, acceleration, angular_velocity, inverse_mass, inverse_inertia
        Of the n bodies and, after them, of the planes; (0, 3) angular velocities without spin.
    law
        (1 + p, 3) restitution, static and kinetic friction: between bodies, then of each plane.
    rest_speed
        (m,) m/s; an approach up to this speed is a contact at rest and does not bounce.
    impacts_only
        Whether contacts at rest are left alone.
    bias_rate
        1/s; separation speed for each metre of overlap (Baumgarte), 0 for none.
    ledger
        (m, 3) J, added to: what left by restitution and by friction, what the bias put in.
    approach
        (m,) m/s, overwritten: the speed at which each contact closed when it was first visited.
    angular_impulse
        (n + p, 3) N m s, added to: Σ r × J of each end; (0, 3) without spin.
    """
    bodies = len(inverse_mass) - (len(law) - 1)
    spins = len(angular_velocity) > 0
    first_change = 0.0
    for sweep in range(most_sweeps):
        largest_change = 0.0
        for c in order:
            i, j = pairs[c, 0], pairs[c, 1]
            nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
            vx = velocity[j, 0] - velocity[i, 0]
            vy = velocity[j, 1] - velocity[i, 1]
            vz = velocity[j, 2] - velocity[i, 2]
            vn = vx * nx + vy * ny + vz * nz
            if sweep == 0:
                approach[c] = max(0.0, -vn)
            if impacts_only and -vn <= rest_speed[c]:
                continue
            material = max(0, j - bodies + 1)
            e = law[material, 0] if -vn > rest_speed[c] else 0.0
            if sweep == 0 and e > 0.0 and overlaps[c] > 0.0:
                fall = (
                    2.0
                    * overlaps[c]
                    * -(
                        (acceleration[j, 0] - acceleration[i, 0]) * nx
                        + (acceleration[j, 1] - acceleration[i, 1]) * ny
                        + (acceleration[j, 2] - acceleration[i, 2]) * nz
                    )
                )
                if fall > 0.0:
                    e = np.sqrt(e * e + (1.0 - e * e) * min(1.0, fall / (vn * vn)))
            change = -(1.0 + e) * vn
            biased = change + bias_rate * max(0.0, overlaps[c])
            if biased <= 0.0:
                continue
            largest_change = max(largest_change, biased)
            Kn = inverse_mass[i] + inverse_mass[j]
            Jn = biased / Kn
            Jn_unbiased = max(0.0, change) / Kn
            lost = -Jn_unbiased * (vn + 0.5 * Jn_unbiased * Kn)
            ledger[c, RESTITUTION] += lost
            ledger[c, STABILISATION] += Jn * (vn + 0.5 * Jn * Kn) + lost
            Jx, Jy, Jz = Jn * nx, Jn * ny, Jn * nz
            if spins:
                ri, rj = arms[c, 0], arms[c, 1]
                wx = ri * angular_velocity[i, 0] + rj * angular_velocity[j, 0]
                wy = ri * angular_velocity[i, 1] + rj * angular_velocity[j, 1]
                wz = ri * angular_velocity[i, 2] + rj * angular_velocity[j, 2]
                ux = vx - vn * nx - (wy * nz - wz * ny)
                uy = vy - vn * ny - (wz * nx - wx * nz)
                uz = vz - vn * nz - (wx * ny - wy * nx)
                slip = np.sqrt(ux * ux + uy * uy + uz * uz)
                if slip > 0.0:
                    Kt = Kn + ri * ri * inverse_inertia[i] + rj * rj * inverse_inertia[j]
                    Jt = slip / Kt
                    if Jt > law[material, 1] * Jn:
                        Jt = law[material, 2] * Jn
                    ledger[c, FRICTION] += Jt * (slip - 0.5 * Jt * Kt)
                    Jx -= Jt * (ux / slip)
                    Jy -= Jt * (uy / slip)
                    Jz -= Jt * (uz / slip)
                    # r × J is -ρ n × J for both bodies: the arms point in opposite directions, and so do the impulses
                    tx, ty, tz = nz * Jy - ny * Jz, nx * Jz - nz * Jx, ny * Jx - nx * Jy
                    angular_impulse[i, 0] += ri * tx
                    angular_impulse[i, 1] += ri * ty
                    angular_impulse[i, 2] += ri * tz
                    angular_impulse[j, 0] += rj * tx
                    angular_impulse[j, 1] += rj * ty
                    angular_impulse[j, 2] += rj * tz
                    si, sj = ri * inverse_inertia[i], rj * inverse_inertia[j]
                    angular_velocity[i, 0] += si * tx
                    angular_velocity[i, 1] += si * ty
                    angular_velocity[i, 2] += si * tz
                    angular_velocity[j, 0] += sj * tx
                    angular_velocity[j, 1] += sj * ty
                    angular_velocity[j, 2] += sj * tz
            velocity[i, 0] -= Jx * inverse_mass[i]
            velocity[i, 1] -= Jy * inverse_mass[i]
            velocity[i, 2] -= Jz * inverse_mass[i]
            velocity[j, 0] += Jx * inverse_mass[j]
            velocity[j, 1] += Jy * inverse_mass[j]
            velocity[j, 2] += Jz * inverse_mass[j]
        if sweep == 0:
            first_change = largest_change
        if largest_change <= CONVERGED * first_change:
            return sweep + 1
    return most_sweeps


@kernel
def still_closing(
    pairs: IntArray, normals: FloatArray, velocity: FloatArray, approach: FloatArray, rest_speed: FloatArray
) -> bool:
    """Tell whether a contact closes faster than one at rest after the sweeps: there were too few of them."""
    largest = 0.0
    for c in range(len(pairs)):
        largest = max(largest, approach[c])
    for c in range(len(pairs)):
        vn = 0.0
        for k in range(3):
            vn += (velocity[pairs[c, 1], k] - velocity[pairs[c, 0], k]) * normals[c, k]
        if -vn > max(rest_speed[c], CONVERGED * largest):
            return True
    return False
