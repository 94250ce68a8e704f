"""`Cone`: goes back through a window, from the bodies of a question to all bodies that could affect them.

The velocity of each body of the question is divided into shares, whose sum is 1. At the moment of the question, the
body itself carries the whole share. Going back in time, the share that a body carries is divided in two ways:

- **Over a step**, forces are added to the impulses that hold contacts or stop them, so that a floor and the weight on
  the floor cancel. If the sum N makes the body faster, N contributed the share N·e / |v|, where e points along the
  velocity v after the step. This share is divided among the forces and contacts with a component along N, in proportion
  to these components.
- **Over an instant with impacts**, the share is divided among the velocity before and the impulses, in proportion to
  the magnitudes of their components along e, |v⁻·e| : |J₁·e|/m : |J₂·e|/m … If the impacts stop the body, the whole
  magnitudes count.

A sum over many short steps converges, so shares depend on the step no more than the motion does. Impacts of other
engines last for some steps, so their shares are divided like the shares of forces. A share contributed by forces has
reached its cause. A share that reaches a contact is divided between the two ends, in proportion to their speeds along
the impulse before the impact: these speeds cause the impulse. If several bodies touch in an instant, a share may also
come from further impulses on the other end. A plane at rest has no speed, so it returns the whole share: it turns a
body round. A wall that moves on its own keeps its part: this part has reached its cause.

All statements about shares follow from these flows. For a body of a contact, the net share of the contact is the share
that the contact gave this body. It is negative if the body gave a share to the other end, and got it back later. For
each body of the question, the shares of its start, of the forces on it, and of its contacts therefore add up to 1.

Membership is exact: going back in time, a body belongs to the cone from its first contact with a body of the cone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.lab.why.history import Step

_ROUNDS = 16  # largest number of bodies through which a share passes in one instant
NEGLIGIBLE = 1e-9  # smallest share that is passed on; smaller changes of a velocity are rounding


class Flow(NamedTuple):
    """Shares at some impulses, for each of the q bodies of the question."""

    net: FloatArray  # (k, q) shares passed from j to i, minus shares passed from i to j
    turned: FloatArray  # (k, q) shares returned by an end that has no speed to give: a plane, a wall or a fixed body

    @classmethod
    def none(cls, count: int, bodies: int) -> Flow:
        """Return the flow over ``count`` impulses that pass on no share."""
        return cls(np.zeros((count, bodies)), np.zeros((count, bodies)))


@dataclass(slots=True)
class Passage:
    """An impact that passed on a share of the answer, or turned it."""

    step: int
    instant: int  # number of the instant within the step
    time: float  # s
    i: int
    j: int
    impulse: float  # N s
    net: float  # share of the answer that passed from j to i, minus the share that passed from i to j
    turned: float  # share of the answer that a plane, a wall or a fixed body turned round
    before_step: int  # the step before the earliest step of this impact


@dataclass(slots=True)
class Edge:
    """All impulses between two ends."""

    i: int
    j: int
    first: float  # s, time of the first impulse
    last: float  # s, time of the last impulse
    impulse: float = 0.0  # N s, Σ |J|
    impulses: int = 0  # number of impulses
    share: float = 0.0  # share of the answer that passed over the edge, in either direction


@dataclass(slots=True)
class Cone:
    """The bodies behind an answer, their shares, and the contacts between them."""

    inverse_mass: FloatArray  # (n + p,) 1/kg
    count: int  # number of bodies, n
    drives: BoolArray  # (n + p,) whether a plane or wall moves on its own
    weights: FloatArray  # (q,) weight of each body of the question in the answer
    carried: FloatArray  # (n + p, q) share of each body's velocity that each end carries now
    forced: FloatArray  # (n, q) share that forces on each body contributed
    fielded: FloatArray  # (n, q) part of `forced` that another engine's uniform field contributed
    reached: BoolArray  # (n,) whether the body could have had an effect on the answer
    since: FloatArray  # (n,) s, the last moment at which the body could have had an effect; NaN for bodies outside
    edges: dict[tuple[int, int], Edge] = field(default_factory=dict)
    passages: list[Passage] = field(default_factory=list)  # passages, the latest first
    pairs: list[IntArray] = field(default_factory=list)  # arrays (k, 2) of the pairs of bodies that have touched so far
    _lasting: dict[tuple[int, int], Passage] = field(default_factory=dict)  # the earliest contact of each pair
    _before_step: int = 0  # the step before the present step

    @classmethod
    def of(
        cls,
        inverse_mass: FloatArray,
        drives: BoolArray,
        count: int,
        bodies: Sequence[int],
        weights: Sequence[float],
        time: float,
    ) -> Cone:
        """Begin at a moment in s, with the bodies of the question and their weights in the answer."""
        q, since = len(bodies), np.full(count, np.nan)
        carried = np.zeros((len(inverse_mass), q))
        carried[bodies, range(q)], since[list(bodies)] = 1.0, time
        forced, fielded = np.zeros((2, count, q))
        reached = ~np.isnan(since)
        return cls(inverse_mass, count, drives, np.array(weights), carried, forced, fielded, reached, since)

    @property
    def shares(self) -> FloatArray:
        """Share of the answer that each body carries at the present moment, (n,)."""
        return np.asarray(self.carried[: self.count] @ self.weights)

    @property
    def from_forces(self) -> FloatArray:
        """Share of the answer contributed by forces on each body, (n,)."""
        return np.asarray(self.forced @ self.weights)

    @property
    def from_field(self) -> FloatArray:
        """Share of the answer that another engine's uniform field contributed to each body, (n,)."""
        return np.asarray(self.fielded @ self.weights)

    @property
    def from_walls(self) -> FloatArray:
        """Share of the answer that each plane or wall contributed by its own motion, (p,)."""
        return np.asarray(self.carried[self.count :] @ self.weights)

    def take(self, step: Step, rows: Records, velocity: FloatArray, kicked: bool) -> Flow:
        """Go back through a step, or through its beginning up to a moment; return the flow over each impulse.

        ``rows`` are the step's impulses up to the moment, in order, and ``velocity``, (n, 3) m/s, is the velocity after
        the last impulse. Forces act if the step is ``kicked``.
        """
        between = rows["j"] < self.count
        self.pairs.append(np.stack([rows["i"][between], rows["j"][between]], axis=1))
        inside = np.zeros(len(rows), dtype=bool)
        for moment in _groups(rows["time"]):
            inside[moment] = self.reach(rows[moment])
        acts = (rows["x"] != 0.0) | (rows["y"] != 0.0) | (rows["z"] != 0.0)
        impact = acts & rows["impact"] & ~rows["lasts"]
        self._before_step = step.before_step
        impacts, bearing = rows[impact], rows[acts & ~impact]
        before = velocity.copy()
        self._undo(bearing, before)
        forces = np.zeros_like(velocity)
        if kicked:
            forces = before - step.before
            self._undo(impacts, forces)
            before -= forces
        flow, number = Flow.none(len(rows), len(self.weights)), np.arange(len(rows))
        self._bear(rows, number[acts & ~impact & inside], (forces, step.by_field), before, velocity, flow)
        for instant in _groups(rows["instant"]):
            some = number[instant][impact[instant]]
            if len(some):
                self._strike(rows, some, inside[some], before, flow)
        return flow

    def reach(self, rows: Records) -> BoolArray:
        """Add the bodies connected to the cone by contacts of a moment; return a mask of the rows in the cone."""
        if len(rows) == 1:  # a single row is the usual case, and this branch is five times as fast
            i, j = int(rows["i"][0]), int(rows["j"][0])
            ends = [end for end in (i, j) if end < self.count]
            inside = any(self.reached[end] for end in ends)
            for end in ends if inside else ():
                if not self.reached[end] and self.inverse_mass[end] > 0.0:
                    self.reached[end], self.since[end] = True, rows["time"][0]
            return np.array([inside])
        known = np.append(self.reached, np.zeros(len(self.inverse_mass) - self.count, dtype=bool))
        while True:
            own: BoolArray = known[rows["i"]] | known[rows["j"]]
            new = np.unique(np.concatenate((rows["i"][own], rows["j"][own])))
            new = new[(new < self.count) & (self.inverse_mass[new] > 0.0)]
            new = new[~known[new]]
            if not len(new):
                return own
            known[new] = self.reached[new] = True
            self.since[new] = rows["time"][0]

    def closed(self) -> BoolArray:
        """Return a mask (n,) of the bodies connected to the cone by contacts before the moment.

        All these bodies matter, since a body outside the cone may have kept a body of the cone from touching another.
        """
        pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *self.pairs])
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(self.count, self.count))
        _, label = connected_components(graph, directed=False)
        inside: BoolArray = np.isin(label, label[self.reached])
        return inside

    def passed_to(self, bodies: tuple[int, ...]) -> list[float]:
        """Return, for each impact, the share of the answer that the other end passed on to one of the given bodies."""
        nets = [(p.net if end == p.i else -p.net) for p in self.passages for end in (p.i, p.j) if end in bodies]
        return [net for net in nets if net > NEGLIGIBLE]

    def _undo(self, rows: Records, velocity: FloatArray) -> None:
        """Undo the effect of impulses on velocities, (n, 3) m/s."""
        J, body = _vectors(rows), rows["j"] < self.count
        np.add.at(velocity, rows["i"], self.inverse_mass[rows["i"], None] * J)
        np.subtract.at(velocity, rows["j"][body], self.inverse_mass[rows["j"][body], None] * J[body])

    def _bear(
        self,
        rows: Records,
        own: IntArray,
        acting_forces: tuple[FloatArray, FloatArray],
        before: FloatArray,
        after: FloatArray,
        flow: Flow,
    ) -> None:
        """Pass on the shares that the forces and resting contacts of a step contributed; velocities are (n, 3) m/s.

        ``own`` are the row numbers of the contacts, and ``flow`` receives their shares. ``acting_forces`` are the
        changes of velocity by all forces, (n, 3) m/s, and by the field alone, (3,) m/s.
        """
        forces, field = acting_forces
        n, m, some = self.count, len(own), rows[own]
        bodies = np.flatnonzero((self.carried[:n] > NEGLIGIBLE).any(axis=1))
        net = np.zeros((len(self.inverse_mass), 3))  # unit vectors along the changes of velocity
        rate = np.zeros(self.carried.shape)  # share that a component of 1 m/s contributes
        net[bodies] = _units(after[bodies] - before[bodies])
        to, J = np.concatenate((some["i"], some["j"])), np.concatenate((-_vectors(some), _vectors(some)))
        # m/s, component along the change
        given: FloatArray = self.inverse_mass[to] * np.maximum(0.0, (J * net[to]).sum(axis=1))
        by_forces = np.maximum(0.0, (forces * net[:n]).sum(axis=1))
        whole = np.bincount(to, weights=given, minlength=len(rate))[:n] + by_forces
        gain = np.zeros(n)
        acting = np.sqrt((forces * forces).sum(axis=1))
        acting += np.bincount(to, weights=self.inverse_mass[to] * np.sqrt((J * J).sum(axis=1)), minlength=len(rate))[:n]
        gain[bodies] = gained(before[bodies], after[bodies], acting[bodies])
        per_speed = np.divide(gain, whole, out=np.zeros(n), where=whole > 0.0)
        rate[:n] = self.carried[:n] * per_speed[:, None]
        self.carried[:n] *= 1.0 - gain[:, None]
        self.forced += rate[:n] * by_forces[:, None]
        if field.any():
            parts = np.maximum(0.0, np.stack((net[:n] @ field, ((forces - field) * net[:n]).sum(axis=1))))
            of_field = np.divide(parts[0], parts.sum(axis=0), out=np.zeros(n), where=parts[0] > 0.0)
            self.fielded += rate[:n] * (by_forces * of_field)[:, None]
        if m:
            passed = given[:, None] * rate[to]
            _, returned = self._divide(some, passed, np.zeros(2 * m), before)
            self._note(rows, own, passed - returned, returned, flow)

    def _strike(self, rows: Records, struck: IntArray, inside: BoolArray, velocity: FloatArray, flow: Flow) -> None:
        """Undo the impacts of an instant, and pass on shares over the impacts of the cone; velocities are (n, 3) m/s.

        ``struck`` are the row numbers of the impacts, ``inside`` marks the impacts in the cone, and ``flow`` receives
        their shares.
        """
        some = rows[struck]
        ends, local = np.unique(np.concatenate((some["i"], some["j"])), return_inverse=True)
        bodies = ends < self.count
        after, before = np.zeros((2, len(ends), 3))
        after[bodies] = velocity[ends[bodies]]
        self._undo(some, velocity)
        before[bodies] = velocity[ends[bodies]]
        some, struck, chosen = some[inside], struck[inside], np.flatnonzero(np.tile(inside, 2))
        if not len(some):
            return
        # each impulse occurs twice, once for each end
        to, m = local[chosen], len(some)
        origin = np.roll(to, m)
        J = np.concatenate((_vectors(some), _vectors(some))) * self.inverse_mass[ends[to], None]
        taken = np.sqrt((J * J).sum(axis=1))
        total = np.bincount(to, weights=taken, minlength=len(ends)).astype(np.float64)
        along = directions(after, before, total)
        given, kept = components(J, along[to]), components(before, along)
        whole = kept + np.bincount(to, weights=given, minlength=len(ends))
        moves = bodies & (whole > 0.0)
        per_speed = np.divide(1.0, whole, out=np.zeros(len(ends)), where=moves)
        rate = self.carried[ends] * per_speed[:, None]
        self.carried[ends[moves]] = (rate * kept[:, None])[moves]
        passing = given[:, None] * rate[to]
        opposite = np.roll(np.arange(2 * m), m)
        others = np.maximum(0.0, total[origin] - taken[opposite])  # impulses on the other end by further contacts
        further = np.where(~bodies[origin] | (others <= NEGLIGIBLE * total[origin]), 0.0, others)
        kept_away, back_again = np.zeros((2, 2 * m, len(self.weights)))
        for _ in range(_ROUNDS):
            onward, returned = self._divide(some, passing, further, velocity)
            kept_away += passing - returned
            back_again += returned
            if onward.sum() < NEGLIGIBLE:
                self._arrive(ends[origin], onward)
                break
            # divide the forwarded shares among the further impulses on the other ends
            per_impulse = np.divide(onward, others[:, None], out=np.zeros(onward.shape), where=others[:, None] > 0.0)
            arriving = np.zeros((len(ends), len(self.weights)))
            np.add.at(arriving, origin, per_impulse)
            passing = np.maximum(0.0, taken[:, None] * (arriving[to] - per_impulse[opposite]))
        else:
            kept_away += passing
            self._arrive(ends[origin], passing)
        self._note(rows, struck, kept_away, back_again, flow)

    def _divide(
        self, rows: Records, passing: FloatArray, further: FloatArray, before: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Divide the shares that pass over contacts between their ends; return the forwarded and the returned shares.

        ``passing``, (2k, q), has the shares that pass to i, then the shares that pass to j. ``further``, (2k,) m/s, are
        the changes of velocity by further impulses on the other end. Velocities before the impulses are (n, 3) m/s.
        """
        to, origin = np.concatenate((rows["i"], rows["j"])), np.concatenate((rows["j"], rows["i"]))
        J = _vectors(rows)
        along = np.concatenate((-_units(J), _units(J)))
        moves = to < self.count
        speed = np.zeros(len(to))  # m/s, velocity of the receiving end along the impulse
        speed[moves] = (before[to[moves]] * along[moves]).sum(axis=1)
        back = np.abs(speed)
        is_free = (origin < self.count) & (self.inverse_mass[origin] > 0.0)
        own = np.where(is_free, np.roll(back, len(rows)), 0.0)
        driven = self.drives[origin]
        if driven.any():
            # a wall that pushes a body moves at least at the mean speed that it gives to the body
            mean = speed + 0.5 * self.inverse_mass[to] * np.tile(np.sqrt((J * J).sum(axis=1)), 2)
            closing = np.tile(rows["approach"], 2) - back
            own = np.where(driven, np.maximum(0.0, np.maximum(mean, closing)), own)
        whole = own + back + further
        scale = np.divide(passing, whole[:, None], out=np.zeros(passing.shape), where=whole[:, None] > 0.0)
        gives = (is_free | driven)[:, None]
        still = whole[:, None] <= 0.0
        returned = np.where(still, np.where(gives, 0.0, passing), back[:, None] * scale)
        self._arrive(origin, np.where(still, np.where(gives, passing, 0.0), own[:, None] * scale))
        self._arrive(to, returned)
        return further[:, None] * scale, returned

    def _arrive(self, ends: IntArray, parts: FloatArray) -> None:
        np.add.at(self.carried, ends, parts)

    def _note(self, rows: Records, own: IntArray, passed: FloatArray, returned: FloatArray, flow: Flow) -> None:
        """Add the shares that passed over some rows and the shares that returned, (2k, q) each: to i, then to j."""
        m = len(own)
        some = rows[own]
        size = np.sqrt((_vectors(some) ** 2).sum(axis=1))
        to, origin = np.concatenate((some["i"], some["j"])), np.concatenate((some["j"], some["i"]))
        fixed = (self.inverse_mass[origin] == 0.0) & (to < self.count)
        turned = np.where(fixed[:, None], returned, 0.0)
        flow.net[own], flow.turned[own] = passed[:m] - passed[m:], turned[:m] + turned[m:]
        nets, turns = flow.net[own] @ self.weights, flow.turned[own] @ self.weights
        for row, impulse, net, turn in zip(some, size.tolist(), nets.tolist(), turns.tolist(), strict=True):
            i, j, time = int(row["i"]), int(row["j"]), float(row["time"])
            edge = self.edges.get((i, j))
            if edge is None:
                edge = self.edges[i, j] = Edge(i, j, time, time)
            edge.first = time
            edge.impulse += impulse
            edge.impulses += 1
            edge.share += abs(net)
            if not row["impact"]:
                continue
            step, later = int(row["step"]), self._lasting.get((i, j))
            if row["lasts"] and later is not None and step >= later.before_step:  # the forces belong to one impact
                later.step, later.instant, later.time = step, int(row["instant"]), time
                later.before_step = self._before_step
                later.impulse += impulse
                later.net, later.turned = later.net + net, later.turned + turn
                continue
            if max(abs(net), turn) <= NEGLIGIBLE:
                continue
            passage = Passage(step, int(row["instant"]), time, i, j, impulse, net, turn, self._before_step)
            self.passages.append(passage)
            if row["lasts"]:
                self._lasting[i, j] = passage


def gained(before: FloatArray, after: FloatArray, acting: FloatArray) -> FloatArray:
    """Return the fractions of speeds, (k,), that are due to the changes of velocities, (k, 3) m/s.

    If contributions of the total size ``acting``, (k,) m/s, cancel, the remaining change is rounding.
    """
    change = after - before
    squared, gain = (after * after).sum(axis=1), (change * after).sum(axis=1)
    counts = (change * change).sum(axis=1) > (NEGLIGIBLE * acting) ** 2
    fraction = np.divide(gain, squared, out=np.zeros(len(gain)), where=counts & (gain > NEGLIGIBLE * squared))
    result: FloatArray = np.minimum(fraction, 1.0)
    return result


def directions(after: FloatArray, before: FloatArray, total: FloatArray) -> FloatArray:
    """Return the directions of velocities after impacts, (k, 3); zeros if impacts (``total``, m/s) stop a body."""
    speed = np.sqrt((after * after).sum(axis=1))
    stops = speed <= NEGLIGIBLE * (np.sqrt((before * before).sum(axis=1)) + total)
    result: FloatArray = np.where(stops[:, None], 0.0, _units(after))
    return result


def components(vectors: FloatArray, along: FloatArray) -> FloatArray:
    """Return the sizes of components along directions, (k, 3) each; the sizes of whole vectors if a direction is 0."""
    whole = np.sqrt((vectors * vectors).sum(axis=1))
    result: FloatArray = np.where(along.any(axis=1), np.abs((vectors * along).sum(axis=1)), whole)
    return result


def _groups(keys: FloatArray | IntArray) -> list[slice]:
    """Return the runs of equal keys, last run first."""
    begins = [0, *(1 + np.flatnonzero(np.diff(keys))).tolist(), len(keys)]
    return [slice(*ends) for ends in pairwise(begins) if len(keys)][::-1]


def _vectors(rows: Records) -> FloatArray:
    """Return impulses on j, (k, 3) N s."""
    return np.stack([rows["x"], rows["y"], rows["z"]], axis=1)


def _units(vectors: FloatArray) -> FloatArray:
    """Return unit vectors, (k, 3); zero vectors stay zero."""
    length = np.sqrt((vectors * vectors).sum(axis=1))[:, None]
    result: FloatArray = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
    return result
