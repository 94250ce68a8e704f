"""The contact snapshot of a step: the contacts found at its end, and the impacts during its drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.physics.contact.events.drift import Impacts
from carom.physics.contact.graph import CollisionGraph, colour_bodies, colour_rest, empty_graph
from carom.physics.jit.decorators import kernel


@dataclass(frozen=True, slots=True)
class ContactSnapshot:
    """The contacts of a step, each pair once, in the order of the graph."""

    graph: CollisionGraph
    approach: FloatArray  # (m,) m/s, closing speed before the impulses; the largest if there were several
    rest_speed: FloatArray  # (m,) m/s, up to which each is at rest
    impacts: int  # how many closed faster than that; a pair may count more than once
    _order: IntArray | None = None  # (l,) of contacts and impacts by pair; None if there were no impacts
    _first: IntArray | None = None  # (m,) position of the first of each pair in that order

    @classmethod
    def of(cls, graph: CollisionGraph, approach: FloatArray, rest_speed: FloatArray) -> ContactSnapshot:
        """Describe the contacts found at the end of a step."""
        return cls(graph, approach, rest_speed, int(np.count_nonzero(approach > rest_speed)))

    def joined(self, others: CollisionGraph, inverse_mass: FloatArray) -> tuple[ContactSnapshot, IntArray]:
        """Add contacts at rest of other pairs; return each contact's place in the solver, -1 for the added ones."""
        graph, m = self.graph, len(self.graph)
        pairs = np.concatenate((graph.pairs, others.pairs))
        order = np.lexsort((pairs[:, 1], pairs[:, 0]))
        fill = np.zeros(len(others))
        colours, body_colours = self._colours(pairs[order], order, order.astype(np.float64), inverse_mass)
        seen = CollisionGraph(
            pairs[order],
            np.concatenate((graph.normals, others.normals))[order],
            np.concatenate((graph.overlaps, others.overlaps))[order],
            colours,
            body_colours,
        )
        approach = np.concatenate((self.approach, fill))[order]
        rest_speed = np.concatenate((self.rest_speed, fill))[order]
        return ContactSnapshot.of(seen, approach, rest_speed), np.where(order < m, order, -1)

    def after(self, struck: Impacts, dt: float, inverse_mass: FloatArray) -> ContactSnapshot:
        """Add the impacts during a step of dt, in s; ``inverse_mass`` is that of bodies and planes, (n + p,) 1/kg.

        A pair that no longer touches at the end has the normal of its hardest impact and no overlap. Contacts found at
        the end keep the colours in which they were resolved; the others get theirs in the order of time.
        """
        if len(struck) == 0:
            return self
        graph, late = self.graph, len(self.graph)
        pairs = np.concatenate((graph.pairs, struck.pairs))
        approach = np.concatenate((self.approach, struck.approach))
        # in each pair, the contact found at the end comes first, then the hardest impact
        softness = -np.concatenate((np.full(late, np.inf), struck.approach))
        order = np.lexsort((softness, pairs[:, 1], pairs[:, 0]))
        first = np.flatnonzero(np.any(np.diff(pairs[order], axis=0, prepend=-1), axis=1))
        shown = order[first]
        into_step = np.minimum.reduceat(np.concatenate((np.full(late, dt), struck.time))[order], first)
        colours, body_colours = self._colours(pairs[shown], shown, into_step, inverse_mass)
        seen = CollisionGraph(
            pairs[shown],
            np.concatenate((graph.normals, struck.normal))[shown],
            np.concatenate((graph.overlaps, np.zeros(len(struck))))[shown],
            colours,
            body_colours,
            into_step,
        )
        return ContactSnapshot(
            seen,
            np.maximum.reduceat(approach[order], first),
            np.concatenate((self.rest_speed, struck.rest_speed))[shown],
            self.impacts + int(np.count_nonzero(struck.approach > struck.rest_speed)),
            order,
            first,
        )

    def _colours(
        self, pairs: IntArray, shown: IntArray, into_step: FloatArray, inverse_mass: FloatArray
    ) -> tuple[IntArray, IntArray | None]:
        """Colour pairs; ``shown`` has their positions in this graph, or positions past its end if not in it."""
        graph = self.graph
        if graph.body_colours is not None:
            return colour_bodies(pairs, len(graph.body_colours), graph.body_colours)
        struck = shown >= len(graph)
        colours = np.full(len(pairs), -1)
        colours[~struck] = graph.colours[shown[~struck]]
        in_time = np.argsort(into_step, kind="stable")
        return colour_rest(pairs, colours, in_time[struck[in_time]], inverse_mass), None

    def sums(self, late: FloatArray, struck: FloatArray) -> FloatArray:
        """Sum rows of the contacts found at the end, and of the impacts, by contact."""
        if self._order is None or self._first is None:
            return late
        return np.add.reduceat(np.concatenate((late, struck))[self._order], self._first)


EMPTY_SNAPSHOT = ContactSnapshot.of(empty_graph(), np.empty(0), np.empty(0))


def late_contacts(
    pairs: IntArray,
    colours: IntArray,
    body_colours: IntArray | None,
    place: IntArray,
    contacts: Records,
    states: Records,
    normals: FloatArray,
) -> tuple[ContactSnapshot, IntArray]:
    """Copy the contacts found at the end of a step that touched then or carry an impulse.

    Parameters
    ----------
    pairs, colours
        (m, 2), sorted, and (m,), all that were found.
    body_colours
        As in `CollisionGraph`.
    place
        (m,) index of each one's record.
    contacts, states, normals
        (m,) `CONTACT`, (m,) `CONTACT_STATE`, and (m, 3) as found.

    Returns
    -------
    snapshot
        Without the impacts during the step.
    seen
        (k,) indices of the records of its contacts.
    """
    m = len(pairs)
    shown_pairs, shown_normals = np.empty((m, 2), dtype=np.int64), np.empty((m, 3))
    overlaps, approach, rest_speed = np.empty(m), np.empty(m), np.empty(m)
    shown_colours, seen = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    found = (pairs, colours, place, contacts, states, normals)
    count = _show(*found, shown_pairs, shown_normals, overlaps, shown_colours, approach, rest_speed, seen)
    graph = CollisionGraph(
        shown_pairs[:count], shown_normals[:count], overlaps[:count], shown_colours[:count], body_colours
    )
    return ContactSnapshot.of(graph, approach[:count], rest_speed[:count]), seen[:count]


@kernel
def _show(
    pairs: IntArray,
    colours: IntArray,
    place: IntArray,
    contacts: Records,
    states: Records,
    normals: FloatArray,
    shown_pairs: IntArray,
    shown_normals: FloatArray,
    overlaps: FloatArray,
    shown_colours: IntArray,
    approach: FloatArray,
    rest_speed: FloatArray,
    shown_place: IntArray,
) -> int:
    """Copy the contacts that touched when they were found or carry an impulse; return how many.

    Normals and overlaps are from before the position correction. A contact that the correction opens is still resolved.
    Otherwise the body would fall and be pushed back in every step.
    """
    count = 0
    for c in range(len(pairs)):
        p = place[c]
        state = states[p]
        if not state.apart or contacts[p].normal_impulse > 0.0:
            shown_pairs[count, 0], shown_pairs[count, 1] = pairs[c, 0], pairs[c, 1]
            for k in range(3):
                shown_normals[count, k] = normals[p, k]
            overlaps[count], shown_colours[count] = state.found_overlap, colours[c]
            approach[count], rest_speed[count] = state.approach_speed, state.rest_speed
            shown_place[count] = p
            count += 1
    return count
