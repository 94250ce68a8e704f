"""Projected Gauss-Seidel: the impulses of contacts at rest.

A resting contact exerts a force, so its impulses belong to both kicks of a step, like those of all forces. After each
kick of length h, iterations over the contacts find the impulses λ of all contacts such that

    v_n + c ≥ 0,   λ_n ≥ 0,   λ_n (v_n + c) = 0                                    (Signorini)
    |λ_t| ≤ μ_s λ_n where the contact sticks, λ_t = -μ_k λ_n u/|u| where it slides      (Coulomb)

(Moreau 1988, Jean 1999; Catto 2005 calls them sequential impulses). The *totals* are clamped, not the increments, so
later iterations can take back what earlier ones overdid. The totals start from those of the previous kick, scaled by
the ratio of the lengths (`warm_start`), so a pile at rest needs one iteration. A line search follows each iteration
(`line_search`).

After the last kick, contacts that touch must not close (c = 0; c < 0 with Baumgarte's bias), and an open one may close
by its gap in the next step (c = gap/dt). After the first kick bodies may close by c dt, so that they touch at the end
of the drift: |d n + v dt| ≥ r_i + r_j. With v_t the tangential velocity of the centres,

    c dt = gap + R - √(R² - v_t² dt²),   R = r_i + r_j

Without the root, two spheres that roll about each other would separate along the tangent, and their contact would be
lost in every other step. The scheme is RATTLE (Andersen 1983) for contacts.

Impacts are resolved before, one by one, with restitution (`impacts`). A step without resting contacts skips this phase.

Rejected: the reference engine's stages with restitution 0 (a pile of 1000 keeps jittering at the rest speed); impulses
at the end of the step only (a body falls a dt²/2 into the ground in every step and has to be pushed back).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.physics.contact.constraints import ConstraintSystem, body_count, ends_of
from carom.physics.contact.law import exerts_torque, material_index
from carom.physics.contact.rolling import (
    accumulate_angular_impulse,
    angular_impulse,
    apply_angular_impulse,
    change_of_angular_impulse,
    limited,
    relative_spin,
    set_angular_impulse,
    set_change_of_angular_impulse,
)
from carom.physics.contact.solver.block import whole_blocks
from carom.physics.contact.solver.body_state import accumulate_push, accumulate_turn, prefetch_records, push, turn
from carom.physics.contact.solver.friction import friction
from carom.physics.contact.solver.solve_block import solve_block
from carom.physics.contact.solver.velocity import bias_of, relative_velocity, slip
from carom.physics.jit.decorators import inline, unowned
from carom.physics.jit.lanes import WIDTH

HOLD_CONVERGED = 1e-8  # of the largest velocity that a contact removes; iterations that change less are the last


@unowned
def solve_turning(first: int, end: int, system: ConstraintSystem) -> None:
    """Solve the contacts of some pieces once, with friction and spin."""
    for piece in range(first, end):
        solve(piece, system, (1,))


@unowned
def solve_straight(first: int, end: int, system: ConstraintSystem) -> None:
    """Solve the contacts of some pieces once, without friction."""
    for piece in range(first, end):
        solve(piece, system, ())


@unowned
def solve(piece: int, system: ConstraintSystem, turning: tuple[()] | tuple[int]) -> None:
    """Solve the contacts of a piece once, each at the velocities that those before it left.

    Contacts of a colour that share no moving body are solved in blocks (`solve_block`), those left over one by one.

    Parameters
    ----------
    turning
        One element if impulses turn bodies, otherwise empty. Its type makes Numba compile a kernel for each case.
    """
    lo, hi = system.pieces[piece, 0], system.pieces[piece, 1]  # by `contacts_of`, blocks take 3 % longer
    blocks = 0 if exerts_torque(system.materials[0]) else whole_blocks(piece, system)
    found = 0.0, np.inf, 0.0
    for block in range(blocks):
        found = solve_block(system, lo + block * WIDTH, found, turning)
    found = _solve_each(lo + blocks * WIDTH, hi, found, system, turning)
    findings = system.found[piece]
    findings.residual, findings.step_limit, findings.slope = found


@inline
def _solve_each(
    lo: int, hi: int, found: tuple[float, float, float], system: ConstraintSystem, turning: tuple[()] | tuple[int]
) -> tuple[float, float, float]:
    """Solve the contacts [lo, hi) one by one; return the largest change, the limit of the step, and the slope.

    ``found`` are those of the contacts before.
    """
    pairs, bodies = system.pairs, system.bodies
    settings = system.settings[0]
    spins, alpha, drift, keeps_sliding = len(turning) > 0, settings.alpha, settings.drift, settings.keeps_sliding
    count, places = body_count(system), system.places
    change, step_limit, slope = found
    for c in range(lo, hi):
        prefetch_records(bodies, pairs, c)
        if not system.held[c]:
            continue
        i, j = ends_of(pairs, c)
        contact, state, body_i, body_j = system.contacts[c], system.states[c], bodies[i], bodies[j]
        vn, ux, uy, uz = relative_velocity(contact, body_i, body_j)
        bias = bias_of(contact, j < count, ux, uy, uz, drift)
        old = contact.normal_impulse + alpha * contact.delta_normal
        normal = max(0.0, old - (vn + bias) * contact.normal_mass)  # clamp the total, not the increment
        more = normal - old
        contact.normal_impulse, contact.delta_normal = normal, more
        largest = abs(more)
        slope += more * bias
        if more < 0.0:
            step_limit = min(step_limit, -normal / more)
        Jx, Jy, Jz = more * contact.nx, more * contact.ny, more * contact.nz
        if spins:
            ux, uy, uz = slip(contact, body_i, body_j, ux, uy, uz)
            mt = contact.tangent_mass
            ox = contact.friction_x + alpha * contact.delta_x
            oy = contact.friction_y + alpha * contact.delta_y
            oz = contact.friction_z + alpha * contact.delta_z
            tx, ty, tz = ox - ux * mt, oy - uy * mt, oz - uz * mt
            material = system.materials[material_index(i, j, count, places)]
            tx, ty, tz = friction(state, material, keeps_sliding, normal, tx, ty, tz)
            dx, dy, dz = tx - ox, ty - oy, tz - oz
            contact.friction_x, contact.friction_y, contact.friction_z = tx, ty, tz
            contact.delta_x, contact.delta_y, contact.delta_z = dx, dy, dz
            largest = max(largest, abs(dx), abs(dy), abs(dz))
            Jx, Jy, Jz = Jx + dx, Jy + dy, Jz + dz
            turn(contact, body_i, body_j, dx, dy, dz)
            accumulate_turn(contact, body_i, body_j, dx, dy, dz)
        largest *= body_i.inverse_mass + body_j.inverse_mass
        if spins and exerts_torque(system.materials[0]):
            material = system.materials[material_index(i, j, count, places)]
            largest = max(largest, _resist_rotation(contact, material, body_i, body_j, normal, alpha))
        if largest > system.small_change[c]:
            change = max(change, largest)
        push(body_i, body_j, Jx, Jy, Jz)
        accumulate_push(body_i, body_j, Jx, Jy, Jz)
    return change, step_limit, slope


@inline
def _resist_rotation(contact: Any, material: Any, a: Any, b: Any, normal: float, alpha: float) -> float:
    """Change the angular impulse by that which ends Ω, as far as the law allows; return the change of a speed, in m/s.

    The speed is that of a surface, a lever arm away from the centre.
    """
    wx, wy, wz = relative_spin(a, b)
    x, y, z = angular_impulse(contact)
    dx, dy, dz = change_of_angular_impulse(contact)
    ox, oy, oz = x + alpha * dx, y + alpha * dy, z + alpha * dz
    K = a.inverse_inertia + b.inverse_inertia
    if K == 0.0:
        return 0.0
    x, y, z = limited(contact, material, normal, ox - wx / K, oy - wy / K, oz - wz / K)
    dx, dy, dz = x - ox, y - oy, z - oz
    set_angular_impulse(contact, x, y, z)
    set_change_of_angular_impulse(contact, dx, dy, dz)
    apply_angular_impulse(a, b, dx, dy, dz)
    accumulate_angular_impulse(a, b, dx, dy, dz)
    return float(max(abs(dx), abs(dy), abs(dz)) * K * max(contact.arm_i, contact.arm_j))
