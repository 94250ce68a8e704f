"""The memory of the contact solver, which is kept from step to step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.aligned import Buffer, aligned_empty
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import (
    BLOCK_SUMS,
    BODIES_PER_BLOCK,
    BODY_STATE,
    CONTACT,
    CONTACT_STATE,
    ISLAND,
    MEASURED,
    PIECE_FINDINGS,
    PUSHED_BODY,
    RECORDED,
    ROLLING_CONTACT,
    ROLLING_RECORDED,
    SEARCH,
    ConstraintSystem,
)
from carom.physics.contact.graph import SolveOrder
from carom.physics.contact.law import Materials, has_torque
from carom.scene.start import HalfSpaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]


class Workspace:
    """Makes the constraint system of each step from arrays that it keeps.

    Parameters
    ----------
    bodies, planes
        The possible ends of a contact.
    materials
        Coefficients of the contact law.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    spin
        As in `ConstraintSystem`.
    records
        Whether to keep the impulses of impacts.
    """

    def __init__(
        self,
        bodies: Bodies,
        planes: HalfSpaces,
        materials: Materials,
        box: FloatArray,
        spin: FloatArray,
        records: bool,
    ) -> None:
        count = len(bodies.ends.velocity)
        self._ends, self._planes = bodies.ends, planes
        self._materials, self._box, self._spin, self._records = materials, box, spin, records
        rolls = has_torque(materials.rows.dtype)
        contact = ROLLING_CONTACT if rolls else CONTACT
        self._contacts = Buffer(contact), Buffer(contact)
        self._held = Buffer(np.bool_)
        self._small_change = Buffer(np.float64)
        self._states = Buffer(CONTACT_STATE)
        self._search = Buffer(SEARCH)
        self._measured = Buffer(MEASURED)
        self._recorded = Buffer(ROLLING_RECORDED if rolls else RECORDED)
        self.pressed = np.ones(count, dtype=np.bool_)
        self._bodies = aligned_empty(count, BODY_STATE)
        self._pushed = aligned_empty(count, PUSHED_BODY)
        self._pushed_in = np.empty(count, dtype=np.int64)
        self._island = np.empty(count, dtype=np.int64)
        self._islands = np.empty(count, ISLAND)

    def system(
        self, order: SolveOrder, active: IntArray, settings: Records, keep: Records | None = None
    ) -> ConstraintSystem:
        """Return the system of a step; the one before becomes invalid.

        Parameters
        ----------
        order
            The contacts, in the order in which they are solved.
        active, settings
            As in `ConstraintSystem`.
        keep
            ``contacts`` of an earlier system that must not be overwritten.
        """
        m, ends = len(order.pairs), self._ends
        contacts = self._contacts[1] if keep is not None and self._contacts[0].holds(keep) else self._contacts[0]
        recorded = self._recorded.take(m if self._records else 0)
        recorded.view(np.float64)[:] = 0.0
        return ConstraintSystem(
            pairs=order.pairs,
            pieces=order.pieces,
            edges=order.edges,
            contacts=contacts.take(m),
            held=self._held.take(m),
            small_change=self._small_change.take(m),
            states=self._states.take(m),
            search=self._search.take(m),
            measured=self._measured.take(m),
            recorded=recorded,
            velocity=ends.velocity,
            spin=self._spin,
            acceleration=ends.acceleration,
            inverse_mass=ends.inverse_mass,
            box=self._box,
            surface=self._planes.normal,
            offset=self._planes.offset,
            bodies=self._bodies,
            pushed=self._pushed,
            pushed_in=self._pushed_in,
            materials=self._materials.rows,
            places=self._materials.places,
            island=self._island,
            islands=self._islands,
            active=active,
            pressed=self.pressed,
            found=np.empty(len(order.pieces), PIECE_FINDINGS),
            sums=np.empty(-(-len(active) // BODIES_PER_BLOCK), BLOCK_SUMS),
            settings=settings,
        )
