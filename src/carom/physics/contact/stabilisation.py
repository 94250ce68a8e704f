"""Pushing overlapping bodies apart without adding velocity along the normal.

A pair is pushed by δ along n, shared by mass, so that the centre of mass stays. That alone changes the angular
momentum by μ δ n × v_t (μ the reduced mass, v_t the tangential relative velocity of the centres); scaling v_t by
d/(d + δ) keeps it:

    (d + δ) n × (v_t d/(d + δ)) = d n × v_t

Only a contact at rest is pushed. An impact leaves by its own rebound, and pushing it would take tangential energy
from a gas at every collision.

The energy that a push moves goes into the ledger: the scaling exactly, at the velocities of the half kick, and the
potential as the work against gravity at the new positions. That work is wrong by (δ/d)² of a pair's potential; the
mean of the forces at the start of the step and at its end, which is right to the next order, measured no better in
the collapse of 500 boulders (both 10⁻⁶ of the energy scale), so the simpler form stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.solver import STABILISATION
from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BAUMGARTE = 0.2  # part of the overlap that the bias undoes in a step
LEAVING = 0.1  # of the rest speed; what separates faster clears itself. 1 raises a slow rebound out of its overlap for
# nothing (10 times the energy in the worst step), 0 leaves a pile overlapping (a quarter of a radius while it forms)
ENOUGH = 1e-9  # of the sum of radii; a smaller overlap is not worth another sweep


@kernel
def push_apart(
    order: IntArray,
    pairs: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    inverse_mass: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    surface: FloatArray,
    offset: FloatArray,
    law: FloatArray,
    rest_speed: FloatArray,
    most_sweeps: int,
    ledger: FloatArray,
    pushes: FloatArray,
) -> bool:
    """Push the contacts at rest apart, stage by stage; tell whether any was.

    Parameters
    ----------
    order, pairs, law
        (m,), (m, 2) and (1 + p, 3), as for the impulses.
    velocity, inverse_mass
        (n + p, 3) m/s and (n + p,) 1/kg, of bodies and planes.
    surface, offset
        (p, 3) normals and (p,) m of the planes.
    rest_speed
        (m,) m/s; a contact is at rest if it separates no faster than a tenth of it, or closes and will not rebound.
    ledger
        (m, 3) J, added to: the energy of the scaling of v_t.
    pushes
        (m, 3) m, added to: Σ δ n of each contact.
    """
    pushed = False
    n = len(position)
    for _ in range(most_sweeps):
        again = False
        for c in order:
            i, j = pairs[c, 0], pairs[c, 1]
            vx = velocity[j, 0] - velocity[i, 0]
            vy = velocity[j, 1] - velocity[i, 1]
            vz = velocity[j, 2] - velocity[i, 2]
            if j >= n:
                nx, ny, nz = -surface[j - n, 0], -surface[j - n, 1], -surface[j - n, 2]
                d = -(nx * position[i, 0] + ny * position[i, 1] + nz * position[i, 2]) - offset[j - n]
                reach = radius[i]
            else:
                dx = position[j, 0] - position[i, 0]
                dy = position[j, 1] - position[i, 1]
                dz = position[j, 2] - position[i, 2]
                if box[0] > 0.0:
                    dx -= box[0] * np.floor(dx / box[0] + 0.5)
                    dy -= box[1] * np.floor(dy / box[1] + 0.5)
                    dz -= box[2] * np.floor(dz / box[2] + 0.5)
                d = np.sqrt(dx * dx + dy * dy + dz * dz)
                reach = radius[i] + radius[j]
                if d > 0.0:
                    nx, ny, nz = dx / d, dy / d, dz / d
                else:
                    nx, ny, nz = 1.0, 0.0, 0.0
            push = reach - d
            if push <= 0.0:
                continue
            vn = vx * nx + vy * ny + vz * nz
            if vn > LEAVING * rest_speed[c] or (-vn > rest_speed[c] and law[max(0, j - n + 1), 0] > 0.0):
                continue
            if push > ENOUGH * reach:
                again = True
            pushed = True
            mi = inverse_mass[i] / (inverse_mass[i] + inverse_mass[j])  # what is lighter is pushed farther
            mj = inverse_mass[j] / (inverse_mass[i] + inverse_mass[j])
            position[i, 0] -= mi * push * nx
            position[i, 1] -= mi * push * ny
            position[i, 2] -= mi * push * nz
            if j < n:
                position[j, 0] += mj * push * nx
                position[j, 1] += mj * push * ny
                position[j, 2] += mj * push * nz
            pushes[c, 0] += push * nx
            pushes[c, 1] += push * ny
            pushes[c, 2] += push * nz
            if j >= n:
                continue  # nothing turns about a plane
            scale = d / (d + push) - 1.0
            tx, ty, tz = vx - vn * nx, vy - vn * ny, vz - vn * nz
            reduced = 1.0 / (inverse_mass[i] + inverse_mass[j])
            ledger[c, STABILISATION] += 0.5 * reduced * (tx * tx + ty * ty + tz * tz) * scale * (2.0 + scale)
            velocity[i, 0] -= mi * scale * tx
            velocity[i, 1] -= mi * scale * ty
            velocity[i, 2] -= mi * scale * tz
            velocity[j, 0] += mj * scale * tx
            velocity[j, 1] += mj * scale * ty
            velocity[j, 2] += mj * scale * tz
        if not again:
            break
    return pushed


@kernel
def work_of_pushes(
    pairs: IntArray, pushes: FloatArray, acceleration: FloatArray, inverse_mass: FloatArray, ledger: FloatArray
) -> None:
    """Book the potential energy that pushes moved, -μ (a_j - a_i)·Σ δ n, into the ledger, (m, 3) J."""
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        reduced = 1.0 / (inverse_mass[i] + inverse_mass[j])
        work = 0.0
        for k in range(3):
            work += (acceleration[j, k] - acceleration[i, k]) * pushes[c, k]
        ledger[c, STABILISATION] -= reduced * work
