"""A piston: a plane with a mass M that moves along its normal N only, under a constant force and gravity.

Contacts move a piston like any guided wall (`guided_walls`). Kicks change its velocity u by a h, with a = F/M + g·N.
Drifts change its displacement s along N by r(dt): by u dt, and by the changes due to impacts at their own times.

The bodies give the piston the energy ½ M u² - M a s, whose change the ledger books in the entry for walls. The impulse
of the bodies on its face, which a load cell there would measure, is

    ∫ P dt = M a t - M Δu
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from carom.arrays import FloatArray, Records
from carom.physics.contact.guided_walls import GUIDE
from carom.physics.contact.translating_walls import WallTranslation
from carom.plan.auto import timing
from carom.scene.load import Scene
from carom.scene.scene_model import piston_force, piston_of
from carom.scene.schema.motion import WallMotion

if TYPE_CHECKING:
    from carom.physics.bodies import Ends

_AXES = ("x", "y", "z")
MOST_MOVED = 0.1  # piston's displacement in a step, in smallest radii, if impacts are up to one step late
MOST_FALLEN = 0.01  # piston's displacement from rest by its acceleration in a step, in smallest radii


class PistonPlane(NamedTuple):
    """The piston of a scene."""

    row: int  # number of the piston among the solids
    normal: FloatArray  # (3,)
    mass: float  # kg
    acceleration: float  # m/s², acceleration a along the normal
    velocity: float  # m/s, at the start
    late: bool  # whether impacts are resolved at the end of a step

    @classmethod
    def of(cls, scene: Scene, normals: FloatArray) -> PistonPlane:
        """Return the piston of a scene that has one, given the normals of its planes."""
        found = piston_of(scene)
        assert found is not None, "the scene has a piston"
        row, section = found
        normal = normals[row]
        gravity = sum(float(g) * float(along) for g, along in zip(scene.gravity.uniform, normal, strict=True))
        late, acceleration = timing(scene) == "end-of-step", piston_force(scene) / section.mass + gravity
        return cls(row, normal, section.mass, acceleration, section.velocity, late)

    def motion(
        self, records: Records, before: Records, ends: Ends, motions: Sequence[WallMotion | None], smallest: float
    ) -> PistonMotion:
        """Return the motion of the piston, and of walls with a prescribed motion; see `PistonMotion`."""
        return PistonMotion(records, before, ends, motions, self, smallest)


class PistonMotion(WallTranslation):
    """Moves the piston of a scene through the phases of a step, and walls with a prescribed motion, if there are any.

    ``smallest`` is the radius of the smallest body in m.
    """

    def __init__(
        self,
        records: Records,
        before: Records,
        ends: Ends,
        motions: Sequence[WallMotion | None],
        piston: PistonPlane,
        smallest: float,
    ) -> None:
        self._piston, self._smallest = piston, smallest
        self._drift = self._booked = 0.0  # s, length of the step, and of its first kick
        # displacement in m, velocity in m/s, and impulse in N s by the bodies since the start
        self.state = np.array([0.0, piston.velocity, 0.0])
        self._begun_state = self.state.copy()
        ends.inverse_mass[len(ends.velocity) - len(records) + piston.row] = 1.0 / piston.mass
        super().__init__(records, before, ends, motions)

    def forget(self) -> None:
        """Return to the start of the run."""
        self.recall(np.array([0.0, self._piston.velocity, 0.0]))

    @property
    def memory(self) -> FloatArray:
        """A copy of `state`."""
        return self.state.copy()

    def recall(self, state: FloatArray) -> None:
        """Return to an earlier `state`."""
        self.state[:] = state
        self._write()

    @property
    def longest_step(self) -> float:
        """The longest step (s) in which the piston moves by less than the bodies resolve; infinite at rest."""
        a, u = abs(self._piston.acceleration), abs(float(self.state[1]))
        reach, fall = MOST_MOVED * self._smallest, MOST_FALLEN * self._smallest
        longest = float(np.sqrt(2.0 * fall / a)) if a > 0.0 else np.inf
        if self._piston.late and (a > 0.0 or u > 0.0):
            longest = min(longest, float(2.0 * reach / (u + np.sqrt(u * u + 2.0 * a * reach))))
        return longest

    def place(self, time: float) -> None:
        """Write the place of the piston; see `WallTranslation`."""
        super().place(time)
        self._write()

    def begin(self, before: float, time: float, dt: float, booked: float) -> FloatArray:
        """Kick the piston as the step begins."""
        self._begun_state[:] = self.state
        self._drift, self._booked = dt, booked
        begun = super().begin(before, time, dt, booked)
        self._kick(booked)
        self._write()
        return begun

    def begin_drift(self) -> None:
        """Let the piston drift with the velocity that contacts gave it."""
        self._read()
        super().begin_drift()
        piston, half = self._piston, 0.5 * self._drift
        for name, value in zip(GUIDE, (0.0, self.state[1], piston.acceleration, half, 0.0), strict=True):
            self._records[name][piston.row] = value
        self._acceleration[piston.row] = piston.acceleration * piston.normal

    def arrive(self, time: float) -> None:
        """Move the piston to the end of the step."""
        moved = self._records[self._piston.row]
        self.state[1] = moved["guide_speed"]
        self.state[0] += moved["guide_start"] + self.state[1] * self._drift
        self._write()
        super().arrive(time)
        self._write()

    def push(self, distance: float) -> None:
        """Move the piston by a distance along its normal (m), for the correction of overlaps."""
        self.state[0] += distance
        self._write()

    def finish(self, time: float) -> None:
        """Kick the piston at the end of the step."""
        super().finish(time)
        self._kick(self._after)
        self._write()

    def accelerate(self) -> FloatArray:
        """Return the velocities of other walls, whose impulses do the work; see `WallTranslation`."""
        velocity = super().accelerate().copy()
        velocity[self._piston.row] = 0.0
        self._write()
        return velocity

    def settle(self) -> float:
        """Note the velocity after the step; return the work of the piston on the bodies in the step, in J."""
        self._read()
        mass, a = self._piston.mass, self._piston.acceleration
        (s0, u0, _), (s, u, _) = self._begun_state, self.state
        self.state[2] += mass * (u0 + a * (self._booked + self._after) - u)
        return float(mass * (a * (s - s0) - 0.5 * (u - u0) * (u + u0)))

    def rest(self) -> None:
        """Keep the acceleration of the piston, which the correction of overlaps moves."""
        super().rest()
        self._acceleration[self._piston.row] = self._piston.acceleration * self._piston.normal

    def _kick(self, duration: float) -> None:
        self.state[1] += self._piston.acceleration * duration

    def _write(self) -> None:
        """Write the state into the arrays of the solids."""
        row, normal = self._piston.row, self._piston.normal
        for axis, along in zip(_AXES, normal, strict=True):
            self._records[f"motion_origin_{axis}"][row] = self._records[f"motion_shift_{axis}"][row] = (
                self.state[0] * along
            )
        self._velocity[row] = self.state[1] * normal
        self._acceleration[row] = self._piston.acceleration * normal

    def _read(self) -> None:
        """Read the piston's velocity, which contacts have changed."""
        self.state[1] = float((self._velocity[self._piston.row] * self._piston.normal).sum())
