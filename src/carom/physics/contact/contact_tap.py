"""The contact tap: makes the rows of the `contact_table` for a run that records its contacts.

The tap only reads the solver's records, so it does not change the run:

- contacts of the previous step that are held after the first kick: `held`
- impacts during the drift: `struck`, from their log
- impacts at the end of the step: `after_impacts`; contacts held after the last kick: read from the solver's records

Rows are made on demand, since few steps are frames. Only impacts are stored at every step, in bounded memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray, Records
from carom.contact_table import (
    CONTACT_ROW,
    IMPACT_MODE,
    NO_ANGULAR_IMPULSES,
    NO_ROWS,
    OPEN,
    RESTING,
    SLIDING,
    STICKING,
    ContactRow,
)
from carom.physics.aligned import Buffer, columns, joined, picked, raw
from carom.physics.contact.constraints import CONTACT
from carom.physics.contact.graph import comes_before
from carom.physics.contact.hooks import OptionalPart, PresentStep
from carom.physics.contact.impact_log import NO_IMPACTS
from carom.physics.contact.law import IMPULSES, Materials, material_index, slides
from carom.physics.contact.records import (
    ContactGeometry,
    ContactRecord,
    ContactStateRecord,
    HasImpulse,
    ImpactRecord,
    ImpulseRecord,
)
from carom.physics.contact.rolling import angular_impulse, angular_impulses_of
from carom.physics.diagnostics.ledger import FRICTION, RESTITUTION, STABILISATION
from carom.physics.jit.decorators import inline, kernel, long_kernel
from carom.physics.sheared_box import nearest_in_drift
from carom.scene.schema import Coefficients
from carom.state.frame import empty_graph

if TYPE_CHECKING:
    from carom.physics.contact.pipeline import ContactPipeline

# largest number of impacts stored between two frames, 15 MB; beyond it, the hardest are kept, and all are counted
MOST_IMPACTS = 100_000


class Impulses(NamedTuple):
    """The impulses of contacts at one moment of a step; a pair may occur more than once."""

    pairs: IntArray  # (k, 2)
    normal: FloatArray  # (k, 3) normals from i to j
    arms: FloatArray  # (k, 2) m
    values: FloatArray  # (k, 4) N s, λ_n and λ_t
    time: FloatArray  # (k,) s, time of each impulse
    turns: bool = True  # whether λ_t acts at the contact point; otherwise at both centres
    # (k,) whether the contact closed faster than its rest speed; None means that all contacts were held
    impact: BoolArray | None = None
    # (k,) m/s, closing speed before the impulses; None means that all contacts were held
    approach: FloatArray | None = None
    angular: FloatArray = NO_ANGULAR_IMPULSES  # (k, 3) N m s, Λ if the law resists rolling
    ordered: bool = False  # whether impulses acted one by one; otherwise all impulses of a moment acted together


class RowData(NamedTuple):
    """The data of bodies and materials from which the rows are computed."""

    position: FloatArray  # (n, 3) m
    box: FloatArray  # as in `ConstraintSystem`
    materials: Materials
    friction: bool


class Held(NamedTuple):
    """The contacts that are held after the first kick."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) index of each contact's record
    contacts: RecordArray[ContactRecord]  # (m,) CONTACT
    terms: FloatArray  # (m, 3) J, losses of each record by entry of the ledger


