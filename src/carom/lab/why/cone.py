"""`Cone`: goes back through a window, from the bodies of a question to all bodies that could affect them.

Each body carries a share of the answer; the shares sum to 1 at the moment of the question. Going back in time, a share
is divided in two ways:

- **Over a step**, forces are summed with the impulses that hold contacts or stop them, so that a floor and the weight
  on it contribute nothing. If the sum N makes the body faster, N contributed the share N·e / |v|, where e points along
  the velocity v after the step. This share is divided among the forces and contacts with a component along N, in
  proportion to these components.
- **Over an instant with impacts**, the share is divided among the velocity before and the impulses, in proportion to
  the magnitudes of their components along e, |v⁻·e| : |J₁·e|/m : |J₂·e|/m … If the impacts stop the body, the whole
  magnitudes count.

A sum over many short steps converges, so shares depend on the step no more than the motion does. Impacts of other
engines last for some steps, so their shares are divided like the shares of forces. A share contributed by forces has
reached its cause. A share that passes over a contact is divided between the two ends, in proportion to their speeds
along the impulse before the impact: these speeds cause the impulse. If several bodies touch in an instant, a share may
also come from further impulses on the other end. A plane returns its whole share.

Shares are between 0 and 1. Membership is exact: going back in time, a body belongs to the cone from its first contact
with a body of the cone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.lab.why.history import Step

_ROUNDS = 16  # largest number of bodies through which a share passes in one instant
NEGLIGIBLE = 1e-9  # share that is not passed on; change of a velocity that counts as rounding


@dataclass(slots=True)
class Passage:
    """An impact that passed on a share of the answer."""

    step: int
    time: float  # s
    i: int
    j: int
    impulse: float  # N s
    to_i: float  # net share of the answer that passed from j to i
    to_j: float
    before_step: int  # the step before its first one


@dataclass(slots=True)
class Edge:
    """All impulses between two ends."""

    i: int
    j: int
    first: float  # s
    last: float  # s
    impulse: float = 0.0  # N s, Σ |J|
    impulses: int = 0  # their number
    share: float = 0.0  # share of the answer that passed over it


@dataclass(slots=True)
class Cone:
    """The bodies behind an answer, their shares, and the contacts between them."""

    inverse_mass: FloatArray  # (n + p,) 1/kg
    count: int  # of bodies
    shares: FloatArray  # (n,) of the answer, that each body carries at the present moment
    reached: BoolArray  # (n,) whether it could have had an effect
    since: FloatArray  # (n,) s, the last moment at which it could have had an effect; NaN for bodies outside
    from_forces: FloatArray  # (n,) share contributed by forces on each body
    edges: dict[tuple[int, int], Edge] = field(default_factory=dict)
    passages: list[Passage] = field(default_factory=list)  # the latest first
    pairs: list[IntArray] = field(default_factory=list)  # (k, 2) each: the pairs of bodies that have touched so far
    _lasting: dict[tuple[int, int], Passage] = field(default_factory=dict)  # the earliest of each pair
    _before_step: int = 0  # the step before the present one

    @classmethod
    def of(cls, inverse_mass: FloatArray, count: int, shares: dict[int, float], time: float) -> Cone:
        """Begin at a moment in s, with the share of each body of the question."""
        carried, since = np.zeros(count), np.full(count, np.nan)
        for body, share in shares.items():
            carried[body], since[body] = share, time
        return cls(inverse_mass, count, carried, ~np.isnan(since), since, np.zeros(count))

    def take(self, step: Step, rows: Records, velocity: FloatArray, kicked: bool) -> None:
        """Go back through a step, or through its beginning up to a moment.

        ``rows`` are its impulses up to the moment, in order, and ``velocity``, (n, 3) m/s, follows the last of them.
        Forces act if it is ``kicked``.
        """
        between = rows["j"] < self.count
        self.pairs.append(np.stack([rows["i"][between], rows["j"][between]], axis=1))
        begins = np.flatnonzero(np.diff(rows["instant"], prepend=-1)).tolist()
        instants = [slice(*ends) for ends in pairwise([*begins, len(rows)])][::-1]
        inside = np.zeros(len(rows), dtype=bool)
        for instant in instants:
            inside[instant] = self.reach(rows[instant])
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
        self._bear(bearing[inside[acts & ~impact]], forces, before, velocity)
        for instant in instants:
            some = rows[instant][impact[instant]]
            if len(some):
                self._strike(some, inside[instant][impact[instant]], before)

    def reach(self, rows: Records) -> BoolArray:
        """Add the bodies connected to the cone by contacts of an instant; return a mask of the rows in the cone."""
        if len(rows) == 1:  # the usual case, five times as fast
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

        Only these matter: a body outside the cone may have kept a body of the cone from touching another.
        """
        pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *self.pairs])
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(self.count, self.count))
        _, label = connected_components(graph, directed=False)
        inside: BoolArray = np.isin(label, label[self.reached])
        return inside

    def passed_to(self, bodies: tuple[int, ...]) -> list[float]:
        """Return the shares of the answer that other bodies passed on to some bodies, one for each impact."""
        return [to for p in self.passages for end, to in ((p.i, p.to_i), (p.j, p.to_j)) if end in bodies and to > 0.0]

    def _undo(self, rows: Records, velocity: FloatArray) -> None:
        """Undo the effect of impulses on velocities, (n, 3) m/s."""
        J, body = _vectors(rows), rows["j"] < self.count
        np.add.at(velocity, rows["i"], self.inverse_mass[rows["i"], None] * J)
        np.subtract.at(velocity, rows["j"][body], self.inverse_mass[rows["j"][body], None] * J[body])

    def _bear(self, rows: Records, forces: FloatArray, before: FloatArray, after: FloatArray) -> None:
        """Pass on the shares contributed by the forces and the resting contacts of a step; velocities (n, 3) m/s."""
        n, m = self.count, len(rows)
        bodies = np.flatnonzero(self.shares > NEGLIGIBLE)
        net = np.zeros((len(self.inverse_mass), 3))  # along N, of length 1
        rate = np.zeros(len(self.inverse_mass))  # share contributed by a component of 1 m/s
        net[bodies] = _units(after[bodies] - before[bodies])
        to, J = np.concatenate((rows["i"], rows["j"])), np.concatenate((-_vectors(rows), _vectors(rows)))
        given: FloatArray = self.inverse_mass[to] * np.maximum(0.0, (J * net[to]).sum(axis=1))  # m/s
        by_forces = np.maximum(0.0, (forces * net[:n]).sum(axis=1))
        whole = np.bincount(to, weights=given, minlength=len(rate))[:n] + by_forces
        gain = np.zeros(n)
        acting = np.sqrt((forces * forces).sum(axis=1))
        acting += np.bincount(to, weights=self.inverse_mass[to] * np.sqrt((J * J).sum(axis=1)), minlength=len(rate))[:n]
        gain[bodies] = gained(before[bodies], after[bodies], acting[bodies])
        rate[:n] = self.shares * np.divide(gain, whole, out=np.zeros(n), where=whole > 0.0)
        self.shares *= 1.0 - gain
        self.from_forces += rate[:n] * by_forces
        if m:
            flow, none = given * rate[to], np.zeros(2 * m)
            _, returned = self._divide(rows, flow, none, before)
            self._note(rows, flow, flow - returned)

    def _strike(self, rows: Records, inside: BoolArray, velocity: FloatArray) -> None:
        """Undo the impacts of an instant, and pass on shares over the impacts of the cone; velocities (n, 3) m/s."""
        ends, local = np.unique(np.concatenate((rows["i"], rows["j"])), return_inverse=True)
        bodies = ends < self.count
        after, before = np.zeros((2, len(ends), 3))
        after[bodies] = velocity[ends[bodies]]
        self._undo(rows, velocity)
        before[bodies] = velocity[ends[bodies]]
        rows, chosen = rows[inside], np.flatnonzero(np.tile(inside, 2))
        if not len(rows):
            return
        # each impulse twice, once for each end
        to, m = local[chosen], len(rows)
        origin = np.roll(to, m)
        J = np.concatenate((_vectors(rows), _vectors(rows))) * self.inverse_mass[ends[to], None]
        taken = np.sqrt((J * J).sum(axis=1))
        total = np.bincount(to, weights=taken, minlength=len(ends)).astype(np.float64)
        along = directions(after, before, total)
        given, kept = components(J, along[to]), components(before, along)
        whole = kept + np.bincount(to, weights=given, minlength=len(ends))
        shares = np.zeros(len(ends))
        shares[bodies] = self.shares[ends[bodies]]
        rate = np.divide(shares, whole, out=np.zeros(len(ends)), where=whole > 0.0)
        self.shares[ends[bodies]] = np.where(whole > 0.0, rate * kept, shares)[bodies]
        flow: FloatArray = given * rate[to]
        opposite = np.roll(np.arange(2 * m), m)
        others = np.maximum(0.0, total[origin] - taken[opposite])  # of the further impulses on the other end
        further = np.where(~bodies[origin] | (others <= NEGLIGIBLE * total[origin]), 0.0, others)
        passed, back_again = np.zeros(2 * m), np.zeros(2 * m)
        for _ in range(_ROUNDS):
            passed += flow
            onward, returned = self._divide(rows, flow, further, velocity)
            back_again += returned
            if onward.sum() < NEGLIGIBLE:
                break
            # divide the forwarded shares among the further impulses on the other ends
            per_impulse = np.divide(onward, others, out=np.zeros(2 * m), where=others > 0.0)
            arriving = np.bincount(origin, weights=per_impulse, minlength=len(ends))
            flow = np.maximum(0.0, taken * (arriving[to] - per_impulse[opposite]))
        else:
            self._arrive(ends[origin], flow)
        self._note(rows, passed, passed - back_again)

    def _divide(
        self, rows: Records, flow: FloatArray, further: FloatArray, before: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Divide the shares that pass over contacts between their ends; return the forwarded and the returned shares.

        ``flow``, (2k,), has the shares of the answer that pass to i, then to j. ``further``, (2k,) m/s, is due to other
        impulses on the other end. Velocities before the impulses are (n, 3) m/s.
        """
        to, origin = np.concatenate((rows["i"], rows["j"])), np.concatenate((rows["j"], rows["i"]))
        along = _units(_vectors(rows))
        moves = to < self.count
        back: FloatArray = np.zeros(len(to))  # m/s, speed of the receiving end along the impulse
        back[moves] = np.abs((before[to[moves]] * np.concatenate((along, along))[moves]).sum(axis=1))
        is_free = (origin < self.count) & (self.inverse_mass[origin] > 0.0)
        own = np.where(is_free, np.roll(back, len(rows)), 0.0)
        whole = own + back + further
        scale = np.divide(flow, whole, out=np.zeros(len(to)), where=whole > 0.0)
        returned = np.where(whole > 0.0, back * scale, np.where(is_free, 0.0, flow))
        self._arrive(origin, np.where(whole > 0.0, own * scale, np.where(is_free, flow, 0.0)))
        self._arrive(to, returned)
        return further * scale, returned

    def _arrive(self, ends: IntArray, parts: FloatArray) -> None:
        bodies = ends < self.count
        np.add.at(self.shares, ends[bodies], parts[bodies])

    def _note(self, rows: Records, passed: FloatArray, kept: FloatArray) -> None:
        m, size = len(rows), np.sqrt((_vectors(rows) ** 2).sum(axis=1))
        for k, row in enumerate(rows):
            i, j, time = int(row["i"]), int(row["j"]), float(row["time"])
            edge = self.edges.get((i, j))
            if edge is None:
                edge = self.edges[i, j] = Edge(i, j, time, time)
            edge.first = time
            edge.impulse += float(size[k])
            edge.impulses += 1
            edge.share += float(passed[k] + passed[m + k])
            to_i, to_j = float(kept[k]), float(kept[m + k])
            if not row["impact"] or max(to_i, to_j) <= NEGLIGIBLE:
                continue
            step, later = int(row["step"]), self._lasting.get((i, j))
            if row["lasts"] and later is not None and step >= later.before_step:  # of one impact
                later.step, later.time, later.before_step = step, time, self._before_step
                later.impulse += float(size[k])
                later.to_i, later.to_j = later.to_i + to_i, later.to_j + to_j
                continue
            passage = Passage(step, time, i, j, float(size[k]), to_i, to_j, self._before_step)
            self.passages.append(passage)
            if row["lasts"]:
                self._lasting[i, j] = passage


def gained(before: FloatArray, after: FloatArray, acting: FloatArray) -> FloatArray:
    """Return the fractions of speeds, (k,), that are due to the changes of velocities, (k, 3) m/s.

    A change is rounding if contributions of ``acting``, (k,) m/s in all, cancel.
    """
    change = after - before
    squared, gain = (after * after).sum(axis=1), (change * after).sum(axis=1)
    counts = (change * change).sum(axis=1) > (NEGLIGIBLE * acting) ** 2
    fraction = np.divide(gain, squared, out=np.zeros(len(gain)), where=counts & (gain > NEGLIGIBLE * squared))
    result: FloatArray = np.minimum(fraction, 1.0)
    return result


def directions(after: FloatArray, before: FloatArray, total: FloatArray) -> FloatArray:
    """Return the directions of velocities after impacts, (k, 3); zeros where impacts (``total``, m/s) stop a body."""
    speed = np.sqrt((after * after).sum(axis=1))
    stops = speed <= NEGLIGIBLE * (np.sqrt((before * before).sum(axis=1)) + total)
    result: FloatArray = np.where(stops[:, None], 0.0, _units(after))
    return result


def components(vectors: FloatArray, along: FloatArray) -> FloatArray:
    """Return the sizes of components of vectors along directions, (k, 3) each; whole sizes where these are zeros."""
    whole = np.sqrt((vectors * vectors).sum(axis=1))
    result: FloatArray = np.where(along.any(axis=1), np.abs((vectors * along).sum(axis=1)), whole)
    return result


def _vectors(rows: Records) -> FloatArray:
    """Return impulses on j, (k, 3) N s."""
    return np.stack([rows["x"], rows["y"], rows["z"]], axis=1)


def _units(vectors: FloatArray) -> FloatArray:
    """Return unit vectors, (k, 3); zero vectors stay zero."""
    length = np.sqrt((vectors * vectors).sum(axis=1))[:, None]
    result: FloatArray = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
    return result


# The chain of causes: the strongest path back from the bodies of the question.
MOST_LINKS = 50
_WEAKEST = 0.1  # of the share that led to a body; below it, the body's own motion is the cause
_AT_ONCE = 0.5  # weight of an impact at the same instant as another, since their order is unknown


@dataclass(frozen=True, slots=True)
class Link:
    """An impact by which one body got its velocity from another."""

    step: int
    time: float  # s
    body: int
    by: int
    impulse: float  # N s
    share: float  # of the answer, that passed


def chain_of(cone: Cone, bodies: tuple[int, ...]) -> list[Link]:
    """Return the impacts of the chain, the latest first; none if no impact passed on a tenth of the answer.

    From each body, the chain follows the earlier impact with the largest share of the answer, until the body's own
    motion has a larger share.
    """
    left = list(cone.passages)
    links: list[Link] = []
    current, share = set(bodies), 1.0
    while len(links) < MOST_LINKS:
        chosen: Passage | None = None
        link: Link | None = None  # by the passage with the largest share
        for p in left:
            for body, by, passed in ((p.i, p.j, p.to_i), (p.j, p.i, p.to_j)):
                if body in current and passed > (link.share if link else 0.0):
                    chosen, link = p, Link(p.step, p.time, body, by, p.impulse, passed)
        least = _AT_ONCE if links and link and link.time == links[-1].time else _WEAKEST
        if link is None or link.share < least * share:
            break
        links.append(link)
        current, share = {link.by}, link.share
        left = [passage for passage in left if passage.time <= link.time and passage is not chosen]
    return links
