"""The contact tap: what each contact of a step did, in rows of `contact_table`, for a run that records its contacts.

The tap reads what the solver leaves behind, and changes no bit of the run:

- holding after the first kick: the contacts of the step before, `see_hold`
- impacts on the way: the log of the drift, `see_drift`
- impacts found at the end of the step, `see_impacts`, and the holding after the last kick: the solver's own records

Rows are made on demand, since few steps are frames. Only impacts are gathered in every step, up to `MOST_IMPACTS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.aligned import Room, columns
from carom.physics.bodies import Bodies
from carom.physics.contact.constraint_graph import empty_graph
from carom.physics.contact.constraints import CONTACT
from carom.physics.contact.contact_table import CONTACT_ROW, IMPACT_MODE, OPEN, RESTING, SLIDING, STICKING
from carom.physics.contact.continuous.drift import NO_IMPACTS, Impacts
from carom.physics.contact.law import IMPULSES, LAW, material_index
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.diagnostics.ledger import TERMS
from carom.physics.parallel.jit import inline, kernel, long_kernel
from carom.physics.periodic_box import minimum_image

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

MOST_IMPACTS = 100_000  # that are kept between two frames, 15 MB; of more the largest, and a count of the others
_SUMS = ("normal_impulse", "friction_x", "friction_y", "friction_z", *TERMS)


class Impulses(NamedTuple):
    """What contacts gave to their ends at one moment of a step; each pair stands there once or more."""

    pairs: IntArray  # (k, 2)
    normal: FloatArray  # (k, 3) from i to j
    arms: FloatArray  # (k, 2) m
    values: FloatArray  # (k, 4) N s, λ_n and λ_t
    turns: bool = True  # whether λ_t acts at the contact point; at the centres if not


class _Ends(NamedTuple):
    """What contacts have at their ends."""

    position: FloatArray  # (n, 3) m
    box: FloatArray  # (3,) m, zeros in open space
    materials: Records  # (1 + p,) MATERIAL
    friction: bool


class _Held(NamedTuple):
    """Contacts as they were held after the first kick."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) where the record of each stands
    contacts: Records  # (m,) CONTACT
    terms: FloatArray  # (m, 3) J, by place


