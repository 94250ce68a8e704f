"""The contact law: the impulses that a contact may exert, and the functions that all laws share.

`ContactLaw` lists the functions of a law; `LAW` is the law in use, a module that defines them. Kernels call only these
functions. Numba inlines them when it compiles a kernel, so a call costs nothing. If each scene chose its law at run
time, each call would cost a branch, or each law a compilation.

To change the law:

1. Write a module like `coulomb` with these functions, each decorated by ``inline``.
2. Name it in `LAW`, below.
3. If it needs coefficients of its own, add them to ``Coefficients`` of `carom.scene.schema`, and as keys of ``Surface``
   and ``[contact]``. They become fields of `MATERIAL`. mypy names the places that make ``Coefficients``, such as
   ``combined``, which combines those of two materials.

docs/extending.md has an example.

All laws share three things:

- Contacts push and never pull: λ_n ≥ 0, the condition of the solver. A law with adhesion changes where the solver lets
  go of a contact: `solver.solve`, `solver.solve_block`, `solver.conjugate_gradients`, `solver.phases` and `statistics`.
- The warm start keeps one normal and one tangential impulse, `IMPULSES`. A law that resists rolling adds a third: to
  ``CONTACT`` in `constraints`, to `IMPULSES`, and to the phases of `solver` that handle ``friction_x``; to `IMPACT` of
  `events.event_loop`, `contact_rows` and `contact_table`; and to checkpoints, which store four numbers a contact
  (`carom.recording.schema.checkpoint_columns`).
- The ledger books what the normal impulse takes out as restitution, and what the tangential one takes out as friction.

`carom.physics.reference_api.CollisionContext` states the law in use once more, with vectors, for tests to compare.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact import coulomb
from carom.physics.jit.decorators import inline, unowned
from carom.scene.matter import PairCoefficients
from carom.scene.schema import Coefficients

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

MATERIAL = np.dtype([(name, np.float64) for name in Coefficients._fields], align=True)
IMPULSES = ("normal_impulse", "friction_x", "friction_y", "friction_z")  # N s, λ_n and λ_t: fields of `CONTACT`
NORMAL, FRICTION_X, FRICTION_Y, FRICTION_Z = range(len(IMPULSES))  # columns of arrays of them


class ContactLaw(Protocol):
    """The functions of a contact law; ``material`` is a record of `MATERIAL`, the coefficients of the pair.

    Impulses are in N s, speeds in m/s.
    """

    def restitution(self, material: Any, approach: float, rest_speed: float) -> float:
        """Return the coefficient of restitution of an impact.

        Parameters
        ----------
        material
            Of the contact.
        approach
            Closing speed.
        rest_speed
            Closing speed up to which the contact is at rest.
        """

    def dissipates(self, material: Any) -> bool:
        """Tell whether an impact may rebound more slowly than it closed."""

    def impact_friction(self, material: Any, normal: float, stopping: float) -> float:
        """Return the tangential impulse of an impact, against the slip.

        Parameters
        ----------
        material
            Of the contact.
        normal
            The normal impulse of the impact.
        stopping
            The tangential impulse that would end the slip.
        """

    def lasting_friction(self, material: Any, normal: float, tx: float, ty: float, tz: float) -> tuple[float, ...]:
        """Return the tangential impulse that a lasting contact exerts, (3,).

        Parameters
        ----------
        material
            Of the contact.
        normal
            Total of the normal impulse since the kick, not the increment of an iteration.
        tx, ty, tz
            Total of the tangential impulse that would end the slip.
        """

    def sliding_friction(self, material: Any, normal: float, tx: float, ty: float, tz: float) -> tuple[float, ...]:
        """Return the tangential impulse of a lasting contact that has slid and does not stick again, (3,).

        It must be continuous in its arguments, see `solver.phases`; they are those of `lasting_friction`.
        """

    def sticks(self, material: Any, normal: float, tx: float, ty: float, tz: float) -> bool:
        """Tell whether the contact sticks with these totals of the normal and tangential impulse."""

    def slides(self, material: Any, normal: float, tx: float, ty: float, tz: float) -> bool:
        """Tell whether a contact that exerted these totals slid, for reports of the step."""


LAW: ContactLaw = coulomb


class Materials(NamedTuple):
    """The coefficients of each pair of ends that may touch; see `carom.scene.matter.PairCoefficients`."""

    rows: Records  # (k,) MATERIAL
    places: IntArray  # (n + p, 2) for `material_index`; no rows where all bodies have one material


def materials_of(pairs: PairCoefficients) -> Materials:
    """Return the coefficients of each pair as records."""
    rows = np.ascontiguousarray(pairs.rows, dtype=np.float64).view(MATERIAL)[:, 0]
    return Materials(rows, pairs.places)


@unowned
def material_index(i: int, j: int, bodies: int, places: IntArray) -> int:
    """Return the row of the coefficients of ends i < j; with one material 0 between bodies, 1 + p at plane p.

    It is not inlined: references to the array would be counted, and a sweep over 5·10⁴ contacts take 20 ms, not 15.
    """
    if len(places) == 0:
        return max(0, j - bodies + 1)
    row: int = places[i, 0] + places[j, 1]
    return row


@inline
def restitution_at_depth(e: float, vn: float, overlap: float, pull: float) -> float:
    """Return the restitution coefficient of an impact found after its time; see `solver.impacts`.

    Parameters
    ----------
    e
        The coefficient at the surface.
    vn
        m/s, normal velocity where the impact was found.
    overlap
        m
    pull
        m/s², relative acceleration that presses the bodies together.
    """
    at_depth: float = np.sqrt(e * e + (1.0 - e * e) * min(1.0, 2.0 * overlap * pull / (vn * vn)))
    return at_depth


@inline
def inverse_tangent_mass(Kn: float, ri: float, rj: float, inverse_inertia_i: float, inverse_inertia_j: float) -> float:
    """Return K_t = K_n + ρ_i²/I_i + ρ_j²/I_j in 1/kg, the change of the slip by a tangential impulse of 1 N s."""
    return Kn + ri * ri * inverse_inertia_i + rj * rj * inverse_inertia_j


@inline
def normal_loss(Jn: float, vn: float, Kn: float) -> float:
    """Return the energy in J that a normal impulse takes out, given v_n before it and K_n = 1/m_i + 1/m_j."""
    return -Jn * (vn + 0.5 * Jn * Kn)


@inline
def tangential_loss(Jt: float, slip: float, Kt: float) -> float:
    """Return the energy in J that an impulse against the slip takes out, given the slip before it and K_t."""
    return Jt * (slip - 0.5 * Jt * Kt)