class Resolved(NamedTuple):
    """Contacts that were resolved at the end of the step."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) index of each contact's records
    contacts: RecordArray[ContactRecord]  # (m,) CONTACT
    states: RecordArray[ContactStateRecord]  # (m,) CONTACT_STATE
    recorded: RecordArray[ImpulseRecord]  # (m,) RECORDED


NOTHING_HELD = Held(empty_graph().pairs, np.empty(0, dtype=np.int64), np.empty(0, CONTACT), np.empty((0, 3)))


class ContactTap(OptionalPart):
    """Collects the impulses and energies of the contacts of each step."""

    needs_every_step = False

    def __init__(self, contacts: ContactPipeline) -> None:
        assert contacts.totals is not None, "contacts are recorded"
        self._contacts, self._totals = contacts, contacts.totals
        friction, world = contacts.needs.friction.modelled, contacts.world
        self._data = RowData(contacts.bodies.position, world.solver_box, world.materials, friction)
        self._buffer = Buffer(CONTACT_ROW)
        self._largest_count = 0  # largest number of rows of a step so far; smaller buffers are enlarged
        self.forget()

    def compile(self) -> None:
        """Run the hooks' kernels once without contacts, to load them."""
        self._rows_of_drift()
        self.rows()

    def forget(self) -> None:
        """Return to the state before the first step."""
        self._impacts = ImpactStore()
        self._totals.forget()
        self.begin(0, 0.0, 0.0)

    def begin(self, step: int, began: float, ended: float) -> None:
        """Begin a step, given the times of its beginning and end in s."""
        self._step, self._began, self._ended = step, began, ended
        self._held = NOTHING_HELD
        self._drift = NO_IMPACTS

    def prepare(self, step: PresentStep) -> None:
        """Clear the entries of held contacts: they belong to the previous step, which is already booked."""
        if self._contacts.is_at_rest:
            self._contacts.solver.ledger[:] = 0.0

    def held(self, step: PresentStep) -> None:
        """Store the impulses that held contacts after the first kick.

        The records do not change until the next step finds its contacts, but their energy losses do, so the losses are
        copied.
        """
        solver = self._contacts.solver
        self._held = Held(self._contacts.contacts.pairs, solver.order.place, solver.contacts, solver.ledger.copy())

    def restarted(self) -> None:
        """Copy the records of the held contacts before the solver overwrites them."""
        self._held = self._held._replace(contacts=raw(self._held.contacts).copy().view(self._held.contacts.dtype))

    def struck(self, step: PresentStep) -> None:
        """Add the impacts during the drift."""
        self._drift = self._contacts.impacts
        rows = self._rows_of_drift()
        self._store(picked(rows, np.flatnonzero(rows["mode"] == IMPACT_MODE)))

    def after_impacts(self, step: PresentStep) -> None:
        """Add the impacts at the end of the step, before contacts are held again."""
        resolved = _resolved(self._contacts)
        rows = self._buffer.take(len(resolved.pairs))
        position, box = self._data.position, self._data.box
        count = _write_impacts(resolved, position, box, self._step, self._ended, rows)
        if count:
            self._store(raw(rows[:count]).copy().view(CONTACT_ROW))

    def pop_impacts(self) -> tuple[Records, int, FloatArray]:
        """Return the impacts since the last call, (k,) `CONTACT_ROW` in order of time, and how many were omitted.

        The third value is `ImpactSums.flat` of all impacts, stored or omitted.
        """
        store, self._impacts = self._impacts, ImpactStore()
        return store.rows(), store.left_out, self._totals.pop()

    def rows(self, buffer: Buffer | None = None) -> Records:
        """Return the contact table of this step, (m,) `CONTACT_ROW`, sorted by pair, in the buffer if it is given.

        The table contains the contacts of the graph, contacts that exerted an impulse and have opened since, and idle
        contacts with their last forces from the solver.
        """
        impacts, idle = NO_ROWS, self._contacts.idle
        if len(self._drift):
            impacts = self._rows_of_drift()
            impacts = picked(impacts, np.lexsort((-impacts["approach_speed"], impacts["j"], impacts["i"])))
        merged = self._held, impacts, _resolved(self._contacts), self._data, self._step, self._ended
        buffer = Buffer(CONTACT_ROW) if buffer is None else buffer
        rows = buffer.whole if len(buffer.whole) > self._largest_count else buffer.take(self._largest_count + 1)
        count = _merge(*merged, rows)
        if count >= len(rows):  # the buffer has only as many rows as earlier steps needed
            rows = buffer.take(count + 1)
            _merge(*merged, rows)
        self._largest_count = max(self._largest_count, count)
        if not idle:
            return rows[:count]
        resting, more = Resolved(*idle.records(self._ended - self._began)), np.empty(len(idle) + 1, CONTACT_ROW)
        added = _merge(NOTHING_HELD, NO_ROWS, resting, self._data, self._step, self._ended, more)
        table = joined((rows[:count], more[:added]), CONTACT_ROW)
        return picked(table, np.lexsort((table["j"], table["i"])))

    def impulses(self) -> Iterator[Impulses]:
        """Yield all impulses of the step, in the order in which they acted."""
        solver = self._contacts.solver
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
            yield Impulses(
                self._drift.pairs,
                *_geometry(log),
                given,
                time,
                impact=impact,
                approach=self._drift.approach,
                angular=angular,
                ordered=True,
            )
        if len(solver.order.pairs):
            pairs, recorded = solver.order.pairs, solver.recorded
            corrections = np.zeros((len(pairs), 4))
            corrections[:, 1:] = columns(recorded, ("correction_x", "correction_y", "correction_z"))
            geometry, ended = _geometry(solver.contacts), np.full(len(pairs), self._ended)
            approach = solver.states["approach_speed"]
            impact = approach > solver.states["rest_speed"]
            yield Impulses(pairs, *geometry, corrections, ended, turns=False)
            given, angular = columns(recorded, IMPULSES), angular_impulses_of(recorded)
            yield Impulses(pairs, *geometry, given, ended, impact=impact, approach=approach, angular=angular)
            yield Impulses(pairs, *geometry, solver.impulses, ended, angular=angular_impulses_of(solver.contacts))

    def work(self) -> FloatArray:
        """Return the energy losses of each contact of the step by entry of the ledger, (k, 3) J."""
        return np.concatenate((self._held.terms, self._drift.ledger, self._contacts.solver.ledger))

    def _store(self, impacts: Records) -> None:
        self._impacts.add(impacts)
        self._totals.add(impacts)

    def _rows_of_drift(self) -> Records:
        rows = np.empty(len(self._drift), CONTACT_ROW)
        _write_log(self._drift.log, self._data, self._step, self._began, self._ended, rows)
        return rows


