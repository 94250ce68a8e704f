"""The contact law in kernels: the impulses that a contact may exert, and the code that all laws share.

The functions below are those of `carom.scene.contact_laws.ContactLaw`. Kernels call them with ``material``, the record
of a contact's coefficients. The type of the record names the law, by default Coulomb's (`coulomb`). Numba selects the
functions by that type when it compiles a kernel, so a call costs nothing, and what a law lacks is not compiled. Kernels
are compiled separately for each law, and `KernelCache` stores them under these types.

All laws share three things:

- Normal impulses are repulsive, λ_n ≥ 0: a condition of the solver. A law with adhesion would change the places where
the solver releases a contact: `solver.solve`, `solver.refine`, `solver.phases` and `statistics`.
- The warm start keeps one normal and one tangential impulse, `IMPULSES`, and one angular impulse (`rolling`).
- The ledger books the energy removed by the normal impulse as restitution, and the remaining loss as friction.

`carom.physics.reference_api.CollisionContext` repeats Coulomb's law in vector form, for tests to compare.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from carom.arrays import IntArray, RecordArray, dtype_of
from carom.physics.contact import coulomb
from carom.physics.jit.decorators import chosen_by_type, identity_of, inline, unowned
from carom.scene.contact_laws import FUNCTIONS, functions_of
from carom.scene.matter import PairCoefficients
from carom.scene.schema import Coefficients

MATERIAL = dtype_of(Coefficients)
IMPULSES = ("normal_impulse", "friction_x", "friction_y", "friction_z")  # N s, λ_n and λ_t: fields of `CONTACT`
NORMAL, FRICTION_X, FRICTION_Y, FRICTION_Z = range(len(IMPULSES))  # their columns in arrays
LAW = coulomb  # for plain Python, which supports this law only

_MARK = "contact_law_"  # prefix of the first field of a material whose law is not Coulomb's
_laws: dict[str, dict[str, Callable[..., Any]]] = {}  # functions by the name of that field and by their own names


class Materials(NamedTuple):
    """The coefficients of each pair of ends that may touch; see `carom.scene.matter.PairCoefficients`."""

    rows: RecordArray[Coefficients]  # (k,) MATERIAL, with further fields if the law is not Coulomb's
    places: IntArray  # (n + p, 2) for `material_index`; no rows where all bodies have one material


def materials_of(pairs: PairCoefficients) -> Materials:
    """Return the coefficients of each pair as records."""
    own = np.ascontiguousarray(pairs.rows, dtype=np.float64).view(MATERIAL)[:, 0]
    mark = _mark_of(pairs.laws)
    if not mark:
        return Materials(own, pairs.places)
    fields = [mark, *Coefficients._fields, *pairs.names]
    rows = np.zeros(len(own), np.dtype([(name, np.float64) for name in fields], align=True))
    for name in Coefficients._fields:
        rows[name] = own[name]
    for name, values in zip(pairs.names, pairs.further.T, strict=True):
        rows[name] = values
    return Materials(rows, pairs.places)


def _mark_of(laws: tuple[str, ...]) -> str:
    """Prepare the functions of a list of laws for kernels; return the name of the field that identifies the list.

    The name is empty for Coulomb's law.
    """
    own = functions_of(laws)
    if not own:
        return ""
    mark = f"{_MARK}{'_'.join(laws)}_{identity_of(*own.values())}_{'_'.join(own)}"
    if mark not in _laws:
        _laws[mark] = own
    return mark


def has_torque(kind: Any) -> bool:
    """Return whether contacts with this type of material (NumPy's or Numba's) resist rolling or twisting."""
    functions = _laws.get(next(iter(kind.fields)), {})
    return "rolling" in functions or "twisting" in functions


def restitution(material: Coefficients, approach: float, rest_speed: float) -> float:
    """Return the coefficient of restitution of an impact.

    Parameters
    ----------
    material
        Of the contact.
    approach
        m/s, closing speed.
    rest_speed
        m/s, closing speed up to which the contact is at rest.
    """
    raise NotImplementedError("only kernels call it")


def equivalent_speed(material: Coefficients, approach: float, mass: float, radius: float) -> float:
    """Return the speed (m/s) for which `restitution` is that of an impact, if it depends on the sizes of bodies.

    Parameters
    ----------
    material, approach
        As for `restitution`.
    mass
        kg, m_i m_j / (m_i + m_j), or the mass of the body at a plane.
    radius
        m, r_i r_j / (r_i + r_j), or the radius of the body at a plane.
    """
    raise NotImplementedError("only kernels call it")


def dissipates(material: Coefficients) -> bool:
    """Return whether an impact may rebound more slowly than it closed."""
    raise NotImplementedError("only kernels call it")


def impact_friction(material: Coefficients, normal: float, stopping: float) -> float:
    """Return the tangential impulse of an impact, against the slip.

    Parameters
    ----------
    material
        Of the contact.
    normal
        N s, the normal impulse of the impact.
    stopping
        N s, the tangential impulse that would end the slip.
    """
    raise NotImplementedError("only kernels call it")


def lasting_friction(
    material: Coefficients, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, float, float]:
    """Return the tangential impulse that a lasting contact exerts.

    Parameters
    ----------
    material
        Of the contact.
    normal
        N s, total of the normal impulse since the kick, not the increment of an iteration.
    tx, ty, tz
        N s, total of the tangential impulse that would end the slip.
    """
    raise NotImplementedError("only kernels call it")


def sliding_friction(
    material: Coefficients, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, float, float]:
    """Return the tangential impulse of a lasting contact that has slid and does not stick again.

    It must be continuous in its arguments, which are those of `lasting_friction`; see `solver.phases`.
    """
    raise NotImplementedError("only kernels call it")


def sticks(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> bool:
    """Return whether the contact sticks with these totals of the normal and tangential impulses."""
    raise NotImplementedError("only kernels call it")


def slides(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> bool:
    """Return whether a contact that exerted these totals slid, for reports."""
    raise NotImplementedError("only kernels call it")


def rolling(
    material: Coefficients, normal: float, radius: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return the angular impulse against rolling.

    Parameters
    ----------
    material
        Of the contact.
    normal
        N s, the normal impulse: of an impact, or the total of a lasting contact.
    radius
        m, r_i r_j / (r_i + r_j), or the radius of the body at a plane.
    x, y, z
        N m s, the angular impulse that would end the rolling; it has no normal part.
    """
    raise NotImplementedError("only kernels call it")


