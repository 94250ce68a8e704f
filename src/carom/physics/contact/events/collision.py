"""An impact within a drift, at its exact time: impulse, friction, and its row of the log.

The velocity at a time τ is v + a (τ - h), where h is the kick before the drift. With these velocities, energies are
exact: if the impulse J removes -J·(v(τ) + J/2m), the kicks before and after the drift do exactly gravity's work along
the bent path. With a constant acceleration, a rebound conserves its energy to the last bits. If this acceleration is
the uniform field, the bodies meet at the point where their parabolas meet, so the time and the outcome of the impact
are exact. Drag changes none of this, given the velocities and times in `trajectories`.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import RecordArray
from carom.physics.contact.events.supports import add_support, is_supported, leave_or_stay
from carom.physics.contact.events.trajectories import (
    Trajectories,
    centre,
    contact_geometry,
    elapsed,
    lag,
    mean_velocity_of_wall,
    relative_velocity,
    rest_speed,
    slowing,
    velocity,
    velocity_of_partner,
)
from carom.physics.contact.guided_walls import push_guided
from carom.physics.contact.law import (
    exerts_torque,
    friction_of_impact,
    inverse_tangent_mass,
    material_index,
    normal_loss,
    rebound,
    restitution_of_impact,
)
from carom.physics.contact.moving_walls import slip_at_wall
from carom.physics.contact.records import ImpactRecord
from carom.physics.contact.rolling import angular_impulse_of_impact, set_angular_impulse
from carom.physics.contact.solver.body_state import slip_velocity
from carom.physics.contact.translating_walls import velocity_in_drift, walls_translate
from carom.physics.jit.decorators import inner
from carom.physics.rotation import rotate_one
from carom.physics.sheared_box import add_work, is_sheared, nearest_in_drift
from carom.physics.vector import add, between, square, vector


@inner
def collide(i: int, j: int, log: RecordArray[ImpactRecord], row: int, T: Trajectories) -> None:
    """Resolve an impact with the velocities at its time, and write it into a row of the log.

    The velocities of bodies that something fixed supports include the pushes of their contacts, whose losses change
    (`supports`).
    """
    one, other = is_supported(i, T), is_supported(j, T)
    pushed, along_path, with_support = 0.0, 0.0, 0.0
    if one or other:
        nx, ny, nz, _, _ = contact_geometry(i, j, T)
        vx, vy, vz = relative_velocity(i, j, T)
        along_path = _kinetic_energy(one, i, T) + _kinetic_energy(other, j, T)
        add_support(i, 1.0, T)
        add_support(j, 1.0, T)
        wx, wy, wz = relative_velocity(i, j, T)
        pushed = (wx - vx) * nx + (wy - vy) * ny + (wz - vz) * nz
        with_support = _kinetic_energy(one, i, T) + _kinetic_energy(other, j, T)
        if not wx * nx + wy * ny + wz * nz < 0.0:  # friction has ended the approach, which goes on along straight paths
            add_support(i, -1.0, T)
            add_support(j, -1.0, T)
            pushed, one, other = 0.0, False, False
    _collide(i, j, log, row, pushed, T)
    if not (one or other):
        return
    entry, drift = log[row], T.drift[0]
    with_support -= _kinetic_energy(one, i, T) + _kinetic_energy(other, j, T)
    Jx = entry.normal_impulse * entry.nx + entry.friction_x
    Jy = entry.normal_impulse * entry.ny + entry.friction_y
    Jz = entry.normal_impulse * entry.nz + entry.friction_z
    pressed = leave_or_stay(i, -Jx, -Jy, -Jz, T) + leave_or_stay(j, Jx, Jy, Jz, T)
    along_path -= _kinetic_energy(one, i, T) + _kinetic_energy(other, j, T)
    drift.restitution -= pressed
    drift.friction -= with_support - along_path - pressed


@inner
def _kinetic_energy(counts: bool, i: int, T: Trajectories) -> float:
    """Return the kinetic energy (J) of a body at the present time if it ``counts``, otherwise 0."""
    if not counts:
        return 0.0
    vx, vy, vz = velocity(i, T)
    energy = 0.5 * (vx * vx + vy * vy + vz * vz) / T.inverse_mass[i]
    if len(T.omega) > 0 and T.inverse_inertia[i] > 0.0:
        energy += 0.5 * square(T.omega, i) / T.inverse_inertia[i]
    return float(energy)


@inner
def _collide(i: int, j: int, log: RecordArray[ImpactRecord], row: int, pushed: float, T: Trajectories) -> None:
    """Resolve an impact with the velocities of `velocity`; ``pushed`` (m/s) is the part of v_n due to supports.

    If a row of the log were the argument, Numba would compare the type of the row with the types of all other logs, and
    warn.
    """
    entry = log[row]
    v, omega, clock, f = T.v, T.omega, T.drift[0].clock, slowing(T)
    n, mi, mj = len(T.x), T.inverse_mass[i], T.inverse_mass[j]
    nx, ny, nz, ri, rj = contact_geometry(i, j, T)
    ax, ay, az = between(T.a, i, j)
    vx, vy, vz = relative_velocity(i, j, T)
    vn = vx * nx + vy * ny + vz * nz
    material = T.materials[material_index(i, j, n, T.places)]
    Kn = mi + mj
    slow = rest_speed(i, j, (nx, ny, nz), T)
    e = restitution_of_impact(material, -vn, slow, Kn, ri, rj)
    Jn = max(0.0, rebound(e, vn)) / Kn
    entry.restitution_loss, entry.stabilisation_gain = normal_loss(Jn, vn, Kn), 0.0
    lands = False
    if max(T.load_speed[i], T.load_speed[j]) > 0.0:  # a force may press the bodies together
        landing = _landing_velocity(i, j, nx, ny, nz, ax * nx + ay * ny + az * nz, T) + pushed
        lands = landing > max(vn, -e * vn)
        if lands:
            Jn = (landing - vn) / Kn
            entry.stabilisation_gain = entry.restitution_loss - normal_loss(Jn, vn, Kn)
    _note_landing(i, lands, T)
    _note_landing(j, lands, T)
    Jx, Jy, Jz = Jn * nx, Jn * ny, Jn * nz
    entry.i, entry.j, entry.time, entry.clock = i, j, elapsed(T), clock
    entry.nx, entry.ny, entry.nz = nx, ny, nz
    entry.approach, entry.rest_speed, entry.friction_loss = max(0.0, -vn), slow, 0.0
    entry.normal_impulse, entry.arm_i, entry.arm_j = Jn, ri, rj
    entry.friction_x = entry.friction_y = entry.friction_z = 0.0
    set_angular_impulse(entry, 0.0, 0.0, 0.0)
    x, y, z = centre(i, T)
    entry.x, entry.y, entry.z = x + ri * nx, y + ri * ny, z + ri * nz
    if len(omega) > 0:
        wix, wiy, wiz = vector(omega, i)
        wjx, wjy, wjz = vector(omega, j)
        wx, wy, wz = ri * wix + rj * wjx, ri * wiy + rj * wjy, ri * wiz + rj * wjz
        ux, uy, uz = slip_velocity((vx - vn * nx, vy - vn * ny, vz - vn * nz), (nx, ny, nz), (wx, wy, wz))
        if j >= n:
            ux, uy, uz = slip_at_wall(T.surface, j - n, entry.time, (entry.x, entry.y, entry.z), (ux, uy, uz))
        Kt = inverse_tangent_mass(Kn if j < n else mi, ri, rj, T.inverse_inertia[i], T.inverse_inertia[j])
        fx, fy, fz, entry.friction_loss = friction_of_impact(material, Jn, ux, uy, uz, Kt)
        if fx != 0.0 or fy != 0.0 or fz != 0.0:
            Jx, Jy, Jz = Jx + fx, Jy + fy, Jz + fz
            entry.friction_x, entry.friction_y, entry.friction_z = fx, fy, fz
            tx, ty, tz = nz * fy - ny * fz, nx * fz - nz * fx, ny * fx - nx * fy  # the normal part has no torque
            _spin_up(i, ri, tx, ty, tz, T)
            if j < n:
                _spin_up(j, rj, tx, ty, tz, T)
        K = T.inverse_inertia[i] + T.inverse_inertia[j]
        if exerts_torque(material) and K > 0.0:
            wx, wy, wz = between(omega, i, j)
            lx, ly, lz, dissipated = angular_impulse_of_impact(entry, material, Jn, wx, wy, wz, K)
            entry.friction_loss += dissipated
            set_angular_impulse(entry, lx, ly, lz)
            _spin_up(i, -1.0, lx, ly, lz, T)
            if j < n:
                _spin_up(j, 1.0, lx, ly, lz, T)
    add(v, i, -mi / f, Jx, Jy, Jz)
    if mj > 0.0 and j >= n:
        push_guided(T.surface, j - n, clock, -mj * Jn)
    elif mj > 0.0:
        add(v, j, mj / f, Jx, Jy, Jz)
    if is_sheared(T.box):
        wx, wy, wz = velocity_of_partner(i, j, T)
        add_work(T.box, -(Jx * wx + Jy * wy + Jz * wz))
        entry.x, entry.y, entry.z = nearest_in_drift(entry.x, entry.y, entry.z, T.box, clock)
    entry.vix, entry.viy, entry.viz = velocity(i, T)
    entry.vjx, entry.vjy, entry.vjz = velocity(j, T)


@inner
def _landing_velocity(i: int, j: int, nx: float, ny: float, nz: float, an: float, T: Trajectories) -> float:
    """Return the normal velocity in m/s at which two bodies must separate to touch again only at the end of the drift.

    The result is -infinity unless the relative acceleration ``an`` in m/s² presses the bodies together. Bodies that
    separate more slowly would overlap at the end, because nothing holds them against the force until then.
    """
    if not an < 0.0:
        return -np.inf
    drift, n = T.drift[0], len(T.x)
    pressing = nx * drift.field_x + ny * drift.field_y + nz * drift.field_z
    bend = (0.0 if T.body[i].is_straight else pressing) - (0.0 if j >= n or T.body[j].is_straight else pressing)
    rise = 0.5 * drift.clock  # s, this is `lag` divided by the remaining time
    if drift.damping > 0.0:
        remaining = drift.dt - drift.clock
        rise = 1.0 / (1.0 - drift.damping * (drift.dt - drift.kick)) / drift.damping - 1.0 / drift.damping
        rise = min(rise, lag(T) / remaining) if remaining > 0.0 else rise
    landing = float(an * (drift.clock - drift.kick) + slowing(T) * rise * bend)
    if walls_translate(T.surface) and j >= n:
        vx, vy, vz = velocity_in_drift(T.surface, j - n, elapsed(T))
        wx, wy, wz = mean_velocity_of_wall(j, T)
        landing += (vx - wx) * nx + (vy - wy) * ny + (vz - wz) * nz
    return landing


@inner
def _note_landing(i: int, lands: bool, T: Trajectories) -> None:
    """Record whether a body stays on what it has hit last; ``i`` may be a solid."""
    if i < len(T.x):
        T.body[i].has_landed = lands and T.inverse_mass[i] > 0.0


@inner
def _spin_up(i: int, arm: float, tx: float, ty: float, tz: float, T: Trajectories) -> None:
    """Change a body's spin by the torque of an impulse, and its orientation at the end of the drift accordingly.

    All orientations have already been rotated for the whole step, so the remaining rotation is undone and repeated with
    the new spin.
    """
    s = arm * T.inverse_inertia[i]
    if s == 0.0:
        return
    remaining = T.drift[0].dt - elapsed(T)
    rotate_one(i, T.q, T.omega, -remaining)
    add(T.omega, i, s, tx, ty, tz)
    rotate_one(i, T.q, T.omega, remaining)
