"""The contact snapshot of a step: the contacts at its end and the impacts during its drift, without near pairs.

A snapshot copies its contacts, so it is made only when it is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, Records
from carom.physics.aligned import columns
from carom.physics.contact.graph import OrderedContacts, colour_bodies, colour_rest
from carom.physics.contact.impact_log import NO_IMPACTS, Impacts
from carom.physics.contact.records import ContactRecord, ContactStateRecord
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.jit.decorators import kernel
from carom.state.frame import CollisionGraph, empty_graph


class IdleContacts(Protocol):
    """Contacts at rest that no solver computes; sorted by pair."""

    def __len__(self) -> int: ...

    def graph(self) -> CollisionGraph:
        """Return the contacts that touch or carry a force."""
        ...

    def records(self, dt: float) -> tuple[IntArray, IntArray, Records, Records, Records]:
        """Return pairs, places, `CONTACT` with the impulses of dt s, `CONTACT_STATE` and `RECORDED`."""
        ...


@dataclass(frozen=True, slots=True)
class ContactSnapshot:
    """The contacts of a step, each pair once, in the order of the graph."""

    graph: CollisionGraph
    approach: FloatArray  # (m,) m/s, largest closing speed of each pair before the impulses
    rest_speed: FloatArray  # (m,) m/s, closing speed up to which a contact is at rest
    impacts: int  # number of contacts that closed faster than `rest_speed`; a pair may count more than once
    _order: IntArray | None = None  # (l,) order of contacts and impacts by pair; None without impacts
    _first: IntArray | None = None  # (m,) index of each pair's first entry in `_order`

    @classmethod
    def of(cls, graph: CollisionGraph, approach: FloatArray, rest_speed: FloatArray) -> ContactSnapshot:
        """Describe the contacts at the end of a step."""
        return cls(graph, approach, rest_speed, int(np.count_nonzero(approach > rest_speed)))

    def joined(self, others: CollisionGraph, inverse_mass: FloatArray) -> tuple[ContactSnapshot, IntArray]:
        """Add resting contacts of other pairs; return each contact's index in the solver, -1 for added contacts."""
        graph, m = self.graph, len(self.graph)
        pairs = np.concatenate((graph.pairs, others.pairs))
        order = np.lexsort((pairs[:, 1], pairs[:, 0]))
        fill = np.zeros(len(others))
        colours, body_colours = self._colours(pairs[order], order, order.astype(np.float64), inverse_mass)
        joined = CollisionGraph(
            pairs[order],
            np.concatenate((graph.normals, others.normals))[order],
            np.concatenate((graph.overlaps, others.overlaps))[order],
            colours,
            body_colours,
        )
        approach = np.concatenate((self.approach, fill))[order]
        rest_speed = np.concatenate((self.rest_speed, fill))[order]
        return ContactSnapshot.of(joined, approach, rest_speed), np.where(order < m, order, -1)

    def after(self, impacts: Impacts, dt: float, inverse_mass: FloatArray) -> ContactSnapshot:
        """Add the impacts during a step of dt (s), given the inverse masses of bodies and planes, (n + p,) 1/kg.

        A pair that no longer touches at the end gets the normal of its hardest impact, and no overlap. Contacts at the
        end of the step keep the colours in which they were resolved; impacts are coloured in the order of time.
        """
        if len(impacts) == 0:
            return self
        graph, log, late = self.graph, impacts.log, len(self.graph)
        approach = np.concatenate((self.approach, impacts.approach))
        ends = (graph.pairs[:, 0], log["i"]), (graph.pairs[:, 1], log["j"])
        pair = np.concatenate(ends[0]) * len(inverse_mass) + np.concatenate(ends[1])  # a unique number for each pair
        # entries of a pair are in this order: the contact at the end, then impacts, the hardest first
        softness = -approach
        softness[:late] = -np.inf
        order = np.lexsort((softness, pair))
        in_order = pair[order]
        begins = np.ones(len(order), dtype=np.bool_)
        np.not_equal(in_order[1:], in_order[:-1], out=begins[1:])
        (first,) = begins.nonzero()
        shown = order[first]
        pairs = np.empty((len(shown), 2), dtype=np.int64)
        np.divmod(in_order[first], len(inverse_mass), pairs[:, 0], pairs[:, 1])
        normals, overlaps = np.concatenate((graph.normals, columns(log, ("nx", "ny", "nz")))), np.zeros(len(order))
        overlaps[:late] = graph.overlaps
        times = np.full(len(order), dt)
        times[late:] = impacts.time
        into_step = np.minimum.reduceat(times[order], first)
        colours, body_colours = self._colours(pairs, shown, into_step, inverse_mass)
        joined = CollisionGraph(pairs, normals[shown], overlaps[shown], colours, body_colours, into_step)
        return ContactSnapshot(
            joined,
            np.maximum.reduceat(approach[order], first),
            np.concatenate((self.rest_speed, impacts.rest_speed))[shown],
            self.impacts + int(np.count_nonzero(impacts.approach > impacts.rest_speed)),
            order,
            first,
        )

    def _colours(
        self, pairs: IntArray, shown: IntArray, into_step: FloatArray, inverse_mass: FloatArray
    ) -> tuple[IntArray, IntArray | None]:
        """Colour pairs; ``shown`` has their indices in this graph, or indices past its end if they are not in it."""
        graph = self.graph
        if graph.body_colours is not None:
            return colour_bodies(pairs, len(graph.body_colours), graph.body_colours)
        added = shown >= len(graph)
        colours, in_time = np.full(len(pairs), -1), into_step.argsort(kind="stable")
        if len(graph):
            colours[~added] = graph.colours[shown[~added]]
            in_time = in_time[added[in_time]]
        return colour_rest(pairs, colours, in_time, inverse_mass), None

    def sums(self, late: FloatArray, impacts: FloatArray) -> FloatArray:
        """Return, for each contact, the sum of its row in ``late`` and the rows of its impacts."""
        if self._order is None or self._first is None:
            return late
        return np.add.reduceat(np.concatenate((late, impacts))[self._order], self._first)