def twisting(material: Coefficients, normal: float, radius: float, stopping: float) -> float:
    """Return the angular impulse about the normal; ``stopping`` is the one that would end the twisting.

    Arguments as for `rolling`.
    """
    raise NotImplementedError("only kernels call it")


def exerts_torque(material: Coefficients) -> bool:
    """Return whether the law resists rolling or twisting; a constant in compiled kernels."""
    raise NotImplementedError("only kernels call it")


_STUBS = (
    *(restitution, dissipates, impact_friction, lasting_friction, sliding_friction, sticks, slides),
    *(rolling, twisting),
)
_OPTIONAL = equivalent_speed  # which Coulomb's law lacks
assert {stub.__name__ for stub in (*_STUBS, _OPTIONAL)} == set(FUNCTIONS)


def _offer(stub: Callable[..., Any]) -> None:
    """Make a function of the law callable from kernels; the type of the material selects the law."""

    @chosen_by_type(stub)
    def of_law(material: Any, *arguments: Any) -> Any:
        own = _laws.get(next(iter(material.fields)), {}).get(stub.__name__)
        coulombs: Any = getattr(coulomb, stub.__name__)
        return own or coulombs.py_func


for _stub in _STUBS:
    _offer(_stub)


@chosen_by_type(equivalent_speed)
def _equivalent_speed(material: Any, *arguments: Any) -> Any:
    return _laws[next(iter(material.fields))][_OPTIONAL.__name__]


