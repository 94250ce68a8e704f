"""Angular impulses of contacts, where the law resists rolling or twisting.

A contact exerts an angular impulse Λ on body j and -Λ on body i. The angular impulse changes their relative rotation
and removes energy:

    ΔΩ = K Λ,    Ω = ω_j - ω_i,    K = 1/I_i + 1/I_j,    ΔE = -Λ·(Ω + ½ K Λ)

The law limits Λ, given the angular impulse that would end Ω. The component in the tangential plane resists rolling, the
component along the normal resists twisting. Only the records of such laws have the fields `ANGULAR_IMPULSE`; without
these fields, the functions below read 0 and write nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.aligned import columns
from carom.physics.contact import law
from carom.physics.contact.records import AngularImpulse, BodyStateRecord, ContactGeometry
from carom.physics.jit.decorators import inline, with_field
from carom.physics.vector import Vector
from carom.scene.schema import Coefficients

ANGULAR_IMPULSE = tuple(AngularImpulse.__annotations__)


def angular_impulses_of(records: RecordArray[object]) -> FloatArray:
    """Return Λ, (m, 3) N m s, as a view; (m, 0) for records without Λ."""
    has_it = ANGULAR_IMPULSE[0] in (records.dtype.names or ())
    return columns(records, ANGULAR_IMPULSE) if has_it else np.empty((len(records), 0))


@with_field("angular_x", lambda record: (record.angular_x, record.angular_y, record.angular_z))
def angular_impulse(record: object) -> Vector:
    """Return Λ in N m s."""
    return 0.0, 0.0, 0.0


def _set_angular_impulse(record: Any, x: float, y: float, z: float) -> None:
    record.angular_x, record.angular_y, record.angular_z = x, y, z


@with_field("angular_x", _set_angular_impulse)
def set_angular_impulse(record: object, x: float, y: float, z: float) -> None:
    """Set Λ in N m s."""


@with_field("change_x", lambda record: (record.change_x, record.change_y, record.change_z))
def change_of_angular_impulse(record: object) -> Vector:
    """Return the change of Λ in the last iteration, in N m s."""
    return 0.0, 0.0, 0.0


def _set_change(record: Any, x: float, y: float, z: float) -> None:
    record.change_x, record.change_y, record.change_z = x, y, z


@with_field("change_x", _set_change)
def set_change_of_angular_impulse(record: object, x: float, y: float, z: float) -> None:
    """Set the change of Λ in the last iteration, in N m s."""


@with_field("spin_x", lambda record: (record.spin_x, record.spin_y, record.spin_z))
def spin_before(record: object) -> Vector:
    """Return Ω before the call of `hold`, in rad/s."""
    return 0.0, 0.0, 0.0


def _set_spin_before(record: Any, x: float, y: float, z: float) -> None:
    record.spin_x, record.spin_y, record.spin_z = x, y, z


@with_field("spin_x", _set_spin_before)
def set_spin_before(record: object, x: float, y: float, z: float) -> None:
    """Set Ω before the call of `hold`, in rad/s."""


@inline
def relative_spin(a: BodyStateRecord, b: BodyStateRecord) -> Vector:
    """Return Ω of two bodies in rad/s."""
    return b.wx - a.wx, b.wy - a.wy, b.wz - a.wz


@inline
def limited(contact: ContactGeometry, material: Coefficients, normal: float, x: float, y: float, z: float) -> Vector:
    """Return the angular impulse in N m s that the law allows with a normal impulse in N s; (x, y, z) would end Ω."""
    nx, ny, nz, ri, rj = contact.nx, contact.ny, contact.nz, contact.arm_i, contact.arm_j
    radius = ri * rj / (ri + rj) if rj > 0.0 else ri
    along = x * nx + y * ny + z * nz
    rx, ry, rz = law.rolling(material, normal, radius, x - along * nx, y - along * ny, z - along * nz)
    twist = law.twisting(material, normal, radius, along)
    return rx + twist * nx, ry + twist * ny, rz + twist * nz


@inline
def angular_impulse_of_impact(
    contact: ContactGeometry, material: Coefficients, normal: float, wx: float, wy: float, wz: float, K: float
) -> tuple[float, float, float, float]:
    """Return the angular impulse of an impact in N m s, and the energy in J that it removes.

    ``normal`` is the normal impulse in N s, (wx, wy, wz) is Ω before it in rad/s, and K is in 1/(kg m²).
    """
    lx, ly, lz = limited(contact, material, normal, -wx / K, -wy / K, -wz / K)
    return lx, ly, lz, -(lx * (wx + 0.5 * K * lx) + ly * (wy + 0.5 * K * ly) + lz * (wz + 0.5 * K * lz))


@inline
def apply_angular_impulse(a: BodyStateRecord, b: BodyStateRecord, x: float, y: float, z: float) -> None:
    """Change the angular velocities of two bodies; fixed bodies are not written."""
    si, sj = a.inverse_inertia, b.inverse_inertia
    if si > 0.0:
        a.wx -= si * x
        a.wy -= si * y
        a.wz -= si * z
    if sj > 0.0:
        b.wx += sj * x
        b.wy += sj * y
        b.wz += sj * z


@inline
def accumulate_angular_impulse(a: BodyStateRecord, b: BodyStateRecord, x: float, y: float, z: float) -> None:
    """Add the changes that `apply_angular_impulse` makes to the changes of the iteration."""
    si, sj = a.inverse_inertia, b.inverse_inertia
    if si > 0.0:
        a.dwx -= si * x
        a.dwy -= si * y
        a.dwz -= si * z
    if sj > 0.0:
        b.dwx += sj * x
        b.dwy += sj * y
        b.dwz += sj * z
