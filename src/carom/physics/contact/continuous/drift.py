"""The drift of a step in which impacts happen at their own moments.

Neighbours are searched once a drift, around the start of each body, within what it can reach. A body that an impact
throws farther is a stray: from then on it is looked at together with every other. Rejected: reaches that no impact can
exceed, which make every body a neighbour of every other as soon as one is fast.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.broad_phase.hierarchical_grid import Grid
from carom.physics.contact.broad_phase.search import Search
from carom.physics.contact.continuous.event_loop import (
    AFTER,
    APPROACH,
    COLUMNS,
    LEDGER,
    NORMAL,
    REST,
    TIME,
    foresee,
    resolve,
)
from carom.physics.contact.continuous.event_queue import put
from carom.physics.contact.continuous.trajectories import AHEAD, EXHAUSTED, Paths, arrive, reaches, set_out
from carom.physics.contact.rest import pile_speeds
from carom.physics.integrator import SOME, drift
from carom.physics.parallel.jit import kernel
from carom.physics.parallel.thread_team import Team
from carom.scene.halfspace import HalfSpaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LOGGED = 4096  # impacts that are resolved in one go
WIDEST = 2.0  # times the radii; within that, the grids that find contacts find neighbours, too


@dataclass(frozen=True, slots=True)
class Impacts:
    """The impacts of a drift, in the order of time."""

    pairs: IntArray  # (k, 2), i < j
    time: FloatArray  # (k,) s from the beginning of the drift
    normal: FloatArray  # (k, 3) from i to j
    approach: FloatArray  # (k,) m/s
    rest_speed: FloatArray  # (k,) m/s, up to which each would have been at rest
    ledger: FloatArray  # (k, 3) J
    after: FloatArray  # (k, 2, 3) m/s, velocities of both right after it

    def __len__(self) -> int:
        return len(self.pairs)

    @classmethod
    def of(cls, pairs: IntArray, log: FloatArray) -> Impacts:
        """Read a log."""
        return cls(
            pairs,
            time=log[:, TIME],
            normal=log[:, NORMAL : NORMAL + 3],
            approach=log[:, APPROACH],
            rest_speed=log[:, REST],
            ledger=log[:, LEDGER:AFTER],
            after=log[:, AFTER:COLUMNS].reshape(-1, 2, 3),
        )


NO_IMPACTS = Impacts.of(np.empty((0, 2), dtype=np.int64), np.empty((0, COLUMNS)))


class Flight:
    """Lets bodies drift.

    Parameters
    ----------
    bodies, planes
        What may meet.
    law
        (1 + p, 3) restitution, static and kinetic friction: between bodies, then of each plane.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    field
        (3,) m/s², the uniform field as far as it pulls all alike.
    friction, anchored, forces
        Whether impulses turn bodies, whether something stands still, and whether anything presses contacts together.
    search, team
        What finds contacts, and who works.
    """

    def __init__(
        self,
        bodies: Bodies,
        planes: HalfSpaces,
        law: FloatArray,
        box: FloatArray,
        field: FloatArray,
        friction: bool,
        anchored: bool,
        forces: bool,
        search: Search,
        team: Team,
    ) -> None:
        n, ends = len(bodies), bodies.ends
        spin = slice(None) if friction else slice(0)
        self._bodies, self._field, self._anchored, self._forces = bodies, field, anchored, forces
        self._search, self._team = search, team
        self._pairs = np.empty((LOGGED, 2), dtype=np.int64)
        self._log = np.empty((LOGGED, COLUMNS))
        self._paths = Paths(
            x=bodies.position,
            v=ends.velocity,
            a=ends.acceleration,
            q=bodies.orientation[spin],
            omega=ends.angular_velocity[spin],
            inverse_mass=ends.inverse_mass,
            inverse_inertia=ends.inverse_inertia,
            radius=ends.radius,
            box=box,
            surface=planes.normal,
            offset=planes.offset,
            law=law,
            start=np.empty((n, 3)),
            reach=np.empty(n),
            rest=np.zeros(len(ends.radius)),
            noise=np.zeros(n),
            now=np.empty(n),
            moment=np.empty(n),
            partner=np.zeros(n, dtype=np.int64),
            known=np.zeros(n, dtype=np.int64),
            impacts=np.zeros(n, dtype=np.int64),
            heap=np.empty(n, dtype=np.int64),
            place=np.empty(n, dtype=np.int64),
            strays=np.empty(n, dtype=np.int64),
            everyone=np.arange(n),
            none=np.zeros(n, dtype=np.int64),
            total=np.full(n, n),
            stray_count=np.zeros(n, dtype=np.int64),
            bulk=np.zeros(3),
            numbers=np.zeros(3),
            counts=np.zeros(3, dtype=np.int64),
        )
        self._compile()

    def _compile(self) -> None:
        """Send no impact through every kernel, so that the first real one does not wait for a compiler."""
        nobody, none = np.empty((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
        set_out(self._paths, 1.0, 0.0)
        if self._forces:
            self._press(nobody, 0.0, 1.0, 0.0)
        foresee(0, 0, none, none, none, self._paths)
        _gather(self._paths)
        self._resolve(nobody)
        arrive(0, 0, self._paths)

    @property
    def is_exhausted(self) -> bool:
        """Whether a body had as many impacts in the last drift as are resolved."""
        return bool(self._paths.counts[EXHAUSTED])

    def drift(self, kick: float, dt: float, stretch: float, slack: float) -> Impacts:
        """Move all bodies by their velocities for dt, after a kick, both in s, and resolve the impacts on their way.

        Parameters
        ----------
        stretch, slack
            1 and m: bodies no farther apart than ``(r_i + r_j) stretch + slack`` belong to the same pile.
        """
        paths, bodies, n = self._paths, self._bodies, len(self._bodies)
        paths.counts[:] = 0
        farthest = reaches(bodies.velocity, bodies.mass, bodies.radius, self._anchored, dt, paths.reach, paths.bulk)
        pairs = self._neighbours(farthest, stretch, slack)
        impacts = NO_IMPACTS
        if len(pairs) or len(paths.offset):
            set_out(paths, dt, kick)
            if self._forces:
                self._press(pairs, dt, stretch, slack)
            ends = np.searchsorted(pairs[:, 0], np.arange(n + 1))
            self._team.divide(n, SOME, foresee, ends[:-1], ends[1:], np.ascontiguousarray(pairs[:, 1]), paths)
            if _gather(paths):
                impacts = self._resolve(pairs)
        if len(impacts):
            self._team.divide(n, SOME, arrive, paths)
        else:
            drift(bodies.position, bodies.velocity, dt, self._team)
        return impacts

    def _press(self, pairs: IntArray, dt: float, stretch: float, slack: float) -> None:
        """Find up to which speed contacts of each body are at rest."""
        paths = self._paths
        pile_speeds(
            pairs,
            paths.x,
            paths.radius,
            paths.box,
            stretch,
            slack,
            paths.a,
            paths.inverse_mass,
            self._field,
            dt,
            paths.rest,
        )

    def _neighbours(self, farthest: float, stretch: float, slack: float) -> IntArray:
        """Return the pairs whose reaches meet, given the largest reach in radii; where there is room, widen all."""
        paths, radius = self._paths, self._bodies.radius
        if farthest <= WIDEST - 1.0:
            paths.reach[:] = farthest * radius
            return self._search.pairs(paths.x, stretch * (1.0 + farthest), slack)
        return Grid(radius + paths.reach, paths.box, self._team).pairs(paths.x, stretch, slack)

    def _resolve(self, pairs: IntArray) -> Impacts:
        paths, n = self._paths, len(self._bodies)
        ends, others = np.zeros(n + 1, dtype=np.int64), np.empty(2 * len(pairs), dtype=np.int64)
        _both_ways(pairs, ends, others)
        found: list[IntArray] = []
        logs: list[FloatArray] = []
        again = True
        while again:
            count = resolve(ends[:-1], ends[1:], others, paths, self._pairs, self._log)
            found.append(self._pairs[:count].copy())
            logs.append(self._log[:count].copy())
            again = paths.counts[AHEAD] > 0
        return Impacts.of(np.concatenate(found), np.concatenate(logs))


@kernel
def _gather(paths: Paths) -> int:
    """Put the bodies that have an impact ahead on the agenda; return how many there are."""
    size = 0
    for i in range(len(paths.x)):
        if paths.moment[i] < np.inf:
            size = put(i, size, paths.heap, paths.place, paths.moment, paths.partner)
    paths.counts[AHEAD] = size
    return size


@kernel
def _both_ways(pairs: IntArray, ends: IntArray, others: IntArray) -> None:
    """List the neighbours of each body, i's at ``others[ends[i]:ends[i + 1]]``."""
    for c in range(len(pairs)):
        ends[pairs[c, 0]] += 1
        ends[pairs[c, 1]] += 1
    for i in range(1, len(ends)):
        ends[i] += ends[i - 1]
    for c in range(len(pairs)):
        for end in range(2):
            i = pairs[c, end]
            ends[i] -= 1
            others[ends[i]] = pairs[c, 1 - end]
