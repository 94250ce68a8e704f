"""The contact tap: makes the rows of `contact_table` for a run that records its contacts.

The tap only reads the solver's records, so it changes no bit of the run:

- holding after the first kick: the contacts of the step before, `see_hold`
- impacts during the drift: its log, `see_drift`
- impacts found at the end of the step, `see_impacts`, and the holding after the last kick: the solver's own records

Rows are made on demand, since few steps are frames. Only impacts are gathered in every step, in bounded memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.contact_table import CONTACT_ROW, IMPACT_MODE, NO_ROWS, OPEN, RESTING, SLIDING, STICKING
from carom.physics.aligned import Buffer, columns, joined, picked, raw
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import CONTACT
from carom.physics.contact.events.drift import NO_IMPACTS, Impacts
from carom.physics.contact.graph import comes_before, empty_graph
from carom.physics.contact.law import IMPULSES, Materials, material_index, slides
from carom.physics.contact.rolling import angular_impulses_of
from carom.physics.contact.sleep.sleepers import NO_SLEEPERS, SleepingContacts
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.diagnostics.ledger import FRICTION, RESTITUTION, STABILISATION
from carom.physics.jit.decorators import inline, kernel, long_kernel
from carom.physics.vector import nearest_image

MOST_IMPACTS = 100_000  # kept between two frames, 15 MB; beyond that the largest are kept and the others counted


class ImpactStore:
    """The impacts since the last frame, in bounded memory."""

    def __init__(self) -> None:
        self.left_out = 0
        self._count = 0
        self._parts: list[Records] = []

    def add(self, rows: Records) -> None:
        """Add impacts, all of them later than those before."""
        self._parts.append(rows)
        self._count += len(rows)
        if self._count > 2 * MOST_IMPACTS:
            self._leave_out()

    def rows(self) -> Records:
        """Return the impacts in order of time, at most `MOST_IMPACTS`."""
        if self._count > MOST_IMPACTS:
            self._leave_out()
        if len(self._parts) > 1:
            return joined(self._parts, CONTACT_ROW)
        return self._parts[0] if self._parts else NO_ROWS

    def _leave_out(self) -> None:
        """Keep those with the largest normal impulses; of equal ones the first."""
        rows = joined(self._parts, CONTACT_ROW)
        kept = np.sort(np.argsort(-rows["normal_impulse"], kind="stable")[:MOST_IMPACTS])
        self.left_out += len(rows) - len(kept)
        self._parts, self._count = [picked(rows, kept)], len(kept)


NO_ANGULAR_IMPULSES: FloatArray = np.empty((0, 0))


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
    angular: FloatArray = NO_ANGULAR_IMPULSES  # (k, 3) N m s, Λ, if the law resists rolling


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
        self._held = self._held._replace(contacts=raw(self._held.contacts).copy().view(self._held.contacts.dtype))

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
            angular = angular_impulses_of(contacts)
            yield Impulses(pairs, *_geometry(contacts), columns(contacts, IMPULSES), began, angular=angular)
        if len(self._drift):
            time, log = np.minimum(self._began + self._drift.time, self._ended), self._drift.log
            impact = self._drift.approach > self._drift.rest_speed
            given, angular = columns(log, IMPULSES), angular_impulses_of(log)
            yield Impulses(self._drift.pairs, *_geometry(log), given, time, impact=impact, angular=angular)
        if len(solver.order.pairs):
            pairs, recorded = solver.order.pairs, solver.recorded
            corrections = np.zeros((len(pairs), 4))
            corrections[:, 1:] = columns(recorded, ("correction_x", "correction_y", "correction_z"))
            geometry, ended = _geometry(solver.contacts), np.full(len(pairs), self._ended)
            impact = solver.states["approach_speed"] > solver.states["rest_speed"]
            yield Impulses(pairs, *geometry, corrections, ended, turns=False)
            given, angular = columns(recorded, IMPULSES), angular_impulses_of(recorded)
            yield Impulses(pairs, *geometry, given, ended, impact=impact, angular=angular)
            yield Impulses(pairs, *geometry, solver.impulses, ended, angular=angular_impulses_of(solver.contacts))

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


class Ends(NamedTuple):
    """The data of bodies and materials from which rows are computed."""

    position: FloatArray  # (n, 3) m
    box: FloatArray  # (3,) m, zeros in open space
    materials: Materials
    friction: bool


class Held(NamedTuple):
    """Contacts as they were held after the first kick."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) where the record of each stands
    contacts: Records  # (m,) CONTACT
    terms: FloatArray  # (m, 3) J, by place


