"""The contacts of a step laid out for the kernels, and the team that works on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    FOUND,
    HOT,
    IMPACTS_ONLY,
    IMPULSE,
    KICK,
    LEDGER,
    MOTION,
    OVERLAP,
    REST,
    SPINS,
    Load,
    Room,
    rows,
)
from carom.physics.contact.meeting import meet
from carom.physics.contact.motion import pack, those_that_touch, unpack
from carom.physics.contact.solver import still_closing
from carom.physics.contact.stabilisation import parts_undone, work_of_pushes
from carom.physics.contact.stages import Stages
from carom.physics.kernel import long_kernel
from carom.physics.team import ALONE, Team
from carom.scene.halfspace import HalfSpaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SOME = 3000  # contacts or bodies that are worth a part of their own
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
        self._hot = Room(HOT), Room(HOT)
        self._cold = Room(COLD)
        self._motion = rows(len(bodies.ends.velocity), MOTION)
        self._flags = np.zeros(5, dtype=np.int64)
        self._flags[SPINS] = friction
        self._numbers = np.zeros(5)

    def lay(self, stages: Stages, keep: FloatArray | None = None) -> None:
        """Lay out contacts, with nothing done to them yet, and find where they meet.

        Parameters
        ----------
        keep
            What `hot` was of an earlier step, if it is still wanted.
        """
        m, bodies, ends, planes = len(stages.pairs), self._bodies, self._bodies.ends, self._planes
        room = self._hot[1] if keep is not None and self._hot[0].holds(keep) else self._hot[0]
        hot, cold = room.take(m), self._cold.take(m)
        self._team.divide(m, SOME, _clear, hot, cold)
        who = those_that_touch(stages.pairs, len(self._motion))
        self.stages = stages
        self._load = Load(
            pairs=stages.pairs,
            pieces=stages.pieces,
            hot=hot,
            cold=cold,
            position=bodies.position,
            velocity=ends.velocity,
            acceleration=ends.acceleration,
            inverse_mass=ends.inverse_mass,
            radius=ends.radius,
            box=self._box,
            surface=planes.normal,
            offset=planes.offset,
            motion=self._motion,
            law=self._law,
            who=who,
            found=np.empty((len(stages.pieces), 3)),
            sums=np.empty((-(-len(who) // BLOCK), 2)),
            flags=self._flags,
            numbers=self._numbers,
        )
        self.meet()
        self._load.cold[:, FOUND] = np.maximum(self.overlaps, 0.0)

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
        """(m,) m/s: the speed at which each contact closed when it was first visited."""
        return self._load.cold[:, APPROACH]

    @property
    def apart(self) -> FloatArray:
        """(m,) 1 where a contact was only near when it was found, else 0."""
        return self._load.cold[:, APART]

    @property
    def ledger(self) -> FloatArray:
        """(m, 3) J: what left by restitution and by friction, what stabilisation put in."""
        return self._load.cold[:, LEDGER : LEDGER + 3]

    @property
    def pressing(self) -> NDArray[np.bool_]:
        """(m,) whether each contact carried an impulse when it was last held."""
        return self._load.hot[:, IMPULSE] > 0.0

    def meet(self) -> None:
        """Find the geometry of the contacts at the present positions."""
        bodies, planes, load = self._bodies, self._planes, self._load
        self._team.divide(
            len(load.pairs),
            SOME,
            meet,
            load.pairs,
            bodies.position,
            bodies.radius,
            self._box,
            planes.normal,
            planes.offset,
            load.hot,
            load.cold,
        )

    def part(self, most_sweeps: int) -> None:
        """Push contacts at rest apart, in sweeps, so many at most."""
        ends, load = self._bodies.ends, self._load
        parts_undone(load.pairs, np.empty(len(ends.inverse_mass), dtype=np.int64), load.cold)
        self._work(PUSHES, most_sweeps)

    def book_pushes(self) -> None:
        """Book the work of the pushes, at the accelerations that follow them."""
        ends, load = self._bodies.ends, self._load
        work_of_pushes(load.pairs, ends.acceleration, ends.inverse_mass, load.cold)

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
        return self._lead(IMPACTS, most_sweeps)

    def hold(self, dt: float, kick: float, drift: float, bias_rate: float, most_sweeps: int) -> int:
        """Find the impulses of contacts at rest after a kick, beginning with those in ``hot``; return the sweeps.

        Parameters
        ----------
        dt, kick
            s; the step, and how long the kick was.
        drift
            s; the drift to come, 0 after the last kick.
        bias_rate
            1/s.
        """
        numbers = self._numbers
        numbers[DT], numbers[KICK], numbers[DRIFT], numbers[BIAS] = dt, kick, drift, bias_rate
        return self._lead(HOLDING, most_sweeps)

    def is_closing(self) -> bool:
        """Tell whether a contact closes faster than one at rest after the sweeps: there were too few of them."""
        load = self._load
        return still_closing(load.pairs, load.hot, load.cold, self._bodies.ends.velocity)

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
        board = self._team.gather(work, HELP, edges, independent, load, 0) if shared else ALONE
        return work(board, job, edges, independent, load, most_sweeps)


@long_kernel
def _clear(lo: int, hi: int, hot: FloatArray, cold: FloatArray) -> None:
    for c in range(lo, hi):
        for k in range(HOT):
            hot[c, k] = 0.0
        for k in range(COLD):
            cold[c, k] = 0.0