def _geometry(records: RecordArray[object]) -> tuple[FloatArray, FloatArray]:
    """Return normals, (k, 3), and lever arms, (k, 2) m."""
    return columns(records, ("nx", "ny", "nz")), columns(records, ("arm_i", "arm_j"))


def _resolved(contacts: ContactPipeline) -> Resolved:
    solver = contacts.solver
    return Resolved(contacts.contacts.pairs, solver.order.place, solver.contacts, solver.states, solver.recorded)


class ImpactStore:
    """The impacts since the last frame, in bounded memory."""

    def __init__(self) -> None:
        self.left_out = 0
        self._count = 0
        self._pieces: list[Records] = []

    def add(self, rows: Records) -> None:
        """Add impacts, all later than the stored ones."""
        self._pieces.append(rows)
        self._count += len(rows)
        if self._count > 2 * MOST_IMPACTS:
            self._leave_out()

    def rows(self) -> Records:
        """Return the impacts in order of time, at most `MOST_IMPACTS`."""
        if self._count > MOST_IMPACTS:
            self._leave_out()
        if len(self._pieces) < 2:  # joining the pieces takes 7 of the 60 µs for a frame with few bodies
            return self._pieces[0] if self._pieces else NO_ROWS
        return joined(self._pieces, CONTACT_ROW)

    def _leave_out(self) -> None:
        """Keep the impacts with the largest normal impulses; of equal impulses, keep the first."""
        rows = joined(self._pieces, CONTACT_ROW)
        kept = np.sort(np.argsort(-rows["normal_impulse"], kind="stable")[:MOST_IMPACTS])
        self.left_out += len(rows) - len(kept)
        self._pieces, self._count = [picked(rows, kept)], len(kept)


# The kernels below unpack their tuples once: to pass a tuple to an inlined function, Numba counts references to all
# arrays in the tuple, which takes 400 ns per row.


@long_kernel
def _write_impacts(
    resolved: Resolved, position: FloatArray, box: FloatArray, step: int, ended: float, rows: RecordArray[ContactRow]
) -> int:
    """Write the contacts that closed faster than their rest speed and were resolved; return their number."""
    pairs, place, contacts, states, recorded = resolved
    count = 0
    for k in range(len(pairs)):
        c = place[k]
        state, impulse = states[c], recorded[c]
        if impulse.normal_impulse > 0.0 and state.approach_speed > state.rest_speed:
            row = rows[count]
            _begin(row, step, ended, pairs[k, 0], pairs[k, 1])
            _place(row, contacts[c], position, box)
            _add(row, impulse)
            _add_losses(row, state.restitution_loss, state.friction_loss, state.stabilisation_gain)
            row.approach_speed, row.mode = state.approach_speed, IMPACT_MODE
            count += 1
    return count


@long_kernel
def _merge(
    held: Held,
    impacts: RecordArray[ContactRow],
    resolved: Resolved,
    data: RowData,
    step: int,
    ended: float,
    rows: RecordArray[ContactRow],
) -> int:
    """Write a row for each pair that was held, met in the drift, touches or exerted an impulse; return the row count.

    ``impacts`` are rows of impacts during the drift, sorted by pair, with the hardest impact of each pair first. Rows
    that do not fit are counted, and overwrite the last row.
    """
    held_pairs, held_place, held_contacts, terms = held
    pairs, place, contacts, states, recorded = resolved
    position, box, friction, n = data.position, data.box, data.friction, len(data.position)
    materials, places = data.materials.rows, data.materials.places
    a, b, c, count = 0, 0, 0, 0
    while a < len(held_pairs) or b < len(impacts) or c < len(pairs):
        i, j = n, 0  # the first pair, by order, of the three lists
        if a < len(held_pairs):
            i, j = held_pairs[a, 0], held_pairs[a, 1]
        if b < len(impacts) and comes_before(impacts[b].i, impacts[b].j, i, j):
            i, j = impacts[b].i, impacts[b].j
        if c < len(pairs) and comes_before(pairs[c, 0], pairs[c, 1], i, j):
            i, j = pairs[c, 0], pairs[c, 1]
        row, is_listed = rows[min(count, len(rows) - 1)], False
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
        if b < len(impacts) and impacts[b].i == i and impacts[b].j == j:
            hardest = impacts[b]
            row.time, row.mode, row.approach_speed = hardest.time, hardest.mode, hardest.approach_speed
            row.nx, row.ny, row.nz = hardest.nx, hardest.ny, hardest.nz
            row.arm_i, row.arm_j = hardest.arm_i, hardest.arm_j
            row.x, row.y, row.z = hardest.x, hardest.y, hardest.z
            while b < len(impacts) and impacts[b].i == i and impacts[b].j == j:
                _add(row, impacts[b])
                _add_losses(row, impacts[b].restitution_loss, impacts[b].friction_loss, impacts[b].stabilisation_gain)
                b += 1
        if touches:
            k = place[c]
            contact, state, impulse = contacts[k], states[k], recorded[k]
            row.time = ended
            _place(row, contact, position, box)
            _add(row, impulse)
            _add(row, contact)
            _add_losses(row, state.restitution_loss, state.friction_loss, state.stabilisation_gain)
            row.approach_speed = max(row.approach_speed, state.approach_speed)
            if impulse.normal_impulse > 0.0 and state.approach_speed > state.rest_speed:
                row.mode = IMPACT_MODE
            elif row.mode != IMPACT_MODE and contact.normal_impulse > 0.0:
                row.mode = _mode(contact, material, friction)
            elif row.mode != IMPACT_MODE and impulse.normal_impulse > 0.0:
                row.mode = _mode(impulse, material, friction)
            is_listed = not state.apart
            c += 1
        if is_listed or row.normal_impulse > 0.0 or row.stabilisation_gain != 0.0:
            count += 1
    return count