EMPTY_SNAPSHOT = ContactSnapshot.of(empty_graph(), np.empty(0), np.empty(0))


class SnapshotSource:
    """Makes the contact snapshot of the last step when a frame, the statistics or the audit needs one."""

    def __init__(self, solver: ContactSolver, inverse_mass: FloatArray) -> None:
        self._solver, self._inverse_mass = solver, inverse_mass
        self.forget()

    def forget(self) -> None:
        """Return to the state before the first step."""
        self._snapshot: ContactSnapshot | None = EMPTY_SNAPSHOT  # None before the snapshot is made
        self._place = np.empty(0, dtype=np.int64)  # (m,) indices of the contacts' records; -1 for idle contacts
        self._impacts = NO_IMPACTS

    def set_step(self, contacts: OrderedContacts, idle: IdleContacts | None, impacts: Impacts, dt: float) -> None:
        """Set the contacts at the end of a step of dt s, the idle contacts, and the impacts of the drift."""
        self._contacts, self._idle, self._impacts, self._dt = contacts, idle, impacts, dt
        self._snapshot = None

    def set_quiet(self, contacts: OrderedContacts) -> None:
        """Note a step without contacts that follows a step without contacts."""
        if self._snapshot is None or self._snapshot is EMPTY_SNAPSHOT:  # the previous step's snapshot is empty, too
            self.set_step(contacts, None, NO_IMPACTS, 0.0)

    @property
    def snapshot(self) -> ContactSnapshot:
        """The contacts of the step that touch or carry an impulse."""
        if self._snapshot is None:
            solver, contacts = self._solver, self._contacts
            records = (contacts.order.place, solver.contacts, solver.states, solver.found_normals)
            late, self._place = late_contacts(contacts.pairs, contacts.colours, contacts.body_colours, *records)
            if self._idle:
                late, place = late.joined(self._idle.graph(), self._inverse_mass)
                self._place = np.append(self._place, -1)[place]
            self._snapshot = late.after(self._impacts, self._dt, self._inverse_mass)
        return self._snapshot

    def keep_contributions(self) -> Callable[[], FloatArray]:
        """Store the losses of this step; the returned function gives the losses of each contact, (m, 3) J."""
        snapshot, place, impacts = self.snapshot, self._place, self._impacts.ledger.copy()
        late = np.concatenate((self._solver.ledger, np.zeros((1, 3))))  # the last row is for idle contacts
        return lambda: snapshot.sums(late[place], impacts)


def late_contacts(
    pairs: IntArray,
    colours: IntArray,
    body_colours: IntArray | None,
    place: IntArray,
    contacts: RecordArray[ContactRecord],
    states: RecordArray[ContactStateRecord],
    normals: FloatArray,
) -> tuple[ContactSnapshot, IntArray]:
    """Copy the contacts that touch or carry an impulse at the end of a step, without impacts during the step.

    The arrays contain all m contacts, including near contacts: sorted pairs, indices of their records in ``place``, and
    normals before the position correction. Return a snapshot, and the indices of the records of its contacts, (k,).
    """
    m = len(pairs)
    ends, indices, numbers = np.empty((m, 2), np.int64), np.empty((2, m), np.int64), np.empty((3, m))
    kept = ends, np.empty((m, 3)), *indices, *numbers
    count = _copy_touching(pairs, colours, place, contacts, states, normals, kept)
    ends, normals, colours, place, overlaps, approach, rest_speed = (array[:count] for array in kept)
    graph = CollisionGraph(ends, normals, overlaps, colours, body_colours)
    return ContactSnapshot.of(graph, approach, rest_speed), place


@kernel
def _copy_touching(
    pairs: IntArray,
    colours: IntArray,
    place: IntArray,
    contacts: RecordArray[ContactRecord],
    states: RecordArray[ContactStateRecord],
    normals: FloatArray,
    kept: tuple[IntArray, FloatArray, IntArray, IntArray, FloatArray, FloatArray, FloatArray],
) -> int:
    """Copy the contacts that touched or carry an impulse; return their number.

    Normals and overlaps are from before the position correction. A contact that the correction opened is still
    resolved; otherwise the body would fall and be pushed back in each step.
    """
    kept_pairs, kept_normals, kept_colours, kept_place, overlaps, approach, rest_speed = kept
    count = 0
    for c in range(len(pairs)):
        p = place[c]
        state = states[p]
        if not state.apart or contacts[p].normal_impulse > 0.0:
            kept_pairs[count, 0], kept_pairs[count, 1] = pairs[c, 0], pairs[c, 1]
            for k in range(3):
                kept_normals[count, k] = normals[p, k]
            overlaps[count], kept_colours[count] = state.detected_overlap, colours[c]
            approach[count], rest_speed[count] = state.approach_speed, state.rest_speed
            kept_place[count] = p
            count += 1
    return count
