"""Kernels that write the rows of `contact_table` from the records of the solver and the log of the drift."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.contact_table import IMPACT_MODE, OPEN, RESTING, SLIDING, STICKING
from carom.physics.contact.constraint_graph import empty_graph
from carom.physics.contact.constraints import CONTACT
from carom.physics.contact.law import LAW, Materials, material_index
from carom.physics.contact.pair_order import comes_before
from carom.physics.diagnostics.ledger import FRICTION, RESTITUTION, STABILISATION
from carom.physics.jit.decorators import inline, kernel, long_kernel
from carom.physics.vector import nearest_image


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
    slides = LAW.slides(material, given.normal_impulse, given.friction_x, given.friction_y, given.friction_z)
    return SLIDING if slides else STICKING


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
