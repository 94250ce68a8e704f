"""Velocities of the bodies in contact, as records of two cache lines each.

Only bodies that touch something are copied: of 10⁶ bodies in flight, few touch.

Velocities at a contact are relative: body j minus body i.

    v = v_j - v_i,    v_n = v·n,    v_t = v - v_n n,    u = v_t - (ρ_i ω_i + ρ_j ω_j) × n     (slip)
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.guided_walls import along_guide
from carom.physics.contact.moving_walls import slip_at_wall, slip_on_wall
from carom.physics.contact.records import BodyStateRecord, ContactRecord
from carom.physics.contact.solids import LARGEST_ARC
from carom.physics.jit.decorators import inline, kernel, long_kernel, with_field
from carom.physics.jit.instructions import AHEAD, from_front, prefetch_record
from carom.physics.jit.vectors import where
from carom.physics.sheared_box import relative_to_image
from carom.physics.vector import Vector

LARGEST_DEVIATION = 0.5  # largest ratio of q to v_t; a faster spin turns the path of a body by a radian in a step


class Moving(Protocol):
    """A record with a velocity (m/s)."""

    vx: float
    vy: float
    vz: float


def active_bodies(pairs: IntArray, count: int) -> IntArray:
    """Return the indices, among ``count`` bodies and planes, that occur in a pair, in ascending order."""
    touches = np.zeros(count, dtype=np.bool_)
    _mark(pairs, touches)
    return np.flatnonzero(touches)


@kernel
def _mark(pairs: IntArray, touches: BoolArray) -> None:
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        touches[i] = touches[j] = True


@long_kernel
def gather(
    lo: int,
    hi: int,
    active: IntArray,
    v: FloatArray,
    omega: FloatArray,
    inverse_mass: FloatArray,
    inverse_inertia: FloatArray,
    bodies: RecordArray[BodyStateRecord],
) -> None:
    """Copy the velocities of the active bodies [lo, hi) into their records; without spins, ``omega`` has no rows."""
    for k in range(lo, hi):
        b = from_front(active[k])
        body = bodies[b]
        body.vx, body.vy, body.vz = v[b, 0], v[b, 1], v[b, 2]
        if len(omega) > 0:
            body.wx, body.wy, body.wz = omega[b, 0], omega[b, 1], omega[b, 2]
        else:
            body.wx = body.wy = body.wz = 0.0
        body.dvx = body.dvy = body.dvz = body.dwx = body.dwy = body.dwz = 0.0
        body.inverse_mass, body.inverse_inertia = inverse_mass[b], inverse_inertia[b]
        body.mass = 1.0 / inverse_mass[b] if inverse_mass[b] > 0.0 else 0.0
        body.inertia = 1.0 / inverse_inertia[b] if inverse_inertia[b] > 0.0 else 0.0


@long_kernel
def scatter(
    lo: int, hi: int, active: IntArray, bodies: RecordArray[BodyStateRecord], v: FloatArray, omega: FloatArray
) -> None:
    """Copy the velocities of the active bodies [lo, hi) back into the arrays."""
    for k in range(lo, hi):
        b = from_front(active[k])
        body = bodies[b]
        v[b, 0], v[b, 1], v[b, 2] = body.vx, body.vy, body.vz
        if len(omega) > 0:
            omega[b, 0], omega[b, 1], omega[b, 2] = body.wx, body.wy, body.wz


@inline
def prefetch_ends(bodies: RecordArray[object], pairs: IntArray, c: int) -> None:
    """Prefetch the first lines of the two bodies of the contact `AHEAD` places after c."""
    i, j = ends_of(pairs, from_front(min(len(pairs) - 1, c + AHEAD)))
    prefetch_record(bodies, i, 0)
    prefetch_record(bodies, j, 0)


@inline
def prefetch_records(bodies: RecordArray[BodyStateRecord], pairs: IntArray, c: int) -> None:
    """Prefetch the lines of `prefetch_ends`, and the lines with the changes in the iteration."""
    i, j = ends_of(pairs, from_front(min(len(pairs) - 1, c + AHEAD)))
    prefetch_record(bodies, i, 0)
    prefetch_record(bodies, i, 1)
    prefetch_record(bodies, j, 0)
    prefetch_record(bodies, j, 1)


# The impulse J = λ_n n + λ_t acts on j, and -J on i: Δv = J/m, Δω = I⁻¹ (r × J). The lever arms ρ n of i and j point in
# opposite directions, and so do the impulses, so r × J is ρ λ_t × n for both. Fixed bodies are not written: several
# contacts of a colour may share a fixed body, and its cache line would move from core to core.


@inline
def apply_impulse(
    contact: ContactRecord,
    a: BodyStateRecord,
    b: BodyStateRecord,
    turns: bool,
    normal: float,
    tx: float,
    ty: float,
    tz: float,
) -> None:
    """Change the velocities of two bodies by impulses λ_n and λ_t, in N s."""
    push(a, b, normal * contact.nx + tx, normal * contact.ny + ty, normal * contact.nz + tz)
    if turns:
        turn(contact, a, b, tx, ty, tz)


@inline
def accumulate_impulse(
    contact: ContactRecord,
    a: BodyStateRecord,
    b: BodyStateRecord,
    turns: bool,
    normal: float,
    tx: float,
    ty: float,
    tz: float,
) -> None:
    """Add the velocity changes by impulses (N s) to the velocity changes of the iteration."""
    accumulate_push(a, b, normal * contact.nx + tx, normal * contact.ny + ty, normal * contact.nz + tz)
    if turns:
        accumulate_turn(contact, a, b, tx, ty, tz)


@inline
def push(a: BodyStateRecord, b: BodyStateRecord, Jx: float, Jy: float, Jz: float) -> None:
    """Change the velocities of two bodies by an impulse J, in N s."""
    mi, mj = a.inverse_mass, b.inverse_mass
    if mi > 0.0:
        a.vx -= Jx * mi
        a.vy -= Jy * mi
        a.vz -= Jz * mi
    if mj > 0.0:
        Jx, Jy, Jz = along_guide(b, Jx, Jy, Jz)
        b.vx += Jx * mj
        b.vy += Jy * mj
        b.vz += Jz * mj


@inline
def torque_of(contact: ContactRecord, tx: float, ty: float, tz: float) -> tuple[float, float, float]:
    """Return λ_t × n of a tangential impulse, in N s."""
    nx, ny, nz = contact.nx, contact.ny, contact.nz
    return nz * ty - ny * tz, nx * tz - nz * tx, ny * tx - nx * ty


@inline
def turn(contact: ContactRecord, a: BodyStateRecord, b: BodyStateRecord, tx: float, ty: float, tz: float) -> None:
    """Change the angular velocities by a tangential impulse λ_t, in N s."""
    lx, ly, lz = torque_of(contact, tx, ty, tz)
    si, sj = contact.arm_i * a.inverse_inertia, contact.arm_j * b.inverse_inertia
    if si > 0.0:
        a.wx += si * lx
        a.wy += si * ly
        a.wz += si * lz
    if sj > 0.0:
        b.wx += sj * lx
        b.wy += sj * ly
        b.wz += sj * lz


@inline
def accumulate_push(a: BodyStateRecord, b: BodyStateRecord, Jx: float, Jy: float, Jz: float) -> None:
    """Add the velocity changes that `push` makes to the velocity changes of the iteration."""
    mi, mj = a.inverse_mass, b.inverse_mass
    if mi > 0.0:
        a.dvx -= Jx * mi
        a.dvy -= Jy * mi
        a.dvz -= Jz * mi
    if mj > 0.0:
        Jx, Jy, Jz = along_guide(b, Jx, Jy, Jz)
        b.dvx += Jx * mj
        b.dvy += Jy * mj
        b.dvz += Jz * mj


@inline
def accumulate_turn(
    contact: ContactRecord, a: BodyStateRecord, b: BodyStateRecord, tx: float, ty: float, tz: float
) -> None:
    """Add the velocity changes that `turn` makes to the velocity changes of the iteration."""
    lx, ly, lz = torque_of(contact, tx, ty, tz)
    si, sj = contact.arm_i * a.inverse_inertia, contact.arm_j * b.inverse_inertia
    if si > 0.0:
        a.dwx += si * lx
        a.dwy += si * ly
        a.dwz += si * lz
    if sj > 0.0:
        b.dwx += sj * lx
        b.dwy += sj * ly
        b.dwz += sj * lz


@inline
def relative_velocity(
    contact: ContactRecord, a: BodyStateRecord, b: BodyStateRecord
) -> tuple[float, float, float, float]:
    """Return v_n and v_t of two bodies, in m/s."""
    ux, uy, uz = relative_to_image(contact, b.vx - a.vx, b.vy - a.vy, b.vz - a.vz)
    return along_and_across(contact.nx, contact.ny, contact.nz, ux, uy, uz)


@inline
def velocity_along(nx: float, ny: float, nz: float, a: Moving, b: Moving) -> tuple[float, float, float, float]:
    """Return v_n and v_t of two bodies in m/s, for a normal from a to b."""
    return along_and_across(nx, ny, nz, b.vx - a.vx, b.vy - a.vy, b.vz - a.vz)


@inline
def along_and_across(
    nx: float, ny: float, nz: float, ux: float, uy: float, uz: float
) -> tuple[float, float, float, float]:
    """Return v_n and v_t of a relative velocity in m/s."""
    vn = ux * nx + uy * ny + uz * nz
    return vn, ux - vn * nx, uy - vn * ny, uz - vn * nz


@inline
def slip_velocity(tangential: Vector, normal: Vector, w: Vector) -> Vector:
    """Return the slip at the contact point, u = v_t - w × n, in m/s.

    Parameters
    ----------
    tangential
        m/s, v_t, the tangential relative velocity of the centres.
    normal
        The normal, from i to j.
    w
        m/s, w = ρ_i ω_i + ρ_j ω_j, with the lever arms ρ.
    """
    (tx, ty, tz), (nx, ny, nz), (wx, wy, wz) = tangential, normal, w
    return tx - (wy * nz - wz * ny), ty - (wz * nx - wx * nz), tz - (wx * ny - wy * nx)


@inline
def slip(
    contact: ContactRecord, a: BodyStateRecord, b: BodyStateRecord, tx: float, ty: float, tz: float
) -> tuple[float, float, float]:
    """Return the slip u of two bodies, in m/s, given v_t."""
    ri, rj = contact.arm_i, contact.arm_j
    wx, wy, wz = ri * a.wx + rj * b.wx, ri * a.wy + rj * b.wy, ri * a.wz + rj * b.wz
    ux, uy, uz = slip_velocity((tx, ty, tz), (contact.nx, contact.ny, contact.nz), (wx, wy, wz))
    return slip_on_wall(contact, ux, uy, uz)


@inline
def change_by_field(
    contact: ContactRecord, acceleration: FloatArray, i: int, j: int, kick: float
) -> tuple[float, Vector]:
    """Return the changes of v_n and of u (m/s) that the accelerations of two ends (m/s²) give in a kick (s)."""
    a, nx, ny, nz = acceleration, contact.nx, contact.ny, contact.nz
    kx, ky, kz = (a[j, 0] - a[i, 0]) * kick, (a[j, 1] - a[i, 1]) * kick, (a[j, 2] - a[i, 2]) * kick
    kn = kx * nx + ky * ny + kz * nz
    return kn, (kx - kn * nx, ky - kn * ny, kz - kn * nz)


@inline
def half_turn(
    contact: ContactRecord, a: BodyStateRecord, b: BodyStateRecord, tx: float, ty: float, tz: float, drift: float
) -> Vector:
    """Return the slip q (m/s) that ends in the first half of a drift (s) because the normal turns, given v_t.

    In a drift, the slip changes by -w × δn, where w = ρ_i ω_i + ρ_j ω_j, and the normal turns by δn = v_t dt/d. The
    tangential component of this change is -w_n n × δn. If the turn or the spin is too large for this correction, q is
    0.
    """
    nx, ny, nz, ri, rj = contact.nx, contact.ny, contact.nz, contact.arm_i, contact.arm_j
    about = (ri * a.wx + rj * b.wx) * nx + (ri * a.wy + rj * b.wy) * ny + (ri * a.wz + rj * b.wz) * nz
    farthest, scale = LARGEST_ARC * (ri + rj), 0.5 * drift * about / (ri + rj)
    is_short = drift * drift * (tx * tx + ty * ty + tz * tz) < farthest * farthest
    scale = where(is_short & (abs(scale) < LARGEST_DEVIATION), scale, 0.0)
    return scale * (ny * tz - nz * ty), scale * (nz * tx - nx * tz), scale * (nx * ty - ny * tx)


def _set_half_turn(contact: Any, surface: FloatArray, solid: int, body: Any, moves: Any, end: Vector) -> None:
    (x, y, z), (tx, ty, tz), bias, gap, drift = moves
    nx, ny, nz, arm, (ex, ey, ez) = contact.nx, contact.ny, contact.nz, contact.arm_i, end
    px, py, pz = x + drift * (tx + bias * nx), y + drift * (ty + bias * ny), z + drift * (tz + bias * nz)
    point = px + (arm + gap) * ex, py + (arm + gap) * ey, pz + (arm + gap) * ez
    w = arm * body.wx, arm * body.wy, arm * body.wz
    bx, by, bz = slip_velocity(slip_on_wall(contact, 0.0, 0.0, 0.0), (nx, ny, nz), w)
    cx, cy, cz = slip_velocity(slip_at_wall(surface, solid, 0.0, point, (0.0, 0.0, 0.0)), end, w)
    if not (ex == nx and ey == ny and ez == nz):  # rotate q back with the normal
        across = (cx * nx + cy * ny + cz * nz) / (1.0 + nx * ex + ny * ey + nz * ez)
        cx, cy, cz = cx - across * (nx + ex), cy - across * (ny + ey), cz - across * (nz + ez)
    qx, qy, qz = 0.5 * (bx - cx), 0.5 * (by - cy), 0.5 * (bz - cz)
    most = LARGEST_DEVIATION * LARGEST_DEVIATION * (tx * tx + ty * ty + tz * tz)
    if not qx * qx + qy * qy + qz * qz < most:
        qx = qy = qz = 0.0
    contact.turn_x, contact.turn_y, contact.turn_z = qx, qy, qz


@with_field("turn_x", _set_half_turn)
def set_half_turn(
    contact: object,
    surface: FloatArray,
    solid: int,
    body: object,
    moves: tuple[Vector, Vector, float, float, float],
    end: Vector,
) -> None:
    """Store `half_turn` of a contact with a wall: half the amount by which the slip s - ρ ω × n decreases in the drift.

    To compare the slips at both ends of the drift, the later slip is rotated back, by the rotation that takes the
    normal ``end`` to the normal at the beginning.

    Parameters
    ----------
    contact, surface, solid, body
        The contact, its wall, and the body.
    moves
        The position of the body (m), its v_t relative to the wall and c (m/s), its negative gap if it overlaps the
        wall, otherwise 0 (m), and the drift (s).
    end
        The normal at the end of the drift.
    """


@with_field("turn_x", lambda contact: (contact.turn_x, contact.turn_y, contact.turn_z))
def half_turn_on_wall(contact: object) -> Vector:
    """Return `half_turn` of a contact with a plane or a wall, in m/s; the normal of a plane does not turn."""
    return 0.0, 0.0, 0.0


@inline
def half_turn_of(
    contact: ContactRecord,
    a: BodyStateRecord,
    b: BodyStateRecord,
    between_bodies: bool,
    tx: float,
    ty: float,
    tz: float,
    drift: float,
) -> Vector:
    """Return the slip q (m/s) that a contact keeps before a drift (s), given v_t; 0 without a drift.

    Friction ends the slip in the middle of the drift, so u = q before the drift and u = -q after it. Over both kicks
    together, friction then does no work. If friction ended u before the drift, it would remove 2 q²/K_t in each step.
    """
    if not drift > 0.0:
        return 0.0, 0.0, 0.0
    if between_bodies:
        return half_turn(contact, a, b, tx, ty, tz, drift)
    return half_turn_on_wall(contact)


@inline
def change_of_velocity(
    contact: ContactRecord, a: BodyStateRecord, b: BodyStateRecord
) -> tuple[float, float, float, float]:
    """Return the changes of v_n and u in the last iteration, in m/s."""
    nx, ny, nz, ri, rj = contact.nx, contact.ny, contact.nz, contact.arm_i, contact.arm_j
    px, py, pz = b.dvx - a.dvx, b.dvy - a.dvy, b.dvz - a.dvz
    pn = px * nx + py * ny + pz * nz
    wx, wy, wz = ri * a.dwx + rj * b.dwx, ri * a.dwy + rj * b.dwy, ri * a.dwz + rj * b.dwz
    ux, uy, uz = slip_velocity((px - pn * nx, py - pn * ny, pz - pn * nz), (nx, ny, nz), (wx, wy, wz))
    return pn, ux, uy, uz


@inline
def bias_of(contact: ContactRecord, between_bodies: bool, tx: float, ty: float, tz: float, drift: float) -> float:
    """Return the bias c (m/s) of a contact at these velocities: `bias_along_arc` if two bodies drift."""
    bias: float = contact.velocity_bias
    if drift > 0.0 and between_bodies:
        bias = bias_along_arc(bias, contact.arm_i + contact.arm_j, tx, ty, tz, drift)
    return bias


@inline
def bias_along_arc(bias: float, distance: float, tx: float, ty: float, tz: float, drift: float) -> float:
    """Return the closing speed c (m/s) with which a contact just touches after a drift.

    Spheres that roll about each other separate along the tangent by R - √(R² - v_t² dt²) in a drift of dt, where R is
    their distance after it. ``bias`` is c for a drift along the normal.

    Parameters
    ----------
    bias
        m/s
    distance
        m, sum of the lever arms.
    tx, ty, tz
        m/s, v_t.
    drift
        s
    """
    R = distance - bias * drift
    t2 = (tx * tx + ty * ty + tz * tz) * drift * drift
    more = t2 / ((R + np.sqrt(R * R - t2)) * drift)
    return bias + where((t2 > 0.0) & (t2 < R * R), more, 0.0)
