"""The contact law in kernels: the impulses that a contact may exert, and the code that all laws share.

The functions below are the ones that `carom.scene.contact_laws.ContactLaw` defines. Kernels call these functions with
``material``, the record of a contact's coefficients. The type of the record names the law, by default Coulomb's
(`coulomb`). Numba selects the functions by that type when it compiles a kernel, so a call costs nothing, and functions
that a law lacks are not compiled. Kernels are compiled separately for each law; `KernelCache` stores them by the types
of their arguments. The other arguments are

- ``approach``, ``rest_speed`` in m/s: the closing speed, and the closing speed up to which the contact is at rest
- ``normal`` in N s: the normal impulse of an impact, or the total since the kick
- ``stopping``, (tx, ty, tz) in N s, (x, y, z) in N m s: the impulse that would end the relative motion
- ``mass`` in kg: m_i m_j / (m_i + m_j), or the mass of the body at a plane
- ``radius`` in m: r_i r_j / (r_i + r_j), or the radius of the body at a plane

All laws share three things:

- Normal impulses are repulsive, λ_n ≥ 0: the solver relies on this. A law with adhesion would need changes wherever the
  solver releases a contact: `solver.solve`, `solver.refine`, `solver.phases` and `statistics`.
- The warm start keeps one normal and one tangential impulse, `IMPULSES`, and one angular impulse (`rolling`).
- The ledger books the energy removed by the normal impulse as restitution, and the remaining loss as friction.

`carom.physics.reference_api.CollisionContext` repeats Coulomb's law in vector form for comparison in tests.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from carom.arrays import IntArray, RecordArray, dtype_of
from carom.physics.contact import coulomb
from carom.physics.jit.decorators import Function, chosen_by_type, identity_of, inline, inner
from carom.physics.vector import Vector
from carom.scene.contact_laws import functions_of
from carom.scene.matter import PairCoefficients
from carom.scene.schema import Coefficients

MATERIAL = dtype_of(Coefficients)
# names of λ_n and the components of λ_t in `CONTACT`, N s
IMPULSES = ("normal_impulse", "friction_x", "friction_y", "friction_z")
NORMAL, FRICTION_X, FRICTION_Y, FRICTION_Z = range(len(IMPULSES))  # columns of `IMPULSES` in arrays
LAW = coulomb  # the law in plain Python, which supports no other law

_ONLY_KERNELS = "only kernels call it"
_MARK = "contact_law_"  # prefix of the first field in materials whose law is not Coulomb's
# functions by the name of the marking field, then by their own names
_laws: dict[str, dict[str, Callable[..., Any]]] = {}


class Materials(NamedTuple):
    """The coefficients of each pair of ends that may touch; see `carom.scene.matter.PairCoefficients`."""

    rows: RecordArray[Coefficients]  # (k,) MATERIAL, with further fields if the law is not Coulomb's
    places: IntArray  # (n + p, 2) places for `material_index`; empty where all bodies have one material


def materials_of(pairs: PairCoefficients, owner: IntArray | None = None) -> Materials:
    """Return the coefficients of each pair as records.

    ``owner``, (p + f,), is the number of the plane or wall whose coefficients apply to each end that is not a body; by
    default, each such end has its own coefficients.
    """
    places, kept = pairs.places, np.arange(len(pairs.rows))
    if owner is not None and len(places):
        places = np.concatenate((places[: pairs.bodies], places[pairs.bodies + owner]))
    elif owner is not None:
        kept = np.append(0, 1 + owner)
    own = np.ascontiguousarray(pairs.rows[kept], dtype=np.float64).view(MATERIAL)[:, 0]
    mark = _mark_of(pairs.laws)
    if not mark:
        return Materials(own, places)
    fields = [mark, *Coefficients._fields, *pairs.names]
    rows = np.zeros(len(own), np.dtype([(name, np.float64) for name in fields], align=True))
    for name in Coefficients._fields:
        rows[name] = own[name]
    for name, values in zip(pairs.names, pairs.further[kept].T, strict=True):
        rows[name] = values
    return Materials(rows, places)


def _mark_of(laws: tuple[str, ...]) -> str:
    """Prepare the functions of a list of laws for kernels; return the name of the field that identifies the list.

    The name is empty for Coulomb's law.
    """
    own = functions_of(laws)
    if not own:
        return ""
    mark = f"{_MARK}{'_'.join(laws)}_{identity_of(*own.values())}_{'_'.join(own)}"
    _laws[mark] = own
    return mark


def _functions_of(kind: Any) -> dict[str, Callable[..., Any]]:
    """Return the functions, by name, that the law of a material type (NumPy's or Numba's) defines."""
    return _laws.get(next(iter(kind.fields)), {})


def has_torque(kind: Any) -> bool:
    """Return whether contacts with this type of material resist rolling or twisting."""
    return not _functions_of(kind).keys().isdisjoint(("rolling", "twisting"))


def _of_law(stub: Function) -> Function:
    """Let kernels call the law's function of this name, or Coulomb's if the law lacks it."""

    @chosen_by_type(stub)
    def of_law(material: Any, *arguments: Any) -> Any:
        own = _functions_of(material).get(stub.__name__)
        return own or getattr(coulomb, stub.__name__).py_func

    return stub


@_of_law
def restitution(material: Coefficients, approach: float, rest_speed: float) -> float:
    """Return the coefficient of restitution of an impact."""
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def equivalent_speed(material: Coefficients, approach: float, mass: float, radius: float) -> float:
    """Return the speed (m/s) at which `restitution` holds for an impact, for laws that depend on the sizes of bodies.

    Coulomb's law lacks this function.
    """
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def dissipates(material: Coefficients) -> bool:
    """Return whether an impact may rebound more slowly than it closed."""
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def impact_friction(material: Coefficients, normal: float, stopping: float) -> float:
    """Return the tangential impulse of an impact, against the slip; ``stopping`` would end the slip."""
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def lasting_friction(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> Vector:
    """Return the tangential impulse that a lasting contact exerts; (tx, ty, tz) would end the slip.

    Impulses are totals since the kick, not the increments of an iteration.
    """
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def sliding_friction(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> Vector:
    """Return the tangential impulse of a lasting contact that has slid and does not stick again.

    The arguments are as in `lasting_friction`. The impulse must be continuous in them; see `solver.phases`.
    """
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def sticks(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> bool:
    """Return whether the contact sticks with these totals of the normal and tangential impulses."""
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def slides(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> bool:
    """Return whether a contact that exerted these totals slid, for reports."""
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def rolling(material: Coefficients, normal: float, radius: float, x: float, y: float, z: float) -> Vector:
    """Return the angular impulse against rolling; (x, y, z) would end the rolling and has no normal component."""
    raise NotImplementedError(_ONLY_KERNELS)


@_of_law
def twisting(material: Coefficients, normal: float, radius: float, stopping: float) -> float:
    """Return the angular impulse about the normal; ``stopping`` would end the twisting."""
    raise NotImplementedError(_ONLY_KERNELS)


def exerts_torque(material: Coefficients) -> bool:
    """Return whether the law resists rolling or twisting; a constant in compiled kernels."""
    raise NotImplementedError(_ONLY_KERNELS)


@chosen_by_type(exerts_torque)
def _exerts_torque(material: Any) -> Any:
    exerts = has_torque(material)
    return lambda material: exerts


def restitution_of_impact(
    material: Coefficients, approach: float, rest_speed: float, inverse_mass: float, arm_i: float, arm_j: float
) -> float:
    """Return the coefficient of restitution of an impact of two bodies, or of a body and a plane.

    ``inverse_mass`` is 1/m_i + 1/m_j in 1/kg; the lever arms are in m, with 0 at a plane.
    """
    raise NotImplementedError(_ONLY_KERNELS)


@chosen_by_type(restitution_of_impact)
def _restitution_of_impact(material: Any, *arguments: Any) -> Any:
    if "equivalent_speed" not in _functions_of(material):
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


@inner
def material_index(i: int, j: int, bodies: int, places: IntArray) -> int:
    """Return the row of the coefficients of ends i < j; with one material, row 0 is for bodies, 1 + p for plane p.

    This function is not inlined. If it were, Numba would count references to the array, and a sweep over 5·10⁴ contacts
    would take 20 ms instead of 15 ms.
    """
    if len(places) == 0:
        return max(0, j - bodies + 1)
    row: int = places[i, 0] + places[j, 1]
    return row


@inline
def restitution_at_depth(e: float, vn: float, overlap: float, acceleration: float) -> float:
    """Return the restitution coefficient of an impact that is detected late; see `solver.impacts`.

    The coefficient is ``e`` at the surface. At the detection, the bodies have the normal velocity ``vn`` (m/s), an
    overlap (m), and a relative acceleration (m/s²) that presses them together.
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

    The impact has the normal impulse Jn in N s and the slip (ux, uy, uz) in m/s; Kt is `inverse_tangent_mass`.
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