def restitution_of_impact(
    material: Coefficients, approach: float, rest_speed: float, inverse_mass: float, arm_i: float, arm_j: float
) -> float:
    """Return the coefficient of restitution of an impact of two bodies, or of a body and a plane.

    Parameters
    ----------
    material, approach, rest_speed
        As for `restitution`.
    inverse_mass
        1/kg, 1/m_i + 1/m_j.
    arm_i, arm_j
        m, the lever arms; 0 at a plane.
    """
    raise NotImplementedError("only kernels call it")


@chosen_by_type(restitution_of_impact)
def _restitution_of_impact(material: Any, *arguments: Any) -> Any:
    if _OPTIONAL.__name__ not in _laws.get(next(iter(material.fields)), {}):
        return lambda material, approach, rest_speed, inverse_mass, arm_i, arm_j: restitution(
            material, approach, rest_speed
        )

    def of_sizes(
        material: Any, approach: float, rest_speed: float, inverse_mass: float, arm_i: float, arm_j: float
    ) -> float:
        if not approach > rest_speed:
            return restitution(material, approach, rest_speed)
        radius = arm_i * arm_j / (arm_i + arm_j) if arm_j > 0.0 else arm_i
        return restitution(material, equivalent_speed(material, approach, 1.0 / inverse_mass, radius), 0.0)

    return of_sizes


@chosen_by_type(exerts_torque)
def _exerts_torque(material: Any) -> Any:
    exerts = has_torque(material)
    return lambda material: exerts


@unowned
def material_index(i: int, j: int, bodies: int, places: IntArray) -> int:
    """Return the row of the coefficients of ends i < j; with a single material, 0 between bodies and 1 + p at plane p.

    It is not inlined, since Numba would then count references to the array: a sweep over 5·10⁴ contacts would take 20
    ms instead of 15.
    """
    if len(places) == 0:
        return max(0, j - bodies + 1)
    row: int = places[i, 0] + places[j, 1]
    return row


@inline
def restitution_at_depth(e: float, vn: float, overlap: float, acceleration: float) -> float:
    """Return the restitution coefficient of an impact that is detected late; see `solver.impacts`.

    Parameters
    ----------
    e
        The coefficient at the surface.
    vn
        m/s, normal velocity at the detection.
    overlap
        m
    acceleration
        m/s², relative acceleration that presses the bodies together.
    """
    at_depth: float = np.sqrt(e * e + (1.0 - e * e) * min(1.0, 2.0 * overlap * acceleration / (vn * vn)))
    return at_depth


@inline
def inverse_tangent_mass(Kn: float, ri: float, rj: float, inverse_inertia_i: float, inverse_inertia_j: float) -> float:
    """Return K_t = K_n + ρ_i²/I_i + ρ_j²/I_j in 1/kg, the change of the slip per tangential impulse."""
    return Kn + ri * ri * inverse_inertia_i + rj * rj * inverse_inertia_j


@inline
def friction_of_impact(
    material: Coefficients, Jn: float, ux: float, uy: float, uz: float, Kt: float
) -> tuple[float, float, float, float]:
    """Return the tangential impulse of an impact in N s, and the energy in J that it removes.

    Parameters
    ----------
    material
        Of the contact.
    Jn
        N s, the normal impulse.
    ux, uy, uz
        m/s, the slip.
    Kt
        1/kg, see `inverse_tangent_mass`.
    """
    slip = np.sqrt(ux * ux + uy * uy + uz * uz)
    if not slip > 0.0:
        return 0.0, 0.0, 0.0, 0.0
    Jt = impact_friction(material, Jn, slip / Kt)
    return -Jt * (ux / slip), -Jt * (uy / slip), -Jt * (uz / slip), Jt * (slip - 0.5 * Jt * Kt)


@inline
def rebound(e: float, vn: float) -> float:
    """Return the change of v_n by an impact in m/s, given v_n before it."""
    return -(1.0 + e) * vn


@inline
def normal_loss(Jn: float, vn: float, Kn: float) -> float:
    """Return the energy in J that a normal impulse removes, given v_n before it and K_n = 1/m_i + 1/m_j."""
    return -Jn * (vn + 0.5 * Jn * Kn)
