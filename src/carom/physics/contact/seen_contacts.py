"""The contacts of the last step as frames, statistics and the audit see them; near pairs are left out.

A snapshot copies its contacts, so it is made when something asks for it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carom.arrays import FloatArray
from carom.physics.contact.events.drift import NO_IMPACTS, Impacts
from carom.physics.contact.graph import OrderedContacts
from carom.physics.contact.sleep.sleepers import NO_SLEEPERS, SleepingContacts
from carom.physics.contact.snapshot import EMPTY_SNAPSHOT, ContactSnapshot, late_contacts
from carom.physics.contact.solver.contact_solver import ContactSolver


class SeenContacts:
    """Makes the contact snapshot of a step.

    Parameters
    ----------
    solver
        Its records are those of the contacts found.
    inverse_mass
        (n + p,) 1/kg, of bodies and planes.
    """

    def __init__(self, solver: ContactSolver, inverse_mass: FloatArray) -> None:
        self._solver, self._inverse_mass = solver, inverse_mass
        self.forget()

    def forget(self) -> None:
        """Return to the state before the first step."""
        self._snapshot: ContactSnapshot | None = EMPTY_SNAPSHOT  # None: not made yet
        self._place = np.empty(0, dtype=np.int64)  # (m,) places of the records of its contacts, -1 for sleepers
        self._impacts = NO_IMPACTS

    def begin(self, found: OrderedContacts, slept: SleepingContacts, impacts: Impacts, dt: float) -> None:
        """Note the contacts of a step of dt s: those found at its end, those of sleepers, and impacts in its drift."""
        self._found, self._slept, self._impacts, self._dt = found, slept, impacts, dt
        self._snapshot = None

    def rest(self, found: OrderedContacts) -> None:
        """Note steps in which nothing touched, after a step in which nothing did."""
        if self._snapshot is None or self._snapshot is EMPTY_SNAPSHOT:  # that of an earlier step is empty, too
            self.begin(found, NO_SLEEPERS, NO_IMPACTS, 0.0)

    @property
    def snapshot(self) -> ContactSnapshot:
        """The contacts of the step that touch or carry an impulse."""
        if self._snapshot is None:
            self._snapshot = self._made()
        return self._snapshot

    def keep_contributions(self) -> Callable[[], FloatArray]:
        """Keep the ledger of this step; the function returns that of each contact, (m, 3) J, at any later time."""
        snapshot, place, struck = self.snapshot, self._place, self._impacts.ledger
        late = np.concatenate((self._solver.ledger, np.zeros((1, 3))))  # the last row is of sleepers
        return lambda: snapshot.sums(late[place], struck)

    def _made(self) -> ContactSnapshot:
        """Copy the contacts of the step, and note the places of their records."""
        solver, found = self._solver, self._found
        records = (found.order.place, solver.contacts, solver.states, solver.found_normals)
        late, self._place = late_contacts(found.pairs, found.colours, found.body_colours, *records)
        if len(self._slept.pairs):
            late, place = late.joined(self._slept.graph(), self._inverse_mass)
            self._place = np.append(self._place, -1)[place]
        return late.after(self._impacts, self._dt, self._inverse_mass)
