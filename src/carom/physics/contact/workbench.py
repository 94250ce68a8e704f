"""The contacts of a step laid out for the kernels, and the team that works on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.aligned import Room, aligned_empty
from carom.physics.bodies import Bodies
from carom.physics.contact.crew import HELP, HOLDING, IMPACTS, PUSHES, work
from carom.physics.contact.load import (
    APART,
    APPROACH,
    BIAS,
    BLOCK,
    COLD,
    DRIFT,
    DT,
    FASTEST,
    FOUND,
    HOT,
    IMPACTS_ONLY,
    IMPULSE,
    KICK,
    LEDGER,
    MOTION,
    OVERLAP,
    REFINES,
    REST,
    RESTING,
    SEARCH,
    SPINS,
    Load,
)
from carom.physics.contact.meeting import meet
from carom.physics.contact.motion import pack, those_that_touch, unpack
from carom.physics.contact.rest import Piles
from carom.physics.contact.solver import CONVERGED, look_for_closing
from carom.physics.contact.stabilisation import count_crowds, parts_undone, work_of_pushes
from carom.physics.contact.stages import Stages, stages_of
from carom.physics.contact.tally import Tally
from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.thread_team import ALONE, Team
from carom.scene.halfspace import HalfSpaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SOME = 1000  # contacts or bodies that are worth a part of their own
TOUCHING = 1e-9  # of the sum of radii; what is so near touches: the sweeps and rounding leave lasting contacts there
CLOSE = 64  # contacts whose rows are in the nearest cache
SHARED_FROM = 4096  # contacts; below, to gather a team costs what it saves


class Workbench:
    """Resolves the contacts of one step after the other.

    Parameters
    ----------
    bodies, planes
        What may touch.
    law
        (1 + p, 3) restitution, static and kinetic friction: between bodies, then of each plane.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    friction
        Whether impulses turn bodies.
    team
        Who works.
    """

    def __init__(
        self, bodies: Bodies, planes: HalfSpaces, law: FloatArray, box: FloatArray, friction: bool, team: Team
    ) -> None:
        self._bodies = bodies
        self._planes = planes
        self._law = law
        self._box = box
        self._spin = bodies.ends.angular_velocity if friction else bodies.ends.angular_velocity[:0]
        self._team = team
        self._hot = Room(columns=HOT), Room(columns=HOT)
        self._cold = Room(columns=COLD)
        self._search = Room(columns=SEARCH)
        self._normals = Room(columns=3)
        self._piles = Piles(len(bodies.ends.velocity), team)
        self.stages = stages_of(np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64))
        self._who = np.zeros(0, dtype=np.int64)  # bodies and planes that touch anything
        self._fastest = 0.0  # m/s, at which a contact closed before the impulses
        self._motion = aligned_empty(len(bodies.ends.velocity), columns=MOTION)
        self._island = np.empty(len(self._motion), dtype=np.int64)
        self._work_of_islands = np.empty((len(self._motion), 2))
        self._flags = np.zeros(6, dtype=np.int64)
        self._flags[SPINS] = friction
        self._numbers = np.zeros(8)

    def lay(self, stages: Stages, keep: FloatArray | None = None, rounding: float = 0.0) -> None:
        """Lay out contacts, with nothing done to them yet, and find where they meet.

        Parameters
        ----------
        keep
            What `hot` was of an earlier step, if it is still wanted.
        rounding
            m, of the coordinates: a gap up to this is none.
        """
        m, bodies, ends, planes = len(stages.pairs), self._bodies, self._bodies.ends, self._planes
        room = self._hot[1] if keep is not None and self._hot[0].holds(keep) else self._hot[0]
        hot, cold = room.take(m), self._cold.take(m)
        if stages is not self.stages:
            self._who = those_that_touch(stages.pairs, len(self._motion), self._team)
        self.stages = stages
        self._load = Load(
            pairs=stages.pairs,
            pieces=stages.pieces,
            hot=hot,
            cold=cold,
            search=self._search.take(m),
            position=bodies.position,
            velocity=ends.velocity,
            spin=self._spin,
            acceleration=ends.acceleration,
            inverse_mass=ends.inverse_mass,
            radius=ends.radius,
            box=self._box,
            surface=planes.normal,
            offset=planes.offset,
            motion=self._motion,
            law=self._law,
            island=self._island,
            work=self._work_of_islands,
            who=self._who,
            found=np.empty((len(stages.pieces), 3)),
            sums=np.empty((-(-len(self._who) // BLOCK), 2)),
            flags=self._flags,
            numbers=self._numbers,
        )
        self.found_normals = self._normals.take(m)
        self._team.divide(m, SOME, _lay, *self._geometry(), rounding, self.found_normals)

    @property
    def hot(self) -> FloatArray:
        """(m, 16), by place like what follows: see `Load`."""
        return self._load.hot

    @property
    def cold(self) -> FloatArray:
        """(m, 16), likewise."""
        return self._load.cold

    @property
    def normals(self) -> FloatArray:
        """(m, 3), from i to j."""
        return self._load.hot[:, :3]

    @property
    def arms(self) -> FloatArray:
        """(m, 2) m, from each end's centre to the contact point."""
        return self._load.hot[:, 3:5]

    @property
    def overlaps(self) -> FloatArray:
        """(m,) m; minus the gap where there is one."""
        return self._load.cold[:, OVERLAP]

    @property
    def rest_speed(self) -> FloatArray:
        """(m,) m/s; an approach up to this speed is a contact at rest and does not bounce."""
        return self._load.cold[:, REST]

    @property
    def approach(self) -> FloatArray:
        """(m,) m/s: the speed at which each contact closed when it was first visited, or faster when it was struck."""
        return self._load.cold[:, APPROACH]

    @property
    def found_overlaps(self) -> FloatArray:
        """(m,) m, as the contacts were found, before any push, like ``found_normals``, (m, 3); 0 where there is a gap.

        What touched then is resolved though a push opens it, or it falls and is pushed back for ever.
        """
        return self._load.cold[:, FOUND]

    @property
    def ledger(self) -> FloatArray:
        """(m, 3) J: what left by restitution and by friction, what stabilisation put in."""
        return self._load.cold[:, LEDGER : LEDGER + 3]

    @property
    def booked(self) -> FloatArray:
        """(k, 3) J: what holding the contacts last booked into the ledger, in sums over pieces."""
        return self._load.found

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(m,) whether each contact touched when it was found, or carried an impulse when it was last held."""
        touches: NDArray[np.bool_] = self._load.cold[:, APART] == 0.0
        return touches | (self._load.hot[:, IMPULSE] > 0.0)

    def tally(self) -> Tally:
        """Count the contacts that are seen, and what all of them did."""
        return Tally.of(self._load.pairs, self._load.hot, self._load.cold, self._bodies.ends, self._team)

    def meet(self) -> None:
        """Find the geometry of the contacts at the present positions."""
        self._team.divide(len(self._load.pairs), SOME, meet, *self._geometry())

    def find_rest_speeds(self, field: FloatArray, dt: float) -> bool:
        """Find the speed up to which each contact is at rest, see `Piles`; tell whether one is not 0."""
        ends, load = self._bodies.ends, self._load
        accelerated = (ends.acceleration, ends.inverse_mass, field, dt)
        return self._piles.write_rest_speeds(load.pairs, load.who, *accelerated, load.cold)

    def part(self, most_sweeps: int) -> None:
        """Push contacts at rest apart, in sweeps, so many at most."""
        ends, load = self._bodies.ends, self._load
        crowd = np.zeros(len(ends.inverse_mass), dtype=np.int64)
        self._team.divide(len(load.pairs), SOME, count_crowds, load.pairs, crowd)
        self._team.divide(len(load.pairs), SOME, parts_undone, load.pairs, crowd, load.cold)
        self._work(PUSHES, most_sweeps)

    def book_pushes(self) -> None:
        """Book the work of the pushes, at the accelerations that follow them."""
        ends, load = self._bodies.ends, self._load
        self._team.divide(
            len(load.pairs), SOME, work_of_pushes, load.pairs, ends.acceleration, ends.inverse_mass, load.cold
        )

    def resolve_impacts(self, bias_rate: float, most_sweeps: int, impacts_only: bool) -> int:
        """Resolve what closes; return the number of sweeps.

        Parameters
        ----------
        bias_rate
            1/s; separation speed for each metre of overlap (Baumgarte), 0 for none.
        most_sweeps
            Sweeps end when one of them changes next to nothing, or here.
        impacts_only
            Whether contacts at rest are left alone.
        """
        self._numbers[BIAS] = bias_rate
        self._flags[IMPACTS_ONLY] = impacts_only
        sweeps = self._lead(IMPACTS, most_sweeps)
        found = self._load.found
        self._fastest, self.any_rests = float(found[:, FASTEST].max(initial=0.0)), bool(found[:, RESTING].any())
        return sweeps

    def hold(self, dt: float, kick: float, drift: float, bias_rate: float, most_sweeps: int, as_needed: bool) -> int:
        """Find the impulses of contacts at rest after a kick, beginning with those in ``hot``; return the sweeps.

        Parameters
        ----------
        dt, kick
            s; the step, and how long the kick was.
        drift
            s; the drift to come, 0 after the last kick.
        bias_rate
            1/s.
        as_needed
            Whether conjugate gradients follow where the sweeps leave too much.
        """
        numbers = self._numbers
        numbers[DT], numbers[KICK], numbers[DRIFT], numbers[BIAS] = dt, kick, drift, bias_rate
        self._flags[REFINES] = as_needed
        return self._lead(HOLDING, most_sweeps)

    def is_closing(self) -> bool:
        """Tell whether a contact closes faster than one at rest after the sweeps: there were too few of them."""
        load, closing = self._load, np.zeros(1, dtype=np.bool_)
        contacts = (load.pairs, load.hot, load.cold, self._bodies.ends.velocity)
        self._team.divide(len(load.pairs), SOME, look_for_closing, *contacts, CONVERGED * self._fastest, closing)
        return bool(closing[0])

    def _geometry(self) -> tuple[NDArray[Any], ...]:
        bodies, planes, load = self._bodies, self._planes, self._load
        return load.pairs, bodies.position, bodies.radius, self._box, planes.normal, planes.offset, load.hot, load.cold

    def _lead(self, job: int, most_sweeps: int) -> int:
        """Do a job on the motion of those that touch; return the number of sweeps."""
        load, ends, team, b = self._load, self._bodies.ends, self._team, len(self._load.who)
        packed = (load.who, ends.velocity, self._spin, ends.inverse_mass, ends.inverse_inertia, load.motion)
        team.divide(b, SOME, pack, *packed)
        sweeps = self._work(job, most_sweeps)
        team.divide(b, SOME, unpack, load.who, load.motion, ends.velocity, self._spin)
        return sweeps

    def _work(self, job: int, most_sweeps: int) -> int:
        """Do a job, with the team if it is worth it; return the number of sweeps."""
        edges, independent, load = self.stages.edges, self.stages.independent, self._load
        shared = len(load.pairs) >= SHARED_FROM
        if not shared:
            return work(ALONE, job, edges, independent, load, most_sweeps)
        with self._team.gathered(work, HELP, edges, independent, load, 0) as board:
            return work(board, job, edges, independent, load, most_sweeps)


@long_kernel
def _lay(
    lo: int,
    hi: int,
    pairs: IntArray,
    x: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    surface: FloatArray,
    offset: FloatArray,
    hot: FloatArray,
    cold: FloatArray,
    rounding: float,
    normals: FloatArray,
) -> None:
    """Clear the rows of the contacts [lo, hi), find where these meet, and note how they were found."""
    for first in range(lo, hi, CLOSE):
        end = min(hi, first + CLOSE)
        for c in range(first, end):
            for k in range(HOT):
                hot[c, k] = 0.0
            for k in range(COLD):
                cold[c, k] = 0.0
        meet(first, end, pairs, x, radius, box, surface, offset, hot, cold)
        for c in range(first, end):
            for k in range(3):
                normals[c, k] = hot[c, k]
            overlap = cold[c, OVERLAP]
            cold[c, FOUND] = max(0.0, overlap)
            reach = hot[c, 3] + hot[c, 4] + overlap
            cold[c, APART] = 1.0 if overlap < -(TOUCHING * reach + rounding) else 0.0