class Found(NamedTuple):
    """Contacts that were found at the end of the step."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) where the records of each stand
    contacts: Records  # (m,) CONTACT
    states: Records  # (m,) CONTACT_STATE
    recorded: Records  # (m,) RECORDED


NOT_HELD = Held(empty_graph().pairs, np.empty(0, dtype=np.int64), np.empty(0, CONTACT), np.empty((0, 3)))


# The kernels below take arrays out of their tuples once. Passing a tuple to an inlined function counts references to
# all its arrays, which costs 400 ns a row.


@long_kernel
def pick_impacts(found: Found, position: FloatArray, box: FloatArray, step: int, ended: float, rows: Records) -> int:
    """Write the contacts that closed faster than their rest speed and were resolved; return how many."""
    pairs, place, contacts, states, recorded = found.pairs, found.place, found.contacts, found.states, found.recorded
    count = 0
    for k in range(len(pairs)):
        c = place[k]
        state, given = states[c], recorded[c]
        if given.normal_impulse > 0.0 and state.approach_speed > state.rest_speed:
            row = rows[count]
            _begin(row, step, ended, pairs[k, 0], pairs[k, 1])
            _place(row, contacts[c], position, box)
            _add(row, given)
            _add_losses(row, state.restitution_loss, state.friction_loss, state.stabilisation_gain)
            row.approach_speed, row.mode = state.approach_speed, IMPACT_MODE
            count += 1
    return count


@long_kernel
def merge(held: Held, struck: Records, found: Found, ends: Ends, step: int, ended: float, rows: Records) -> int:
    """Write one row for each pair that was held, met in the drift, touches or gave an impulse; return how many.

    ``struck`` are rows of impacts during the drift, sorted by pair, the hardest of each pair first. Rows that do not
    fit are counted, and overwrite the last one.
    """
    held_pairs, held_place, held_contacts, terms = held.pairs, held.place, held.contacts, held.terms
    pairs, place, contacts, states, recorded = found.pairs, found.place, found.contacts, found.states, found.recorded
    position, box, friction, n = ends.position, ends.box, ends.friction, len(ends.position)
    materials, places = ends.materials.rows, ends.materials.places
    a, b, c, count = 0, 0, 0, 0
    while a < len(held_pairs) or b < len(struck) or c < len(pairs):
        i, j = n, 0  # the first pair of the three lists
        if a < len(held_pairs):
            i, j = held_pairs[a, 0], held_pairs[a, 1]
        if b < len(struck) and comes_before(struck[b].i, struck[b].j, i, j):
            i, j = struck[b].i, struck[b].j
        if c < len(pairs) and comes_before(pairs[c, 0], pairs[c, 1], i, j):
            i, j = pairs[c, 0], pairs[c, 1]
        row, seen = rows[min(count, len(rows) - 1)], False
        material = materials[material_index(i, j, n, places)]
        _begin(row, step, ended, i, j)
        touches = c < len(pairs) and pairs[c, 0] == i and pairs[c, 1] == j
        if a < len(held_pairs) and held_pairs[a, 0] == i and held_pairs[a, 1] == j:
            k = held_place[a]
            _add(row, held_contacts[k])
            _add_losses(row, terms[k, RESTITUTION], terms[k, FRICTION], terms[k, STABILISATION])
            row.mode = _mode(held_contacts[k], material, friction)
            if not touches:
                _place(row, held_contacts[k], position, box)
            a += 1
        if b < len(struck) and struck[b].i == i and struck[b].j == j:
            _copy_moment(row, struck[b])
            while b < len(struck) and struck[b].i == i and struck[b].j == j:
                _add(row, struck[b])
                _add_losses(row, struck[b].restitution_loss, struck[b].friction_loss, struck[b].stabilisation_gain)
                b += 1
        if touches:
            k = place[c]
            contact, state, given = contacts[k], states[k], recorded[k]
            row.time = ended
            _place(row, contact, position, box)
            _add(row, given)
            _add(row, contact)
            _add_losses(row, state.restitution_loss, state.friction_loss, state.stabilisation_gain)
            row.approach_speed = max(row.approach_speed, state.approach_speed)
            if given.normal_impulse > 0.0 and state.approach_speed > state.rest_speed:
                row.mode = IMPACT_MODE
            elif row.mode != IMPACT_MODE and contact.normal_impulse > 0.0:
                row.mode = _mode(contact, material, friction)
            elif row.mode != IMPACT_MODE and given.normal_impulse > 0.0:
                row.mode = _mode(given, material, friction)
            seen = not state.apart
            c += 1
        if seen or row.normal_impulse > 0.0 or row.stabilisation_gain != 0.0:
            count += 1
    return count


@kernel
def write_log(log: Records, ends: Ends, step: int, began: float, ended: float, rows: Records) -> None:
    """Write a row for each impact during the drift, in order of time."""
    box, friction, n = ends.box, ends.friction, len(ends.position)
    materials, places = ends.materials.rows, ends.materials.places
    for k in range(len(log)):
        entry, row = log[k], rows[k]
        _begin(row, step, min(began + entry.time, ended), entry.i, entry.j)
        row.nx, row.ny, row.nz = entry.nx, entry.ny, entry.nz
        row.x, row.y, row.z = entry.x, entry.y, entry.z
        if box[0] > 0.0:
            row.x, row.y, row.z = nearest_image(entry.x, entry.y, entry.z, box[0], box[1], box[2])
        _add(row, entry)
        _add_losses(row, entry.restitution_loss, entry.friction_loss, entry.stabilisation_gain)
        row.approach_speed = entry.approach
        material = materials[material_index(entry.i, entry.j, n, places)]
        row.mode = IMPACT_MODE if entry.approach > entry.rest_speed else _mode(entry, material, friction)


@inline
def _begin(row: Any, step: int, time: float, i: int, j: int) -> None:
    """Begin the row of a contact, without an impulse."""
    row.step, row.time, row.i, row.j, row.mode = step, time, i, j, OPEN
    row.approach_speed = row.normal_impulse = row.friction_x = row.friction_y = row.friction_z = 0.0
    row.restitution_loss = row.friction_loss = row.stabilisation_gain = 0.0


@inline
def _copy_moment(row: Any, impact: Any) -> None:
    """Take over when, where and how fast a pair met."""
    row.time, row.mode, row.approach_speed = impact.time, impact.mode, impact.approach_speed
    row.nx, row.ny, row.nz = impact.nx, impact.ny, impact.nz
    row.x, row.y, row.z = impact.x, impact.y, impact.z


@inline
def _mode(given: Any, material: Any, friction: bool) -> int:
    """Return the mode of a contact that was not an impact."""
    if not given.normal_impulse > 0.0:
        return OPEN
    if not friction:
        return RESTING
    tx, ty, tz = given.friction_x, given.friction_y, given.friction_z
    return SLIDING if slides(material, given.normal_impulse, tx, ty, tz) else STICKING


@inline
def _place(row: Any, contact: Any, position: FloatArray, box: FloatArray) -> None:
    """Write the normal and the contact point."""
    i, arm = row.i, contact.arm_i
    nx, ny, nz = contact.nx, contact.ny, contact.nz
    row.nx, row.ny, row.nz = nx, ny, nz
    row.x, row.y, row.z = position[i, 0] + arm * nx, position[i, 1] + arm * ny, position[i, 2] + arm * nz
    if box[0] > 0.0:
        row.x, row.y, row.z = nearest_image(row.x, row.y, row.z, box[0], box[1], box[2])


@inline
def _add(row: Any, given: Any) -> None:
    """Add an impulse."""
    row.normal_impulse += given.normal_impulse
    row.friction_x += given.friction_x
    row.friction_y += given.friction_y
    row.friction_z += given.friction_z


@inline
def _add_losses(row: Any, restitution: float, friction: float, stabilisation: float) -> None:
    row.restitution_loss += restitution
    row.friction_loss += friction
    row.stabilisation_gain += stabilisation
