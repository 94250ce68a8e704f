"""Angular impulses of contacts, where the law resists rolling or twisting.

A contact exerts an angular impulse Λ on body j and -Λ on body i. It changes their relative rotation and removes energy:

    ΔΩ = K Λ,    Ω = ω_j - ω_i,    K = 1/I_i + 1/I_j,    ΔE = -Λ·(Ω + ½ K Λ)

The law limits Λ, given the angular impulse that would end Ω. The component in the tangential plane resists rolling, the
component along the normal resists twisting. Only records of such laws have the fields `ANGULAR_IMPULSE`. Numba compiles
the functions below by the type of the record; without these fields they read 0 and write nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.aligned import columns
from carom.physics.contact import law
from carom.physics.jit.decorators import chosen_by_type, inline
from carom.scene.schema import Coefficients

if TYPE_CHECKING:
    from carom.physics.contact.constraints import BodyStateRecord


class ContactGeometry(Protocol):
    """A record with a normal from i to j, and lever arms in m."""

    nx: float
    ny: float
    nz: float
    arm_i: float
    arm_j: float


class AngularImpulse(Protocol):
    """Fields of records whose law resists rolling or twisting."""

    angular_x: float  # N m s, Λ
    angular_y: float
    angular_z: float


class RollingFields(AngularImpulse, Protocol):
    """Further fields of a contact whose law resists rolling or twisting."""

    change_x: float  # N m s, the change of Λ in the last iteration
    change_y: float
    change_z: float
    spin_x: float  # rad/s, Ω before `hold`
    spin_y: float
    spin_z: float


ANGULAR_IMPULSE = tuple(AngularImpulse.__annotations__)


def has_angular_impulse(records: RecordArray[object]) -> bool:
    """Return whether records have an angular impulse."""
    return ANGULAR_IMPULSE[0] in (records.dtype.names or ())


def angular_impulses_of(records: RecordArray[object]) -> FloatArray:
    """Return Λ, (m, 3) N m s, as a view; (m, 0) for records without it."""
    return columns(records, ANGULAR_IMPULSE) if has_angular_impulse(records) else np.empty((len(records), 0))


def angular_impulse(record: object) -> tuple[float, float, float]:
    """Return Λ in N m s; 0 for records without it."""
    raise NotImplementedError("only kernels call it")


def set_angular_impulse(record: object, x: float, y: float, z: float) -> None:
    """Set Λ in N m s, if the record has this field."""
    raise NotImplementedError("only kernels call it")


def change_of_angular_impulse(record: object) -> tuple[float, float, float]:
    """Return the change of Λ in the last iteration, in N m s; 0 for records without it."""
    raise NotImplementedError("only kernels call it")


def set_change_of_angular_impulse(record: object, x: float, y: float, z: float) -> None:
    """Set the change of Λ in the last iteration, in N m s, if the record has this field."""
    raise NotImplementedError("only kernels call it")


def spin_before(record: object) -> tuple[float, float, float]:
    """Return Ω before `hold` in rad/s; 0 for records without it."""
    raise NotImplementedError("only kernels call it")


def set_spin_before(record: object, x: float, y: float, z: float) -> None:
    """Set Ω before `hold` in rad/s, if the record has this field."""
    raise NotImplementedError("only kernels call it")


@chosen_by_type(angular_impulse)
def _angular_impulse(record: Any) -> Any:
    if "angular_x" not in record.fields:
        return lambda record: (0.0, 0.0, 0.0)
    return lambda record: (record.angular_x, record.angular_y, record.angular_z)


@chosen_by_type(set_angular_impulse)
def _set_angular_impulse(record: Any, x: Any, y: Any, z: Any) -> Any:
    if "angular_x" not in record.fields:
        return lambda record, x, y, z: None

    def put(record: Any, x: float, y: float, z: float) -> None:
        record.angular_x, record.angular_y, record.angular_z = x, y, z

    return put


@chosen_by_type(change_of_angular_impulse)
def _change_of_angular_impulse(record: Any) -> Any:
    if "change_x" not in record.fields:
        return lambda record: (0.0, 0.0, 0.0)
    return lambda record: (record.change_x, record.change_y, record.change_z)


@chosen_by_type(set_change_of_angular_impulse)
def _set_change_of_angular_impulse(record: Any, x: Any, y: Any, z: Any) -> Any:
    if "change_x" not in record.fields:
        return lambda record, x, y, z: None

    def put(record: Any, x: float, y: float, z: float) -> None:
        record.change_x, record.change_y, record.change_z = x, y, z

    return put


@chosen_by_type(spin_before)
def _spin_before(record: Any) -> Any:
    if "spin_x" not in record.fields:
        return lambda record: (0.0, 0.0, 0.0)
    return lambda record: (record.spin_x, record.spin_y, record.spin_z)


@chosen_by_type(set_spin_before)
def _set_spin_before(record: Any, x: Any, y: Any, z: Any) -> Any:
    if "spin_x" not in record.fields:
        return lambda record, x, y, z: None

    def put(record: Any, x: float, y: float, z: float) -> None:
        record.spin_x, record.spin_y, record.spin_z = x, y, z

    return put


@inline
def relative_spin(a: BodyStateRecord, b: BodyStateRecord) -> tuple[float, float, float]:
    """Return Ω of two bodies in rad/s."""
    return b.wx - a.wx, b.wy - a.wy, b.wz - a.wz


@inline
def limited(
    contact: ContactGeometry, material: Coefficients, normal: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return the angular impulse that the law allows, in N m s, given the one that would end Ω.

    Parameters
    ----------
    contact
        A record with the normal and the lever arms.
    material
        Of the contact.
    normal
        N s, the normal impulse that limits the angular impulse.
    x, y, z
        N m s, the angular impulse that would end Ω.
    """
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
    """Return the angular impulse of an impact in N m s, and the energy in J that it takes out.

    Parameters
    ----------
    contact, material
        A record with the normal and the lever arms, and the coefficients.
    normal
        N s, the normal impulse.
    wx, wy, wz, K
        rad/s, Ω before it, and 1/(kg m²).
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
    """Add the changes of `apply_angular_impulse` to those of the iteration."""
    si, sj = a.inverse_inertia, b.inverse_inertia
    if si > 0.0:
        a.dwx -= si * x
        a.dwy -= si * y
        a.dwz -= si * z
    if sj > 0.0:
        b.dwx += sj * x
        b.dwy += sj * y
        b.dwz += sj * z
