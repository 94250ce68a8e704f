"""The contacts of bodies that sleep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.physics.contact.constraint_graph import CollisionGraph, empty_graph
from carom.physics.contact.constraints import CONTACT, CONTACT_STATE, RECORDED
from carom.physics.contact.snapshot import late_contacts
from carom.physics.contact.solver.warm_start import impulses_of
from carom.physics.contact.statistics import NO_CONTACTS, ContactStatistics


@dataclass(frozen=True, slots=True)
class SleepingContacts:
    """The contacts between sleepers, and of sleepers with fixed ends; sorted by pair and never written to."""

    pairs: IntArray  # (k, 2)
    force: FloatArray  # (k, 4) N, the normal and the tangential force
    contacts: Records  # (k,) CONTACT, with the impulses of one second
    states: Records  # (k,) CONTACT_STATE
    normals: FloatArray  # (k, 3)
    statistics: ContactStatistics

    @property
    def place(self) -> IntArray:
        """(k,) index of each one's record."""
        return np.arange(len(self.pairs))

    def graph(self) -> CollisionGraph:
        """Return the contacts that touch or carry a force."""
        colours = np.zeros(len(self.pairs), dtype=np.int64)
        found = self.pairs, colours, None, self.place, self.contacts, self.states, self.normals
        return late_contacts(*found)[0].graph

    def records(self, dt: float) -> tuple[IntArray, IntArray, Records, Records, Records]:
        """Return pairs, places, `CONTACT` with the impulses of dt s, `CONTACT_STATE` and `RECORDED`."""
        contacts = self.contacts.copy()
        impulses_of(contacts)[:] = dt * self.force
        return self.pairs, self.place, contacts, self.states, np.zeros(len(self.pairs), RECORDED)


NO_SLEEPERS = SleepingContacts(
    empty_graph().pairs,
    np.empty((0, 4)),
    np.empty(0, CONTACT),
    np.empty(0, CONTACT_STATE),
    np.empty((0, 3)),
    NO_CONTACTS,
)