@kernel
def _write_log(
    log: RecordArray[ImpactRecord], data: RowData, step: int, began: float, ended: float, rows: RecordArray[ContactRow]
) -> None:
    """Write a row for each impact during the drift, in order of time."""
    box, friction, n = data.box, data.friction, len(data.position)
    materials, places = data.materials.rows, data.materials.places
    for k in range(len(log)):
        entry, row = log[k], rows[k]
        _begin(row, step, min(began + entry.time, ended), entry.i, entry.j)
        row.nx, row.ny, row.nz = entry.nx, entry.ny, entry.nz
        row.arm_i, row.arm_j = entry.arm_i, entry.arm_j
        row.x, row.y, row.z = nearest_in_drift(entry.x, entry.y, entry.z, box, 0.0)
        _add(row, entry)
        _add_losses(row, entry.restitution_loss, entry.friction_loss, entry.stabilisation_gain)
        row.approach_speed = entry.approach
        material = materials[material_index(entry.i, entry.j, n, places)]
        row.mode = IMPACT_MODE if entry.approach > entry.rest_speed else _mode(entry, material, friction)


@inline
def _begin(row: ContactRow, step: int, time: float, i: int, j: int) -> None:
    """Begin the row of a contact, without an impulse."""
    row.step, row.time, row.i, row.j, row.mode = step, time, i, j, OPEN
    row.approach_speed = row.normal_impulse = row.friction_x = row.friction_y = row.friction_z = 0.0
    row.angular_x = row.angular_y = row.angular_z = 0.0
    row.restitution_loss = row.friction_loss = row.stabilisation_gain = 0.0


@inline
def _mode(impulse: HasImpulse, material: Coefficients, friction: bool) -> int:
    """Return the mode of a contact that was not an impact."""
    if not impulse.normal_impulse > 0.0:
        return OPEN
    if not friction:
        return RESTING
    tx, ty, tz = impulse.friction_x, impulse.friction_y, impulse.friction_z
    return SLIDING if slides(material, impulse.normal_impulse, tx, ty, tz) else STICKING


@inline
def _place(row: ContactRow, contact: ContactGeometry, position: FloatArray, box: FloatArray) -> None:
    """Write the normal, the arms and the contact point."""
    i, arm = row.i, contact.arm_i
    row.arm_i, row.arm_j = arm, contact.arm_j
    nx, ny, nz = contact.nx, contact.ny, contact.nz
    row.nx, row.ny, row.nz = nx, ny, nz
    x, y, z = position[i, 0] + arm * nx, position[i, 1] + arm * ny, position[i, 2] + arm * nz
    row.x, row.y, row.z = nearest_in_drift(x, y, z, box, 0.0)


@inline
def _add(row: ContactRow, impulse: HasImpulse) -> None:
    """Add an impulse."""
    row.normal_impulse += impulse.normal_impulse
    row.friction_x += impulse.friction_x
    row.friction_y += impulse.friction_y
    row.friction_z += impulse.friction_z
    x, y, z = angular_impulse(impulse)
    row.angular_x += x
    row.angular_y += y
    row.angular_z += z


@inline
def _add_losses(row: ContactRow, restitution: float, friction: float, stabilisation: float) -> None:
    row.restitution_loss += restitution
    row.friction_loss += friction
    row.stabilisation_gain += stabilisation
