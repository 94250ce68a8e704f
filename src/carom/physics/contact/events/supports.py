"""Impacts of bodies that rest, roll or slide on something fixed.

Contacts hold such a body by an impulse in the kicks before and after a drift, as a field accelerates it there. With the
accelerations p by the normal impulses, f by the friction, and α by the torques of its contacts in the kick, and the
length h of that kick, its velocities at the time τ are

    v(τ) = v + (a + p + f)(τ - h),    ω(τ) = ω + α (τ - h)

The impulse J of an impact acts on these velocities. If it lifts the body off its support, all contacts push until τ
only, and from then on the path is a parabola again:

    v' = v + J/m + (p + f)(τ - h),    ω' = ω + Δω + α (τ - h)

Otherwise the normal impulses act through both kicks. Friction ends at τ, since an impact changes the slip; the friction
f' and its torque α' that follow act for dt - τ, but for the length dt - h of the kick after the drift:

    v' = v + J/m + (f - f')(τ - h),    ω' = ω + Δω + (α - α')(τ - h)

Contacts that stick need no f': the contact solver finds the impulse that ends their slip at the end of the step.

Without these terms, the speed of a ball that rolls into an incline, or that slides after an impact, is wrong by up to
½ a dt, with the acceleration a along the incline or by friction.

These rules hold for bodies whose contacts are all with fixed bodies, planes or walls, f' for a single contact of that
kind. A wall that moves does the work of the corrected impulses (`moving_walls`), which is a loss in addition. The other
bodies of a pile are pushed through both kicks: an impulse that ends earlier would have to end for both bodies of a
contact.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import IntArray, RecordArray
from carom.physics.contact.events.trajectories import (
    SupportRecord,
    Trajectories,
    centre,
    elapsed,
    relative_velocity,
    shift_to_parabola,
    slowing,
    velocity,
)
from carom.physics.contact.law import lasting_friction, material_index
from carom.physics.contact.moving_walls import slip_at_wall, slope_on_wall
from carom.physics.contact.records import ContactRecord
from carom.physics.contact.rolling import angular_impulse, set_angular_impulse
from carom.physics.contact.solver.body_state import slip_velocity, torque_of
from carom.physics.contact.translating_walls import velocity_in_drift
from carom.physics.jit.decorators import inner, kernel
from carom.physics.vector import Vector, add, vector


@kernel
def mark_supported(
    pairs: IntArray, place: IntArray, contacts: RecordArray[ContactRecord], share: float, T: Trajectories
) -> None:
    """Mark the bodies whose held contacts are all with something fixed, and write p, f and α.

    The impulses of ``contacts[place]`` times ``share`` (1/s) are forces: 1/h, in a medium times the factor on the
    accelerations along its paths.
    """
    for c in range(len(place)):
        contact = contacts[place[c]]
        for end in range(2):
            i, other = pairs[c, end], pairs[c, 1 - end]
            if i >= len(T.body) or T.inverse_mass[i] == 0.0:
                continue
            T.support[i].is_hit = False
            if not (contact.normal_impulse > 0.0 and T.inverse_mass[other] == 0.0):
                continue
            body, support, sign = T.body[i], T.support[i], 2 * end - 1
            support.end = -1 if body.is_supported else other
            support.arm = contact.arm_j if end == 1 else contact.arm_i
            if not body.is_supported:
                body.is_supported, support.rise = True, 0.0
                support.press_x = support.press_y = support.press_z = 0.0
                support.rub_x = support.rub_y = support.rub_z = 0.0
                support.turn_x = support.turn_y = support.turn_z = 0.0
            m, inertia = share * T.inverse_mass[i], share * T.inverse_inertia[i]
            support.press_x += sign * m * contact.normal_impulse * contact.nx
            support.press_y += sign * m * contact.normal_impulse * contact.ny
            support.press_z += sign * m * contact.normal_impulse * contact.nz
            fx, fy, fz = contact.friction_x, contact.friction_y, contact.friction_z
            support.rub_x, support.rub_y = support.rub_x + sign * m * fx, support.rub_y + sign * m * fy
            support.rub_z += sign * m * fz
            tx, ty, tz = torque_of(contact, fx, fy, fz)
            lx, ly, lz = angular_impulse(contact)
            support.turn_x += inertia * (support.arm * tx + sign * lx)
            support.turn_y += inertia * (support.arm * ty + sign * ly)
            support.turn_z += inertia * (support.arm * tz + sign * lz)
    for c in range(len(place)):
        for end in range(2):
            i, other = pairs[c, end], pairs[c, 1 - end]
            if contacts[place[c]].normal_impulse > 0.0 and i < len(T.body) and T.inverse_mass[other] > 0.0:
                T.body[i].is_supported = False


@kernel
def correct_impulses(
    pairs: IntArray, place: IntArray, contacts: RecordArray[ContactRecord], share: float, T: Trajectories
) -> None:
    """Change the impulses of the supports of bodies that were hit to what they have given; ``share`` is as above."""
    for c in range(len(place)):
        for end in range(2):
            i, contact = pairs[c, end], contacts[place[c]]
            if not (contact.normal_impulse > 0.0 and i < len(T.body) and T.support[i].is_hit):
                continue
            support = T.support[i]
            normal, tx, ty, tz = contact.normal_impulse, contact.friction_x, contact.friction_y, contact.friction_z
            contact.normal_impulse *= 1.0 + share * support.lifted
            f, m = 1.0 + share * support.cut, (2 * end - 1) / T.inverse_mass[i]
            contact.friction_x = f * contact.friction_x + m * support.slid_x
            contact.friction_y = f * contact.friction_y + m * support.slid_y
            contact.friction_z = f * contact.friction_z + m * support.slid_z
            lx, ly, lz = angular_impulse(contact)
            set_angular_impulse(contact, f * lx, f * ly, f * lz)
            other = pairs[c, 1 - end]
            if other >= len(T.body):
                normal, f = contact.normal_impulse - normal, f - 1.0
                tx, ty, tz = contact.friction_x - tx, contact.friction_y - ty, contact.friction_z - tz
                change = normal, (tx, ty, tz), (f * lx, f * ly, f * lz)
                _book_work_of_wall(contacts, place[c], other, change, T)


@inner
def _book_work_of_wall(
    contacts: RecordArray[ContactRecord], c: int, j: int, change: tuple[float, Vector, Vector], T: Trajectories
) -> None:
    """Book, as losses, the work that a wall does on a body by a change of a contact's impulses in the first kick.

    ``change`` contains λ_n, λ_t and Λ.
    """
    contact, (normal, (tx, ty, tz), (lx, ly, lz)) = contacts[c], change
    vx, vy, vz = velocity_in_drift(T.surface, j - len(T.body), 0.0)
    T.drift[0].restitution -= normal * (contact.nx * vx + contact.ny * vy + contact.nz * vz)
    T.drift[0].friction -= slope_on_wall(contact, tx * vx + ty * vy + tz * vz, tx, ty, tz)
    if len(T.omega) > 0:
        wx, wy, wz = vector(T.omega, j)
        T.drift[0].friction -= lx * wx + ly * wy + lz * wz


@inner
def is_supported(i: int, T: Trajectories) -> bool:
    """Return whether something fixed supports a body, and nothing else; ``i`` may be a solid."""
    return bool(i < len(T.x) and T.body[i].is_supported)


@inner
def add_support(i: int, sign: float, T: Trajectories) -> None:
    """Add the velocity and the spin that the contacts of a supported body give from the kick to the present time."""
    if not is_supported(i, T):
        return
    support, s = T.support[i], sign * (T.drift[0].clock - T.drift[0].kick)
    ax, ay, az = support.press_x + support.rub_x, support.press_y + support.rub_y, support.press_z + support.rub_z
    add(T.v, i, s / slowing(T), ax, ay, az)
    if len(T.omega) > 0:
        add(T.omega, i, s, support.turn_x, support.turn_y, support.turn_z)


@inner
def leave_or_stay(i: int, jx: float, jy: float, jz: float, T: Trajectories) -> float:
    """Let a supported body that an impulse on it (N s) lifts continue on a parabola, and any other on its support.

    `add_support` has been called. A body is lifted if the load of its contacts could not stop its rise before the end
    of the drift. Return the energy (J) that the normal impulses of the contacts add to its velocity beyond the kicks.
    """
    if not is_supported(i, T):
        return 0.0
    drift, support, load, m = T.drift[0], T.support[i], T.loads[i], T.inverse_mass[i]
    s = drift.clock - drift.kick
    px, py, pz = support.press_x, support.press_y, support.press_z
    lx = load.xx * px + load.xy * py + load.xz * pz
    ly = load.xy * px + load.yy * py + load.yz * pz
    lz = load.xz * px + load.yz * py + load.zz * pz
    stopping = lx * px + ly * py + lz * pz
    if stopping > 0.0:
        support.rise += m * (jx * lx + jy * ly + jz * lz) / stopping
    if support.is_hit:
        _add_slide(support, s)
    else:
        drift.hit += 1
        support.is_hit, support.cut, support.lifted = True, s, 0.0
        support.slid_x = support.slid_y = support.slid_z = 0.0
    if not support.rise > drift.dt - elapsed(T):
        support.rub_x = support.rub_y = support.rub_z = 0.0
        support.turn_x = support.turn_y = support.turn_z = 0.0
        if support.end >= 0 and len(T.omega) > 0:
            _slide_on(i, s, T)
        add(T.v, i, -s / slowing(T), px, py, pz)
        return float(-s * (jx * px + jy * py + jz * pz))
    T.body[i].is_supported, T.body[i].is_lifted, support.lifted = False, True, s
    vx, vy, vz = velocity(i, T)
    vx -= m * jx + 0.5 * s * (px + support.rub_x)
    vy -= m * jy + 0.5 * s * (py + support.rub_y)
    vz -= m * jz + 0.5 * s * (pz + support.rub_z)
    gained = s * (px * vx + py * vy + pz * vz) / m
    if drift.bends:
        T.body[i].is_straight = False
        shift_to_parabola(i, 1.0, T)
    return float(gained)


@inner
def _slide_on(i: int, s: float, T: Trajectories) -> None:
    """Write f' and α' of a body that slides on its only support, and subtract f' s and α' s; ``s`` is τ - h in s."""
    support, m, dt = T.support[i], T.inverse_mass[i], T.drift[0].dt
    px, py, pz = support.press_x, support.press_y, support.press_z
    p = np.sqrt(px * px + py * py + pz * pz)
    nx, ny, nz = px / p, py / p, pz / p  # out of the support
    vx, vy, vz = relative_velocity(i, support.end, T)
    vn = vx * nx + vy * ny + vz * nz
    wx, wy, wz = vector(T.omega, i)
    w = support.arm * wx, support.arm * wy, support.arm * wz
    ux, uy, uz = slip_velocity((vx - vn * nx, vy - vn * ny, vz - vn * nz), (-nx, -ny, -nz), w)
    if support.end >= len(T.x):
        x, y, z = centre(i, T)
        point = x - support.arm * nx, y - support.arm * ny, z - support.arm * nz
        ux, uy, uz = slip_at_wall(T.surface, support.end - len(T.x), elapsed(T), point, (ux, uy, uz))
    Kt = m + support.arm * support.arm * T.inverse_inertia[i]
    material = T.materials[material_index(min(i, support.end), max(i, support.end), len(T.x), T.places)]
    fx, fy, fz = lasting_friction(material, p / m * dt, ux / Kt, uy / Kt, uz / Kt)
    if not Kt * Kt * (fx * fx + fy * fy + fz * fz) < ux * ux + uy * uy + uz * uz:
        return  # it sticks before the end of a step
    support.rub_x, support.rub_y, support.rub_z = m / dt * fx, m / dt * fy, m / dt * fz
    turned = -support.arm * T.inverse_inertia[i] / dt
    support.turn_x, support.turn_y = turned * (ny * fz - nz * fy), turned * (nz * fx - nx * fz)
    support.turn_z = turned * (nx * fy - ny * fx)
    add(T.v, i, -s / slowing(T), support.rub_x, support.rub_y, support.rub_z)
    add(T.omega, i, -s, support.turn_x, support.turn_y, support.turn_z)
    _add_slide(support, -s)


@inner
def _add_slide(support: SupportRecord, s: float) -> None:
    """Add what f' gives in s seconds."""
    support.slid_x += s * support.rub_x
    support.slid_y += s * support.rub_y
    support.slid_z += s * support.rub_z
