"""Walls whose surface moves along itself, such as a rotating drum.

The shape of such a wall does not change, so its contacts and times of impact are the same as without rotation.
Only the slip differs: at the contact point p, the surface of a wall that rotates at Ω about an axis through c has the
velocity

    s = Ω × (p - c),    u = v_t + s - ρ_i ω_i × n

If the wall translates, too (`translating_walls`), c moves with it, and v_t contains its velocity. Friction λ_t and an
angular impulse Λ act on the wall, -λ_t and -Λ on the body. The ledger books the energy that both impulses dissipate,
-λ_t·u - Λ·(Ω - ω_i). The wall does the work

    W = -λ_t·s - Λ·Ω

on the body, which the ledger books as a separate entry. Records of contacts have the field s, and records of solids the
fields Ω and c, only in scenes with such walls; without these fields, the functions below do nothing.
"""

from __future__ import annotations

from typing import Any

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.contact.records import ImpactRecord, ImpulseRecord, SlidingWallContactRecord
from carom.physics.contact.rolling import angular_impulse
from carom.physics.contact.translating_walls import displacement_in_drift, shift_of
from carom.physics.jit.decorators import chosen_by_type, inline, kernel, with_field
from carom.physics.vector import Vector

ENTRY = "walls"  # name of the ledger entry, which is -W because a loss is positive
MOTION = ("motion_spin_x", "motion_spin_y", "motion_spin_z", "motion_x", "motion_y", "motion_z")  # Ω and c of a solid


def slip_on_wall(contact: Any, ux: float, uy: float, uz: float) -> tuple[float, float, float]:
    """Return the slip u in m/s, given the slip on a wall at rest; vectors of doubles are accepted, too."""
    if not hasattr(contact, "surface_x"):
        return ux, uy, uz
    return ux + contact.surface_x, uy + contact.surface_y, uz + contact.surface_z


@chosen_by_type(slip_on_wall)
def _slip_on_wall(contact: Any, ux: Any, uy: Any, uz: Any) -> Any:
    if "surface_x" not in contact.fields:
        return lambda contact, ux, uy, uz: (ux, uy, uz)

    def of_contact(contact: Any, ux: float, uy: float, uz: float) -> tuple[float, float, float]:
        sx, sy, sz = _surface_velocity(contact)
        return ux + sx, uy + sy, uz + sz

    return of_contact


@inline
def _surface_velocity(contact: Any) -> Vector:
    """Return s in m/s. For a contact between bodies, the third cache line is not read."""
    if contact.arm_j > 0.0:
        return 0.0, 0.0, 0.0
    return contact.surface_x, contact.surface_y, contact.surface_z


def along_surface_velocity(contact: Any, tx: Any, ty: Any, tz: Any) -> Any:
    """Return λ_t·s in J, in lanes."""
    return tx * contact.surface_x + ty * contact.surface_y + tz * contact.surface_z


def _slope_with_surface(contact: Any, slope: float, tx: float, ty: float, tz: float) -> float:
    sx, sy, sz = _surface_velocity(contact)
    return slope + (tx * sx + ty * sy + tz * sz)


@with_field("surface_x", _slope_with_surface)
def slope_on_wall(contact: object, slope: float, tx: float, ty: float, tz: float) -> float:
    """Add λ_t·s to a sum of impulses times velocities in J; the velocities of bodies do not contain s."""
    return slope


def _set_surface_velocity(contact: Any, surface: FloatArray, solid: int, point: Vector) -> None:
    contact.surface_x, contact.surface_y, contact.surface_z = velocity_of_wall(surface, solid, point)


@with_field("surface_x", _set_surface_velocity)
def set_surface_velocity(contact: object, surface: FloatArray, solid: int, point: Vector) -> None:
    """Set s of a contact with a wall, given the contact point (m)."""


def _clear_surface_velocity(contact: Any) -> None:
    contact.surface_x = contact.surface_y = contact.surface_z = 0.0


@with_field("surface_x", _clear_surface_velocity)
def clear_surface_velocity(contact: object) -> None:
    """Set s of a contact to 0."""


def _slip_on_moving(surface: FloatArray, solid: int, time: float, point: Vector, slip: Vector) -> Vector:
    (ux, uy, uz), (sx, sy, sz) = slip, velocity_in_wall(surface, solid, time, point)
    return ux + sx, uy + sy, uz + sz


@with_field(MOTION[0], _slip_on_moving)
def slip_at_wall(surface: FloatArray, solid: int, time: float, point: Vector, slip: Vector) -> Vector:
    """Return the slip u (m/s) at a point (m) of a wall and a time (s) in the drift, given the slip without rotation."""
    return slip


@inline
def velocity_of_wall(surface: Any, solid: int, point: Vector) -> Vector:
    """Return s in m/s at a point (m) of a wall; ``surface`` has the fields `MOTION`."""
    wall, (x, y, z), (dx, dy, dz) = surface[solid], point, shift_of(surface, solid)
    wx, wy, wz = wall.motion_spin_x, wall.motion_spin_y, wall.motion_spin_z
    dx, dy, dz = x - dx - wall.motion_x, y - dy - wall.motion_y, z - dz - wall.motion_z
    return wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx


@inline
def velocity_in_wall(surface: Any, solid: int, time: float, point: Vector) -> Vector:
    """Return s in m/s at a point (m) of a wall and a time (s) in the drift."""
    (x, y, z), (dx, dy, dz) = point, displacement_in_drift(surface, solid, time)
    return velocity_of_wall(surface, solid, (x - dx, y - dy, z - dz))


@kernel
def work_of_contacts(
    pairs: IntArray,
    contacts: RecordArray[SlidingWallContactRecord],
    impulses: RecordArray[ImpulseRecord],
    surface: Any,
    bodies: int,
) -> float:
    """Return the work (J) that moving walls do on the first ``bodies`` ends by impulses of contacts.

    ``impulses``, (m,), may be the records of the contacts.
    """
    work = 0.0
    for c in range(len(pairs)):
        j = pairs[c, 1]
        if j >= bodies:
            contact, given, wall = contacts[c], impulses[c], surface[j - bodies]
            work -= given.friction_x * contact.surface_x
            work -= given.friction_y * contact.surface_y
            work -= given.friction_z * contact.surface_z
            lx, ly, lz = angular_impulse(given)
            work -= lx * wall.motion_spin_x + ly * wall.motion_spin_y + lz * wall.motion_spin_z
    return work


@kernel
def work_of_impacts(log: RecordArray[ImpactRecord], surface: Any, bodies: int) -> float:
    """Return the work in J that moving walls do on bodies in impacts during a drift; see `work_of_contacts`."""
    work = 0.0
    for k in range(len(log)):
        entry = log[k]
        if entry.j >= bodies:
            wall = surface[entry.j - bodies]
            sx, sy, sz = velocity_in_wall(surface, entry.j - bodies, entry.time, (entry.x, entry.y, entry.z))
            work -= entry.friction_x * sx + entry.friction_y * sy + entry.friction_z * sz
            lx, ly, lz = angular_impulse(entry)
            work -= lx * wall.motion_spin_x + ly * wall.motion_spin_y + lz * wall.motion_spin_z
    return work
