"""The contact tap: makes the rows of `contact_table` for a run that records its contacts.

The tap only reads the solver's records, so it changes no bit of the run:

- holding after the first kick: the contacts of the step before, `see_hold`
- impacts during the drift: its log, `see_drift`
- impacts found at the end of the step, `see_impacts`, and the holding after the last kick: the solver's own records

Rows are made on demand, since few steps are frames. Only impacts are gathered in every step (`impact_store`).
`contact_rows` has the kernels.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.contact_table import CONTACT_ROW, IMPACT_MODE, NO_ROWS
from carom.physics.aligned import Buffer, columns, joined, picked, raw
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import CONTACT
from carom.physics.contact.contact_rows import NOT_HELD, Ends, Found, Held, merge, pick_impacts, write_log
from carom.physics.contact.events.drift import NO_IMPACTS, Impacts
from carom.physics.contact.impact_store import ImpactStore
from carom.physics.contact.law import IMPULSES, Materials
from carom.physics.contact.sleeping_contacts import NO_SLEEPERS, SleepingContacts
from carom.physics.contact.solver.contact_solver import ContactSolver


class Impulses(NamedTuple):
    """The impulses of contacts at one moment of a step; a pair may occur more than once."""

    pairs: IntArray  # (k, 2)
    normal: FloatArray  # (k, 3) from i to j
    arms: FloatArray  # (k, 2) m
    values: FloatArray  # (k, 4) N s, λ_n and λ_t
    time: FloatArray  # (k,) s, when
    turns: bool = True  # whether λ_t acts at the contact point; at the centres if not
    impact: BoolArray | None = None  # (k,) whether the contact closed faster than its rest speed;
    # None: they hold contacts at rest


class ContactTap:
    """Gathers the impulses and energies of the contacts of each step.

    Parameters
    ----------
    bodies
        What touches.
    materials
        Coefficients of the contact law.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    friction
        Whether friction is modelled.
    """

    def __init__(self, bodies: Bodies, materials: Materials, box: FloatArray, friction: bool) -> None:
        self._ends = Ends(bodies.position, box, materials, friction)
        self._room = Buffer(CONTACT_ROW)
        self._most = 0  # rows of a step so far; a room with fewer is enlarged before it is filled
        self.forget()
        self._compile()

    def forget(self) -> None:
        """Begin anew, as before the first step."""
        self._impacts = ImpactStore()
        self.begin(0, 0.0, 0.0)

    def begin(self, step: int, began: float, ended: float) -> None:
        """Begin a step; the times of its beginning and end in s."""
        self._step, self._began, self._ended = step, began, ended
        self._held = NOT_HELD
        self._drift = NO_IMPACTS

    def see_hold(self, pairs: IntArray, solver: ContactSolver) -> None:
        """Keep the impulses by which contacts were held after the first kick.

        Their records do not change until the next step finds its contacts. The ledger does, so it is copied.
        """
        self._held = Held(pairs, solver.order.place, solver.contacts, solver.ledger.copy())

    def see_waking(self) -> None:
        """Copy the records of the held contacts, which the solver will overwrite."""
        self._held = self._held._replace(contacts=raw(self._held.contacts).copy().view(CONTACT))

    def see_drift(self, impacts: Impacts) -> None:
        """Note the impacts during the drift."""
        self._drift = impacts
        if len(impacts):
            rows = self._rows_of_drift()
            self._impacts.add(picked(rows, np.flatnonzero(rows["mode"] == IMPACT_MODE)))

    def see_impacts(self, pairs: IntArray, solver: ContactSolver) -> None:
        """Note the impacts found at the end of the step, before contacts are held once more."""
        rows = self._room.take(len(pairs))
        position, box = self._ends.position, self._ends.box
        count = pick_impacts(_found(pairs, solver), position, box, self._step, self._ended, rows)
        if count:
            self._impacts.add(raw(rows[:count]).copy().view(CONTACT_ROW))

    def take_impacts(self) -> tuple[Records, int]:
        """Return the impacts since the last call, (k,) `CONTACT_ROW` in order of time, and how many were left out."""
        taken, self._impacts = self._impacts, ImpactStore()
        return taken.rows(), taken.left_out

    def rows(
        self, pairs: IntArray, solver: ContactSolver, room: Buffer | None = None, slept: SleepingContacts = NO_SLEEPERS
    ) -> Records:
        """Return the contact table of this step, (m,) `CONTACT_ROW`, sorted by pair; in ``room`` if given, else a copy.

        It has the contacts of the graph, and those that gave an impulse and have opened since. ``slept`` are the
        contacts of sleepers, with the forces from when they fell asleep.
        """
        struck = NO_ROWS
        if len(self._drift):
            struck = self._rows_of_drift()
            struck = picked(struck, np.lexsort((-struck["approach_speed"], struck["j"], struck["i"])))
        merged = self._held, struck, _found(pairs, solver), self._ends, self._step, self._ended
        room = Buffer(CONTACT_ROW) if room is None else room
        rows = room.whole if len(room.whole) > self._most else room.take(self._most + 1)
        count = merge(*merged, rows)
        if count >= len(rows):  # a quarter more than ever before
            rows = room.take(count + 1)
            merge(*merged, rows)
        self._most = max(self._most, count)
        return self._with_sleepers(rows[:count], slept) if len(slept.pairs) else rows[:count]

    def _with_sleepers(self, rows: Records, slept: SleepingContacts) -> Records:
        """Add the rows of sleepers."""
        found = Found(*slept.records(self._ended - self._began))
        more = np.empty(len(slept.pairs) + 1, CONTACT_ROW)
        count = merge(NOT_HELD, NO_ROWS, found, self._ends, self._step, self._ended, more)
        merged = joined((rows, more[:count]), CONTACT_ROW)
        return picked(merged, np.lexsort((merged["j"], merged["i"])))

    def impulses(self, solver: ContactSolver) -> Iterator[Impulses]:
        """Yield all impulses of the step, in the order in which they were given."""
        if len(self._held.pairs):
            contacts = self._held.contacts
            pairs = np.empty_like(self._held.pairs)
            pairs[self._held.place] = self._held.pairs
            began = np.full(len(pairs), self._began)
            yield Impulses(pairs, *_geometry(contacts), columns(contacts, IMPULSES), began)
        if len(self._drift):
            time, log = np.minimum(self._began + self._drift.time, self._ended), self._drift.log
            impact = self._drift.approach > self._drift.rest_speed
            yield Impulses(self._drift.pairs, *_geometry(log), columns(log, IMPULSES), time, impact=impact)
        if len(solver.order.pairs):
            pairs, recorded = solver.order.pairs, solver.recorded
            corrections = np.zeros((len(pairs), 4))
            corrections[:, 1:] = columns(recorded, ("correction_x", "correction_y", "correction_z"))
            geometry, ended = _geometry(solver.contacts), np.full(len(pairs), self._ended)
            impact = solver.states["approach_speed"] > solver.states["rest_speed"]
            yield Impulses(pairs, *geometry, corrections, ended, turns=False)
            yield Impulses(pairs, *geometry, columns(recorded, IMPULSES), ended, impact=impact)
            yield Impulses(pairs, *geometry, solver.impulses, ended)

    def work(self, solver: ContactSolver) -> FloatArray:
        """Return the ledger of each contact of the step, (k, 3) J."""
        return np.concatenate((self._held.terms, self._drift.ledger, solver.ledger))

    def _rows_of_drift(self) -> Records:
        rows = np.empty(len(self._drift), CONTACT_ROW)
        write_log(self._drift.log, self._ends, self._step, self._began, self._ended, rows)
        return rows

    def _compile(self) -> None:
        """Call every kernel without contacts, so that the first contact does not wait for a compiler."""
        self._rows_of_drift()


def _geometry(records: Records) -> tuple[FloatArray, FloatArray]:
    """Return normals, (k, 3), and lever arms, (k, 2) m."""
    return columns(records, ("nx", "ny", "nz")), columns(records, ("arm_i", "arm_j"))


def _found(pairs: IntArray, solver: ContactSolver) -> Found:
    return Found(pairs, solver.order.place, solver.contacts, solver.states, solver.recorded)
