"""Contacts that last: impulses that hold bodies at rest on each other, remembered from step to step.

A resting contact carries a force, and a force belongs where the other forces are: into both kicks of a step. After each
kick of length h the impulses λ of all contacts are found together such that

    v_n + c ≥ 0,   λ_n ≥ 0,   λ_n (v_n + c) = 0                                    (Signorini)
    |λ_t| ≤ μ_s λ_n where the contact sticks, λ_t = -μ_k λ_n u/|u| where it slides      (Coulomb)

by sweeps over the contacts (projected Gauss-Seidel; Moreau 1988, Jean 1999, and as "sequential impulses" Catto 2006).
The *totals* are clamped, not the increments: what one sweep pushed too far a later one takes back. They begin with the
totals of the kick before, scaled by the ratio of the lengths, so that a pile at rest needs one sweep.

A sweep hands a load on from contact to contact, and where a light body lies between heavy ones it hands on very little.
So after each sweep the change s that it made of all impulses is made once more, α times, as far as that brings the
contacts nearer to what is asked (an exact line search, with A s the velocities at the contacts that impulses s cause)
and no contact begins to pull (λ_n ≥ 0):

    α = -s·(v + c) / s·(A s),   v the velocities at the contacts, v_n and u

A ball squeezed between two that are 10⁹ times heavier is then held to 10⁻¹¹ of its radius. Sweeps alone let it sink by
0.1 radii at 10², and 100 of them at 10³. A stack of 20 that begins without impulses sags with 10⁻⁶ of the energy.

After the last kick c = 0: nothing closes. After the first kick bodies may close by c dt, so that they touch when the
drift is over: |d n + v dt| ≥ r_i + r_j, with v_t the tangential velocity of the centres,

    c dt = gap + R - √(R² - v_t² dt²),   R = r_i + r_j

Without the root two spheres that roll about each other would drift apart along the tangent, and the contact would be
lost and made again in every other step. Together this is RATTLE (Andersen 1983) for contacts.

Impacts are not handled here. They are resolved before, one by one, with their restitution; a step without a contact at
rest does not come here at all.

What an impulse takes out is -J·(v + v')/2, of the velocities before and after it. After the first kick there is one
more thing: gravity's work in the drift that follows is done on the velocity with J in it, but half of that work stands
in the first kick, which did not know J. The difference, J·Δv with Δv = (a_j - a_i) h, is booked with the impulse:

    lost_n = -λ_n ((v_n + v_n')/2 - Δv_n),    lost_t = -λ_t·((u + u')/2 - Δu)        Δv = 0 after the last kick

A body that lies still then loses in the one kick what it gains in the other, and nothing in all.

Rejected: the seed's stages with restitution 0 (a pile of 1000 keeps jittering at the rest speed), impulses at the end
of the step only (a body falls a dt²/2 into the ground in every step and has to be pushed back).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Ends
from carom.physics.contact.solver import FRICTION, RESTITUTION, STABILISATION
from carom.physics.kernel import kernel, long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CONVERGED = 1e-8  # a sweep that changes no velocity by more than this part of the largest that the contacts undo


@dataclass(slots=True)
class Hold:
    """The impulses that a set of contacts carried in the last kick."""

    pairs: IntArray  # (m, 2), sorted
    impulse: FloatArray  # (m, 4) N s: λ_n, λ_t
    kick: float  # s, how long that kick was

    @classmethod
    def empty(cls) -> Hold:
        """Return what a run begins with."""
        return cls(np.empty((0, 2), dtype=np.int64), np.empty((0, 4)), 0.0)

    def carried_to(self, pairs: IntArray, normals: FloatArray, kick: float) -> FloatArray:
        """Return what contacts that were there before carried, (m, 4), for a kick of another length; 0 for new ones."""
        impulse = np.zeros((len(pairs), 4))
        if self.kick > 0.0 and kick > 0.0:
            _carry(self.pairs, self.impulse, kick / self.kick, pairs, normals, impulse)
        return impulse


def hold(
    order: IntArray,
    pairs: IntArray,
    normals: FloatArray,
    arms: FloatArray,
    closing: FloatArray,
    dt: float,
    fastest: FloatArray,
    ends: Ends,
    spins: bool,
    law: FloatArray,
    kick: float,
    impulse: FloatArray,
    most_sweeps: int,
    ledger: FloatArray,
    angular_impulse: FloatArray,
) -> int:
    """Find the impulses of a kick, apply them and return the number of sweeps.

    Parameters
    ----------
    order, pairs, normals, arms, law, ledger, angular_impulse
        As for `resolve_contacts`.
    closing
        (m,) m/s; the speed at which a contact may close: gap/dt, or minus the speed that a bias wants.
    dt
        s, length of the drift to come, 0 after the last kick.
    fastest
        (m,) m/s; what closes faster is an impact yet to come, and left alone.
    kick
        s, length of the first kick if the drift is still to come, 0 after the last kick.
    impulse
        (m, 4) N s, λ_n and λ_t: the first guess, and then the result.
    """
    spinning = ends.angular_velocity if spins else ends.angular_velocity[:0]
    before = np.empty((len(pairs), 4))
    sweeps: int = _hold(
        order,
        pairs,
        normals,
        arms,
        closing,
        dt,
        fastest,
        ends.velocity,
        spinning,
        ends.inverse_mass,
        ends.inverse_inertia,
        law,
        impulse,
        most_sweeps,
        before,
        np.empty((len(pairs), 3)),
        np.zeros((len(pairs), 4)),
        np.empty_like(ends.velocity),
        np.empty_like(spinning),
    )
    _book(
        pairs,
        normals,
        arms,
        closing,
        before,
        ends.velocity,
        ends.acceleration,
        spinning,
        kick,
        impulse,
        ledger,
        angular_impulse,
    )
    return sweeps


@kernel
def _carry(
    old_pairs: IntArray,
    old: FloatArray,
    ratio: float,
    pairs: IntArray,
    normals: FloatArray,
    impulse: FloatArray,
) -> None:
    """Find each pair among the old ones, both sorted; turn its tangential impulse into the new tangential plane."""
    k = 0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        while k < len(old_pairs) and (old_pairs[k, 0] < i or (old_pairs[k, 0] == i and old_pairs[k, 1] < j)):
            k += 1
        if k < len(old_pairs) and old_pairs[k, 0] == i and old_pairs[k, 1] == j:
            along = 0.0
            for axis in range(3):
                along += old[k, 1 + axis] * normals[c, axis]
            impulse[c, 0] = ratio * old[k, 0]
            for axis in range(3):
                impulse[c, 1 + axis] = ratio * (old[k, 1 + axis] - along * normals[c, axis])


@long_kernel
def _hold(
    order: IntArray,
    pairs: IntArray,
    normals: FloatArray,
    arms: FloatArray,
    closing: FloatArray,
    dt: float,
    fastest: FloatArray,
    velocity: FloatArray,
    angular_velocity: FloatArray,
    inverse_mass: FloatArray,
    inverse_inertia: FloatArray,
    law: FloatArray,
    impulse: FloatArray,
    most_sweeps: int,
    before: FloatArray,
    lightness: FloatArray,
    step: FloatArray,
    pushed: FloatArray,
    turned: FloatArray,
) -> int:
    """Apply the impulses; write v_n and u from ``before`` that; return the number of sweeps.

    ``lightness``, (m, 3), is room for 1/m_i + 1/m_j, its inverse, and the mass that a tangential impulse moves;
    ``step``, (m, 4) of zeros, for what a sweep changed; ``pushed`` and ``turned`` for the velocities that this caused.
    """
    spins = len(angular_velocity) > 0
    bodies = len(inverse_mass) - (len(law) - 1)
    largest = 0.0  # m/s, the largest velocity that a contact undoes
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        Kn = inverse_mass[i] + inverse_mass[j]
        lightness[c, 0], lightness[c, 1] = Kn, 1.0 / Kn
        if spins:
            ri, rj = arms[c, 0], arms[c, 1]
            lightness[c, 2] = 1.0 / (Kn + ri * ri * inverse_inertia[i] + rj * rj * inverse_inertia[j])
        vn, ux, uy, uz = _relative(c, i, j, normals, arms, velocity, angular_velocity)
        before[c, 0], before[c, 1], before[c, 2], before[c, 3] = vn, ux, uy, uz
        if -vn > fastest[c]:
            closing[c] = np.inf
            for k in range(4):
                impulse[c, k] = 0.0
        else:
            largest = max(largest, -vn)
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        Jn = impulse[c, 0]
        largest = max(largest, Jn * (inverse_mass[i] + inverse_mass[j]))
        Jx, Jy, Jz = impulse[c, 1], impulse[c, 2], impulse[c, 3]
        Jx, Jy, Jz = Jx + Jn * normals[c, 0], Jy + Jn * normals[c, 1], Jz + Jn * normals[c, 2]
        _apply(c, i, j, Jx, Jy, Jz, normals, arms, velocity, angular_velocity, inverse_mass, inverse_inertia)
    sweeps = 0
    change = np.inf
    while sweeps < most_sweeps and change > CONVERGED * largest:
        sweeps += 1
        change = 0.0
        for c in order:
            if closing[c] == np.inf:
                continue
            i, j = pairs[c, 0], pairs[c, 1]
            nx, ny, nz = normals[c, 0], normals[c, 1], normals[c, 2]
            vx = velocity[j, 0] - velocity[i, 0]
            vy = velocity[j, 1] - velocity[i, 1]
            vz = velocity[j, 2] - velocity[i, 2]
            vn = vx * nx + vy * ny + vz * nz
            ux, uy, uz = vx - vn * nx, vy - vn * ny, vz - vn * nz
            may_close = closing[c]
            if dt > 0.0 and j < bodies:
                R, t2 = arms[c, 0] + arms[c, 1] - may_close * dt, (ux * ux + uy * uy + uz * uz) * dt * dt
                if 0.0 < t2 < R * R:
                    may_close += t2 / ((R + np.sqrt(R * R - t2)) * dt)
            Jn = max(0.0, impulse[c, 0] - (vn + may_close) * lightness[c, 1])
            more = Jn - impulse[c, 0]
            impulse[c, 0] = Jn
            step[c, 0] = more
            change = max(change, abs(more) * lightness[c, 0])
            Jx, Jy, Jz = more * nx, more * ny, more * nz
            if spins:
                ri, rj = arms[c, 0], arms[c, 1]
                wx = ri * angular_velocity[i, 0] + rj * angular_velocity[j, 0]
                wy = ri * angular_velocity[i, 1] + rj * angular_velocity[j, 1]
                wz = ri * angular_velocity[i, 2] + rj * angular_velocity[j, 2]
                ux, uy, uz = ux - (wy * nz - wz * ny), uy - (wz * nx - wx * nz), uz - (wx * ny - wy * nx)
                mt = lightness[c, 2]
                tx, ty, tz = impulse[c, 1] - ux * mt, impulse[c, 2] - uy * mt, impulse[c, 3] - uz * mt
                size2 = tx * tx + ty * ty + tz * tz
                material = max(0, j - bodies + 1)
                most = law[material, 1] * Jn
                if size2 > most * most:
                    scale = law[material, 2] * Jn / np.sqrt(size2)
                    tx, ty, tz = scale * tx, scale * ty, scale * tz
                dx, dy, dz = tx - impulse[c, 1], ty - impulse[c, 2], tz - impulse[c, 3]
                impulse[c, 1], impulse[c, 2], impulse[c, 3] = tx, ty, tz
                step[c, 1], step[c, 2], step[c, 3] = dx, dy, dz
                change = max(change, max(abs(dx), abs(dy), abs(dz)) * lightness[c, 0])
                Jx, Jy, Jz = Jx + dx, Jy + dy, Jz + dz
                tx, ty, tz = nz * Jy - ny * Jz, nx * Jz - nz * Jx, ny * Jx - nx * Jy
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
        if sweeps < most_sweeps and change > CONVERGED * largest:
            _push(pairs, normals, arms, inverse_mass, inverse_inertia, step, pushed, turned)
            alpha = _farther(
                pairs, normals, arms, closing, dt, velocity, angular_velocity, bodies, impulse, step, pushed, turned
            )
            if alpha > 0.0:
                for c in range(len(pairs)):
                    for k in range(4):
                        impulse[c, k] += alpha * step[c, k]
                for i in range(len(velocity)):
                    for k in range(3):
                        velocity[i, k] += alpha * pushed[i, k]
                for i in range(len(angular_velocity)):
                    for k in range(3):
                        angular_velocity[i, k] += alpha * turned[i, k]
    return sweeps


@kernel
def _push(
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
def _farther(
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


@kernel
def _book(
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
        vn, ux, uy, uz = _relative(c, i, j, normals, arms, velocity, angular_velocity)
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


@kernel
def _relative(
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
def _apply(
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