class _Found(NamedTuple):
    """Contacts that were found at the end of the step."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) where the records of each stand
    contacts: Records  # (m,) CONTACT
    states: Records  # (m,) CONTACT_STATE
    recorded: Records  # (m,) RECORDED


_NOT_HELD = _Held(empty_graph().pairs, np.empty(0, dtype=np.int64), np.empty(0, CONTACT), np.empty((0, 3)))


class ContactTap:
    """Gathers what the contacts of each step did.

    Parameters
    ----------
    bodies
        What touches.
    materials
        (1 + p,) `MATERIAL`: between bodies, then of each plane.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    friction
        Whether friction is modelled.
    """

    def __init__(self, bodies: Bodies, materials: Records, box: FloatArray, friction: bool) -> None:
        self._ends = _Ends(bodies.position, box, materials, friction)
        self._picked = Room(CONTACT_ROW)
        self.forget()
        self._compile()

    def forget(self) -> None:
        """Begin anew, as before the first step."""
        self._impacts = ImpactStore()
        self.begin(0, 0.0, 0.0)

    def begin(self, step: int, began: float, ended: float) -> None:
        """Begin a step; the times of its beginning and end in s."""
        self._step, self._began, self._ended = step, began, ended
        self._held = _NOT_HELD
        self._drift = NO_IMPACTS

    def see_hold(self, pairs: IntArray, solver: ContactSolver) -> None:
        """Note what the contacts were held by after the first kick.

        Their records stay as they are until the next step finds its contacts; the ledger does not.
        """
        self._held = _Held(pairs, solver.order.place, solver.contacts, solver.ledger.copy())

    def see_drift(self, impacts: Impacts) -> None:
        """Note the impacts on the way through the step."""
        self._drift = impacts
        if len(impacts):
            rows = self._rows_of_drift()
            self._impacts.add(rows[rows["mode"] == IMPACT_MODE])

    def see_impacts(self, pairs: IntArray, solver: ContactSolver) -> None:
        """Note the impacts found at the end of the step, before contacts are held once more."""
        rows = self._picked.take(len(pairs))
        count = _pick_impacts(_found(pairs, solver), self._ends, rows)
        if count:
            self._impacts.add(self._dated(rows[:count].copy()))

    def take_impacts(self) -> tuple[Records, int]:
        """Return the impacts since the last call, (k,) `CONTACT_ROW` in order of time, and how many were left out."""
        taken, self._impacts = self._impacts, ImpactStore()
        return taken.rows(), taken.left_out

    def rows(self, pairs: IntArray, solver: ContactSolver) -> Records:
        """Return what the contacts of this step did, (m,) `CONTACT_ROW`, by pair.

        These are the contacts of the graph, and those that gave an impulse and are open by now.
        """
        held = self._held
        rows = np.empty(len(held.pairs) + len(pairs), CONTACT_ROW)
        count = _merge(held, _found(pairs, solver), self._ends, rows)
        rows = self._dated(rows[:count])
        return rows if len(self._drift) == 0 else _merged(rows, self._rows_of_drift())

    def impulses(self, solver: ContactSolver) -> Iterator[Impulses]:
        """Yield all impulses of the step, in the order in which they were given."""
        if len(self._held.pairs):
            contacts = self._held.contacts
            pairs = np.empty_like(self._held.pairs)
            pairs[self._held.place] = self._held.pairs
            yield Impulses(pairs, *_geometry(contacts), columns(contacts, IMPULSES))
        if len(self._drift):
            yield Impulses(self._drift.pairs, *_geometry(self._drift.log), columns(self._drift.log, IMPULSES))
        if len(solver.order.pairs):
            pairs, recorded = solver.order.pairs, solver.recorded
            corrections = np.zeros((len(pairs), 4))
            corrections[:, 1:] = columns(recorded, ("correction_x", "correction_y", "correction_z"))
            geometry = _geometry(solver.contacts)
            yield Impulses(pairs, *geometry, corrections, turns=False)
            yield Impulses(pairs, *geometry, columns(recorded, IMPULSES))
            yield Impulses(pairs, *geometry, solver.impulses)

    def work(self, solver: ContactSolver) -> FloatArray:
        """Return the ledger of each contact of the step, (k, 3) J."""
        return np.concatenate((self._held.terms, self._drift.ledger, solver.ledger))

    def _rows_of_drift(self) -> Records:
        rows = np.empty(len(self._drift), CONTACT_ROW)
        _write_log(self._drift.log, self._ends, rows)
        rows["step"] = self._step
        rows["time"] = np.minimum(self._began + self._drift.time, self._ended)
        return rows

    def _dated(self, rows: Records) -> Records:
        rows["step"], rows["time"] = self._step, self._ended
        return rows

    def _compile(self) -> None:
        """Send no contacts through every kernel, so that the first real one does not wait for a compiler."""
        _write_log(NO_IMPACTS.log, self._ends, np.empty(0, CONTACT_ROW))


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
        return np.concatenate(self._parts) if self._parts else np.empty(0, CONTACT_ROW)

    def _leave_out(self) -> None:
        """Keep those with the largest normal impulses; of equal ones the first."""
        rows = np.concatenate(self._parts)
        kept = np.sort(np.argsort(-rows["normal_impulse"], kind="stable")[:MOST_IMPACTS])
        self.left_out += len(rows) - len(kept)
        self._parts, self._count = [rows[kept]], len(kept)


def _geometry(records: Records) -> tuple[FloatArray, FloatArray]:
    """Return normals, (k, 3), and lever arms, (k, 2) m."""
    return columns(records, ("nx", "ny", "nz")), columns(records, ("arm_i", "arm_j"))


def _found(pairs: IntArray, solver: ContactSolver) -> _Found:
    return _Found(pairs, solver.order.place, solver.contacts, solver.states, solver.recorded)


def _merged(rows: Records, struck: Records) -> Records:
    """Put together rows of pairs, sorted, and rows of impacts on the way, in order of time; a pair keeps one row.

    Geometry and time are those of the end of the step, or of the hardest impact where the pair has parted by then.
    """
    both = np.concatenate((rows, struck))
    softness = np.concatenate((np.full(len(rows), -np.inf), -struck["approach_speed"]))
    both = both[np.lexsort((softness, both["j"], both["i"]))]
    new = np.ones(len(both), dtype=np.bool_)
    new[1:] = (np.diff(both["i"]) != 0) | (np.diff(both["j"]) != 0)
    first = np.flatnonzero(new)
    merged: Records = both[first]
    for name in _SUMS:
        merged[name] = np.add.reduceat(both[name], first)
    merged["approach_speed"] = np.maximum.reduceat(both["approach_speed"], first)
    mode = np.minimum.reduceat(both["mode"], first)  # an impact, if there was one; what carries, if one does
    last = merged["mode"]
    merged["mode"] = np.where((mode == IMPACT_MODE) | (last == OPEN), mode, last)
    return merged


@long_kernel
def _pick_impacts(found: _Found, ends: _Ends, rows: Records) -> int:
    """Write the contacts that closed faster than their rest speed and were resolved; return how many."""
    count = 0
    for k in range(len(found.pairs)):
        c = found.place[k]
        state, given = found.states[c], found.recorded[c]
        if given.normal_impulse > 0.0 and state.approach_speed > state.rest_speed:
            row = rows[count]
            _begin(row, found.pairs[k, 0], found.pairs[k, 1], found.contacts[c], ends)
            _add(row, given)
            _add_losses(row, state.restitution_loss, state.friction_loss, state.stabilisation_gain)
            row.approach_speed, row.mode = state.approach_speed, IMPACT_MODE
            count += 1
    return count


@long_kernel
def _merge(held: _Held, found: _Found, ends: _Ends, rows: Records) -> int:
    """Write one row for each pair that was held, that touches or that gave anything; return how many."""
    a, b, count = 0, 0, 0
    while a < len(held.pairs) or b < len(found.pairs):
        order = _compare(a, held.pairs, b, found.pairs)
        row, seen = rows[count], False
        if order <= 0:
            c = held.place[a]
            contact = held.contacts[c]
            _begin(row, held.pairs[a, 0], held.pairs[a, 1], contact, ends)
            _add(row, contact)
            _add_losses(row, held.terms[c, 0], held.terms[c, 1], held.terms[c, 2])
            row.mode = _mode(row.j, contact, ends)
            a += 1
        if order >= 0:
            c = found.place[b]
            contact, state, given = found.contacts[c], found.states[c], found.recorded[c]
            if order == 0:
                _place(row, contact, ends)
            else:
                _begin(row, found.pairs[b, 0], found.pairs[b, 1], contact, ends)
            _add(row, given)
            _add(row, contact)
            _add_losses(row, state.restitution_loss, state.friction_loss, state.stabilisation_gain)
            row.approach_speed = state.approach_speed
            if given.normal_impulse > 0.0 and state.approach_speed > state.rest_speed:
                row.mode = IMPACT_MODE
            elif contact.normal_impulse > 0.0:
                row.mode = _mode(row.j, contact, ends)
            elif given.normal_impulse > 0.0:
                row.mode = _mode(row.j, given, ends)
            seen = not state.apart
            b += 1
        if seen or row.normal_impulse > 0.0 or row.stabilisation_gain != 0.0:
            count += 1
    return count


@kernel
def _write_log(log: Records, ends: _Ends, rows: Records) -> None:
    """Write a row for each impact on the way; step and time are left to the caller."""
    for k in range(len(log)):
        entry, row = log[k], rows[k]
        row.i, row.j = entry.i, entry.j
        row.nx, row.ny, row.nz = entry.nx, entry.ny, entry.nz
        row.x, row.y, row.z = _inside(entry.x, entry.y, entry.z, ends)
        _clear(row)
        _add(row, entry)
        _add_losses(row, entry.restitution_loss, entry.friction_loss, entry.stabilisation_gain)
        row.approach_speed = entry.approach
        row.mode = IMPACT_MODE if entry.approach > entry.rest_speed else _mode(entry.j, entry, ends)


@inline
def _compare(a: int, one: IntArray, b: int, other: IntArray) -> int:
    """Return -1, 0 or 1 as pair a of the one list stands before, with or after pair b of the other."""
    if a == len(one):
        return 1
    if b == len(other):
        return -1
    if one[a, 0] != other[b, 0]:
        return -1 if one[a, 0] < other[b, 0] else 1
    if one[a, 1] != other[b, 1]:
        return -1 if one[a, 1] < other[b, 1] else 1
    return 0


@inline
def _mode(j: int, given: Any, ends: _Ends) -> int:
    """Return the mode of a contact that was no impact."""
    if not given.normal_impulse > 0.0:
        return OPEN
    if not ends.friction:
        return RESTING
    material = ends.materials[material_index(j, len(ends.position))]
    slides = LAW.slides(material, given.normal_impulse, given.friction_x, given.friction_y, given.friction_z)
    return SLIDING if slides else STICKING


@inline
def _begin(row: Any, i: int, j: int, contact: Any, ends: _Ends) -> None:
    """Begin the row of a contact that has given nothing yet."""
    row.i, row.j, row.mode = i, j, OPEN
    _clear(row)
    _place(row, contact, ends)


@inline
def _clear(row: Any) -> None:
    row.approach_speed = row.normal_impulse = row.friction_x = row.friction_y = row.friction_z = 0.0
    row.restitution_loss = row.friction_loss = row.stabilisation_gain = 0.0


@inline
def _place(row: Any, contact: Any, ends: _Ends) -> None:
    """Write the normal and the contact point."""
    row.nx, row.ny, row.nz = contact.nx, contact.ny, contact.nz
    x, arm = ends.position[row.i], contact.arm_i
    row.x, row.y, row.z = _inside(x[0] + arm * contact.nx, x[1] + arm * contact.ny, x[2] + arm * contact.nz, ends)


@inline
def _inside(x: float, y: float, z: float, ends: _Ends) -> tuple[float, float, float]:
    """Return a point, in a periodic box its image inside."""
    box = ends.box
    if box[0] > 0.0:
        x, y, z = minimum_image(x, box[0]), minimum_image(y, box[1]), minimum_image(z, box[2])
    return x, y, z


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
