"""`Cone`: goes back through a window, from the bodies asked about to all that could have an effect on them.

Each body carries a share of the answer, 1 in all at the moment asked about. Going back over an instant, the share of a
body divides between what it had, and the impulses that it took, as their sizes are:

    |v⁻| : |J_1|/m : |J_2|/m …

What passes over a contact divides between its ends as their speeds along the impulse before it are, since these are
what the impulse is made of. In an instant in which several bodies touch, it may also come from further impulses on the
other end. A plane gives everything back. Over a step, a body's share divides between its velocity at the beginning and
the change by forces, |v| : |Δv|; the second part has arrived at its cause.

Shares are of sizes: they are between 0 and 1 and do not depend on directions. What could have had an effect at all is
exact: a body belongs to the cone from the moment on, going back, at which it touched one that does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from carom.experiment.why.history import Step

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rows = NDArray[np.void]

_ROUNDS = 16  # bodies that a share passes on through in one instant
_NEGLIGIBLE = 1e-9  # share that is not passed on; change of a velocity that counts as rounding


@dataclass(slots=True)
class Passage:
    """An impact over which a share of the answer passed."""

    step: int
    time: float  # s
    i: int
    j: int
    impulse: float  # N s
    to_i: float  # share of the answer that passed from j to i, and did not come back
    to_j: float


@dataclass(slots=True)
class Edge:
    """All impulses between two ends."""

    i: int
    j: int
    first: float  # s
    last: float  # s
    impulse: float = 0.0  # N s, Σ |J|
    count: int = 0  # impulses
    share: float = 0.0  # of the answer, that passed over it


@dataclass(slots=True)
class Cone:
    """The bodies behind an answer, how much of it is theirs, and the contacts between them.

    Parameters
    ----------
    inverse_mass
        (n + p,) 1/kg.
    shares
        The bodies asked about, and the share of each.
    """

    inverse_mass: FloatArray
    count: int  # of bodies
    shares: FloatArray  # (n,) of the answer, that each body carries at the present moment
    reached: NDArray[np.bool_]  # (n,) whether it could have had an effect
    since: FloatArray  # (n,) s, the last moment at which it could; NaN for bodies outside
    from_forces: FloatArray  # (n,) share that forces on each body gave
    edges: dict[tuple[int, int], Edge] = field(default_factory=dict)
    passages: list[Passage] = field(default_factory=list)  # the latest first
    pairs: list[IntArray] = field(default_factory=list)  # (k, 2) bodies each, all that touched so far

    @classmethod
    def of(cls, inverse_mass: FloatArray, count: int, shares: dict[int, float], time: float) -> Cone:
        """Begin at a moment in s."""
        carried, since = np.zeros(count), np.full(count, np.nan)
        for body, share in shares.items():
            carried[body], since[body] = share, time
        return cls(inverse_mass, count, carried, ~np.isnan(since), since, np.zeros(count))

    def take(self, step: Step, rows: Rows, velocity: FloatArray, kicked: bool) -> None:
        """Go back over a step, or its beginning.

        Parameters
        ----------
        rows
            Its impulses up to the moment, in order.
        velocity
            (n, 3) m/s, right after the last of them; changed.
        kicked
            Whether forces act.
        """
        between = rows["j"] < self.count
        self.pairs.append(np.stack([rows["i"][between], rows["j"][between]], axis=1))
        end = len(rows)
        while end > 0:
            begin = end - 1
            while begin > 0 and rows["instant"][begin - 1] == rows["instant"][end - 1]:
                begin -= 1
            self._instant(rows[begin:end], velocity)
            end = begin
        if kicked:
            self._forces(step, velocity)

    def reach(self, rows: Rows) -> Rows:
        """Add the bodies that touch one of the cone in an instant, directly or not; return its rows of the cone."""
        known = np.append(self.reached, np.zeros(len(self.inverse_mass) - self.count, dtype=bool))
        i, j = rows["i"], rows["j"]
        while True:
            own = known[i] | known[j]
            new = np.unique(np.concatenate((i[own], j[own])))
            new = new[(new < self.count) & (self.inverse_mass[new] > 0.0)]
            new = new[~known[new]]
            if not len(new):
                break
            known[new] = self.reached[new] = True
            self.since[new] = rows["time"][0]
        inside: Rows = rows[own]
        return inside

    def closed(self) -> NDArray[np.bool_]:
        """Return which bodies touched one of the cone before the moment, directly or not, (n,).

        A body outside the cone can still matter, if it kept one of the cone from touching another. The others cannot.
        """
        pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *self.pairs])
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(self.count, self.count))
        _, label = connected_components(graph, directed=False)
        inside: NDArray[np.bool_] = np.isin(label, label[self.reached])
        return inside

    def _instant(self, rows: Rows, velocity: FloatArray) -> None:
        """Go back over the impulses of one instant."""
        own = self.reach(rows) if len(rows) > 1 else self._reach_one(rows)
        for holds in (True, False):  # at the end of a step contacts are held last
            some = own[own["holds"] == holds]
            some = some[(some["x"] != 0.0) | (some["y"] != 0.0) | (some["z"] != 0.0)]
            if len(some):
                self._pass(some, velocity, holds)

    def _reach_one(self, rows: Rows) -> Rows:
        i, j = int(rows["i"][0]), int(rows["j"][0])
        body = j < self.count
        if not (self.reached[i] or (body and self.reached[j])):
            return rows[:0]
        for end in (i, j) if body else (i,):
            if not self.reached[end] and self.inverse_mass[end] > 0.0:
                self.reached[end], self.since[end] = True, rows["time"][0]
        return rows

    def _pass(self, rows: Rows, velocity: FloatArray, holds: bool) -> None:
        """Undo impulses that act together, and pass the shares on."""
        n, m = self.count, len(rows)
        i, j = rows["i"], rows["j"]
        J = np.stack([rows["x"], rows["y"], rows["z"]], axis=1)
        size = np.sqrt((J * J).sum(axis=1))
        body = j < n
        np.add.at(velocity, i, self.inverse_mass[i, None] * J)
        np.subtract.at(velocity, j[body], self.inverse_mass[j[body], None] * J[body])
        normal = J / size[:, None]
        # each impulse twice: as taken by i from j, and by j from i
        to, origin = np.concatenate((i, j)), np.concatenate((j, i))
        taken: FloatArray = np.concatenate((size, size)) * self.inverse_mass[to]
        along: FloatArray = np.zeros(2 * m)  # m/s, speed of the taker along the impulse, before it
        moves = to < n
        along[moves] = np.abs((velocity[to[moves]] * np.concatenate((normal, normal))[moves]).sum(axis=1))
        opposite = np.concatenate((np.arange(m, 2 * m), np.arange(m)))
        total = np.bincount(to, weights=taken, minlength=len(self.inverse_mass)).astype(np.float64)
        flow = self._leave(to, taken, total, velocity)
        passed, back_again = np.zeros(2 * m), np.zeros(2 * m)
        for _ in range(1 if holds else _ROUNDS):
            passed += flow
            own, back = along[opposite], along
            further = np.zeros(2 * m) if holds else np.maximum(0.0, total[origin] - taken[opposite])
            further[(origin >= n) | (further <= _NEGLIGIBLE * total[origin])] = 0.0
            own = np.where((origin < n) & (self.inverse_mass[origin] > 0.0), own, 0.0)
            whole = own + back + further
            scale = np.divide(flow, whole, out=np.zeros(2 * m), where=whole > 0.0)
            stays = np.where(whole > 0.0, own * scale, np.where(self._is_free(origin), flow, 0.0))
            returns = np.where(whole > 0.0, back * scale, np.where(self._is_free(origin), 0.0, flow))
            self._arrive(origin, stays)
            self._arrive(to, returns)
            back_again += returns
            onward = further * scale
            if onward.sum() < _NEGLIGIBLE:
                break
            flow = self._onward(to, origin, taken, total, onward, opposite)
        else:
            self._arrive(origin, flow)
        self._note(rows, size, passed, passed - back_again, holds)

    def _is_free(self, ends: IntArray) -> NDArray[np.bool_]:
        return (ends < self.count) & (self.inverse_mass[ends] > 0.0)

    def _leave(self, to: IntArray, taken: FloatArray, total: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return what leaves each taker over each of its impulses, and take it from the shares."""
        n = self.count
        takers = np.unique(to[to < n])
        kept = np.sqrt((velocity[takers] ** 2).sum(axis=1))
        whole = kept + total[takers]
        part = np.zeros(len(self.inverse_mass))
        part[takers] = np.divide(self.shares[takers], whole, out=np.zeros(len(takers)), where=whole > 0.0)
        self.shares[takers] -= part[takers] * total[takers]
        leaving: FloatArray = taken * part[to]
        return leaving

    def _onward(
        self,
        to: IntArray,
        origin: IntArray,
        taken: FloatArray,
        total: FloatArray,
        onward: FloatArray,
        opposite: NDArray[np.integer],
    ) -> FloatArray:
        """Divide what goes on through the other ends among their further impulses, not back over the same."""
        others = np.maximum(total[origin] - taken[opposite], 0.0)
        rate = np.divide(onward, others, out=np.zeros(len(onward)), where=others > 0.0)
        arriving = np.bincount(origin, weights=rate, minlength=len(total))  # per unit of impulse, at each end
        flow: FloatArray = np.maximum(0.0, taken * (arriving[to] - rate[opposite]))
        return flow

    def _arrive(self, ends: IntArray, parts: FloatArray) -> None:
        bodies = ends < self.count
        np.add.at(self.shares, ends[bodies], parts[bodies])

    def _note(self, rows: Rows, size: FloatArray, passed: FloatArray, kept: FloatArray, holds: bool) -> None:
        m = len(rows)
        for k, row in enumerate(rows):
            i, j, time = int(row["i"]), int(row["j"]), float(row["time"])
            edge = self.edges.get((i, j))
            if edge is None:
                edge = self.edges[i, j] = Edge(i, j, time, time)
            edge.first = time
            edge.impulse += float(size[k])
            edge.count += 1
            edge.share += float(passed[k] + passed[m + k])
            to_i, to_j = float(kept[k]), float(kept[m + k])
            if not holds and max(to_i, to_j) > _NEGLIGIBLE:
                self.passages.append(Passage(int(row["step"]), time, i, j, float(size[k]), to_i, to_j))

    def _forces(self, step: Step, velocity: FloatArray) -> None:
        """Give forces their part of the shares; what is left of the velocities are those at the step's beginning."""
        own = np.flatnonzero(self.shares > _NEGLIGIBLE)
        change = np.sqrt(((velocity[own] - step.before[own]) ** 2).sum(axis=1))
        had = np.sqrt((step.before[own] ** 2).sum(axis=1))
        change[change < _NEGLIGIBLE * had] = 0.0
        whole = change + had
        part = np.divide(change, whole, out=np.zeros(len(own)), where=whole > 0.0)
        given = self.shares[own] * part
        self.from_forces[own] += given
        self.shares[own] -= given
