"""The arrays of the constraint system, which all steps share."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.aligned import Buffer, aligned_empty
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import (
    BLOCK_SUMS,
    BODIES_PER_BLOCK,
    BODY_STATE,
    CONTACT,
    CONTACT_OF_IMAGE,
    CONTACT_ON_MOVING_WALL,
    CONTACT_ON_WALL,
    CONTACT_STATE,
    GUIDED_BODY,
    ISLAND,
    MEASURED,
    PIECE_RESULTS,
    PUSHED_BODY,
    RECORDED,
    ROLLING_CONTACT,
    ROLLING_CONTACT_OF_IMAGE,
    ROLLING_ON_MOVING_WALL,
    ROLLING_ON_WALL,
    ROLLING_RECORDED,
    SEARCH,
    ConstraintSystem,
)
from carom.physics.contact.graph import SolveOrder
from carom.physics.contact.law import Materials, has_torque
from carom.physics.contact.loads import LOAD
from carom.physics.contact.records import ContactRecord, SettingsRecord
from carom.physics.sheared_box import SHEARED_BOX
from carom.scene.start import HalfSpaces


class Workspace:
    """Makes the constraint system of each step from arrays that it reuses.

    Parameters
    ----------
    bodies, planes
        The possible ends of a contact.
    materials
        Coefficients of the contact law.
    box
        Size of the periodic box, (3,) m; zeros in open space; or the record of a sheared box.
    spin
        As in `ConstraintSystem`.
    records
        Whether to keep the impulses of impacts; the work of moving walls and of shear needs them.
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
        self._ends, self._position, self._planes = bodies.ends, bodies.position, planes
        self._materials, self._box, self._spin, self._records = materials, box, spin, records or planes.moves
        rolls = has_torque(materials.rows.dtype)
        contact = ROLLING_CONTACT if rolls else CONTACT
        if planes.curves and len(spin):
            contact = ROLLING_ON_WALL if rolls else CONTACT_ON_WALL
        if planes.rotates:
            contact = ROLLING_ON_MOVING_WALL if rolls else CONTACT_ON_MOVING_WALL
        if box.dtype == SHEARED_BOX:
            contact = ROLLING_CONTACT_OF_IMAGE if rolls else CONTACT_OF_IMAGE
            self._records = True
        self._contacts = Buffer(contact), Buffer(contact)
        self._held = Buffer(np.bool_)
        self._small_change = Buffer(np.float64)
        self._load_speed = Buffer(np.float64)
        self._states = Buffer(CONTACT_STATE)
        self._search = Buffer(SEARCH)
        self._measured = Buffer(MEASURED)
        self._recorded = Buffer(ROLLING_RECORDED if rolls else RECORDED)
        self.pressed = np.ones(count, dtype=np.bool_)
        self.loads = np.zeros(count, dtype=LOAD)
        self._bodies = aligned_empty(count, GUIDED_BODY if planes.guided else BODY_STATE)
        if planes.guided:
            for axis, along in zip(("axis_x", "axis_y", "axis_z"), planes.guided.normals.T, strict=True):
                self._bodies[axis][:] = 0.0
                self._bodies[axis][count - len(planes.owner) + planes.guided.rows] = along
        self._pushed = aligned_empty(count, PUSHED_BODY)
        self._pushed_in = np.empty(count, dtype=np.int64)
        self._island = np.empty(count, dtype=np.int64)
        self._islands = np.empty(count, ISLAND)

    def system(
        self,
        order: SolveOrder,
        active: IntArray,
        enough: FloatArray,
        settings: RecordArray[SettingsRecord],
        keep: RecordArray[ContactRecord] | None = None,
    ) -> ConstraintSystem:
        """Return the system of a step; the previous system becomes invalid.

        Parameters
        ----------
        order
            The contacts in the order of solving.
        active, enough, settings
            As in `ConstraintSystem`.
        keep
            ``contacts`` of an earlier system, not to be overwritten.
        """
        m, ends = len(order.pairs), self._ends
        contacts = self._contacts[1] if keep is not None and self._contacts[0].holds(keep) else self._contacts[0]
        recorded, load_speed = self._recorded.take(m if self._records else 0), self._load_speed.take(m)
        load_speed[:] = 0.0
        recorded.view(np.float64)[:] = 0.0
        return ConstraintSystem(
            pairs=order.pairs,
            pieces=order.pieces,
            edges=order.edges,
            contacts=contacts.take(m),
            held=self._held.take(m),
            enough=enough,
            small_change=self._small_change.take(m),
            states=self._states.take(m),
            load_speed=load_speed,
            search=self._search.take(m),
            measured=self._measured.take(m),
            recorded=recorded,
            velocity=ends.velocity,
            spin=self._spin,
            acceleration=ends.acceleration,
            inverse_mass=ends.inverse_mass,
            box=self._box,
            position=self._position,
            surface=self._planes.surface[: len(self._planes.owner)],  # surfaces without the trees over facets
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
            loads=self.loads,
            piece_results=np.empty(len(order.pieces), PIECE_RESULTS),
            sums=np.empty(-(-len(active) // BODIES_PER_BLOCK), BLOCK_SUMS),
            settings=settings,
        )
