"""The sweeps that find the impulses of contacts that last; the equations stand in `lasting`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.line_search import farther, push
from carom.physics.contact.touch import apply, relative
from carom.physics.kernel import long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


CONVERGED = 1e-8  # a sweep that changes no velocity by more than this part of the largest that the contacts undo


@long_kernel
def sweep(
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
        vn, ux, uy, uz = relative(c, i, j, normals, arms, velocity, angular_velocity)
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
        apply(c, i, j, Jx, Jy, Jz, normals, arms, velocity, angular_velocity, inverse_mass, inverse_inertia)
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
            push(pairs, normals, arms, inverse_mass, inverse_inertia, step, pushed, turned)
            alpha = farther(
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
