"""Pistons: planes, each with a mass M, that move along their normals N only, under constant loads and gravity.

Contacts move pistons like any other guided wall (`guided_walls`). A kick of length h changes the velocity u of a piston
by a·h, with the acceleration a = F/M + g·N. A drift changes its displacement s along N by r(dt), which includes the
impacts at their own times.

The bodies give the piston the energy ½ M u² - M a s, whose change the ledger books in the entry for walls. A load cell
on the piston's face would measure the impulse of the bodies on it, which is

    ∫ P dt = M Σ a dt - M Δu

A pressure acts on the face between the other planes, some of which may be pistons. F is therefore computed from the
expected displacements of all pistons in the middle of a step, and is constant within the step. If a piston has a
largest speed, its load accelerates it to this speed at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from carom.arrays import FloatArray, Records
from carom.errors import PhysicsError
from carom.physics.contact.guided_walls import GUIDE
from carom.physics.contact.translating_walls import WallTranslation
from carom.plan.auto import timing
from carom.scene.load import Scene
from carom.scene.pistons import pistons_of, sides_of_face
from carom.scene.schema.motion import WallMotion

if TYPE_CHECKING:
    from carom.physics.bodies import Ends

_AXES = ("x", "y", "z")
MOST_MOVED = 0.1  # largest displacement of a piston in a step, in smallest radii, if impacts are resolved at the end
MOST_FALLEN = 0.01  # largest displacement of a piston from rest by its acceleration in a step, in smallest radii


class PistonPlanes:
    """The k pistons of a scene, given the normals of its planes."""

    def __init__(self, scene: Scene, normals: FloatArray) -> None:
        sections = pistons_of(scene)
        self.rows = np.array(list(sections), dtype=np.int64)  # numbers of the pistons among the solids
        self.normals = normals[self.rows]  # (k, 3)
        self.mass = np.array([section.mass for section in sections.values()])  # kg
        self.velocity = np.array([section.velocity for section in sections.values()])  # m/s, velocities at the start
        self.fastest = np.array([section.max_speed or np.inf for section in sections.values()])  # m/s
        self.late = timing(scene) == "end-of-step"  # whether impacts are resolved at the end of a step
        self._gravity = np.array(
            [
                sum(float(g) * float(along) for g, along in zip(scene.gravity.uniform, normal, strict=True))
                for normal in self.normals
            ]
        )  # m/s², gravity along the normals
        self._force = np.array([section.force or 0.0 for section in sections.values()])  # N
        self._pressure = np.array([section.pressure or 0.0 for section in sections.values()])  # Pa
        # the sides of the face of each piston with a pressure, (k, 2) m, and which pistons shorten each side, (k, 2, k)
        self._sides, self._shortens = np.zeros((len(sections), 2)), np.zeros((len(sections), 2, len(sections)))
        for row, (plane, section) in enumerate(sections.items()):
            for side, (length, moved_by) in enumerate(sides_of_face(scene, plane) if section.pressure else ()):
                self._sides[row, side] = length
                self._shortens[row, side] = np.isin(self.rows, moved_by)
        self.acceleration = self.loaded(np.zeros(len(sections)))  # m/s², (k,), a of the present step

    @property
    def largest_acceleration(self) -> float:
        """The largest acceleration of a piston along its normal in m/s², without contacts."""
        return float(np.abs(self.acceleration).max())

    def loaded(self, displacement: FloatArray) -> FloatArray:
        """Return the accelerations by loads and gravity, (k,) m/s², given the displacements of all pistons, (k,) m."""
        sides = np.maximum(self._sides - (self._shortens * displacement).sum(axis=2), 0.0)
        force = self._force + self._pressure * sides[:, 0] * sides[:, 1]
        return np.asarray(force / self.mass + self._gravity)

    def limited(self, velocity: FloatArray, duration: float) -> FloatArray:
        """Return the accelerations of pistons, (k,) m/s², given their velocities, (k,) m/s, and the step's length in s.

        A load stops accelerating a piston at its largest speed.
        """
        left = (self.fastest - np.sign(self.acceleration) * velocity) / duration
        return np.asarray(np.sign(self.acceleration) * np.clip(left, 0.0, np.abs(self.acceleration)))

    def motion(
        self, records: Records, before: Records, ends: Ends, motions: Sequence[WallMotion | None], smallest: float
    ) -> PistonMotion:
        """Return the object that moves the pistons and walls with a prescribed motion; see `PistonMotion`."""
        return PistonMotion(records, before, ends, motions, self, smallest)


class PistonMotion(WallTranslation):
    """Moves the pistons of a scene through the phases of a step, and walls with a prescribed motion, if there are any.

    ``smallest`` is the radius of the smallest body in m.
    """

    def __init__(
        self,
        records: Records,
        before: Records,
        ends: Ends,
        motions: Sequence[WallMotion | None],
        pistons: PistonPlanes,
        smallest: float,
    ) -> None:
        self._pistons, self._smallest, self._rows = pistons, smallest, pistons.rows
        self._drift = self._booked = 0.0  # s, lengths of the step and of its first kick
        # (k, 3): displacement in m, velocity in m/s, and the impulse of the bodies since the start in N s
        self.state = self._at_start
        self._begun_state = self.state.copy()
        ends.inverse_mass[len(ends.velocity) - len(records) + self._rows] = 1.0 / pistons.mass
        super().__init__(records, before, ends, motions)

    def forget(self) -> None:
        """Return to the start of the run."""
        self.recall(self._at_start)

    @property
    def memory(self) -> FloatArray:
        """A copy of `state`."""
        return self.state.copy()

    def recall(self, state: FloatArray) -> None:
        """Return to an earlier `state`. Raises PhysicsError if it belongs to other pistons."""
        if state.shape != self.state.shape:
            raise PhysicsError("the checkpoint does not state where the pistons of the scene are")
        self.state[:] = state
        self._load()

    @property
    def longest_step(self) -> float:
        """The longest step (s) in which pistons move by at most `MOST_MOVED` or `MOST_FALLEN`; infinite at rest."""
        a, u = np.abs(self._pistons.acceleration), np.abs(self.state[:, 1])
        reach, fall = MOST_MOVED * self._smallest, MOST_FALLEN * self._smallest
        with np.errstate(divide="ignore"):
            longest = np.sqrt(2.0 * fall / a)
            if self._pistons.late:
                longest = np.minimum(longest, 2.0 * reach / (u + np.sqrt(u * u + 2.0 * a * reach)))
        return float(longest.min())

    def place(self, time: float) -> None:
        """Write the places of the pistons; see `WallTranslation`."""
        super().place(time)
        self._write()

    def begin(self, before: float, time: float, dt: float, booked: float) -> FloatArray:
        """Kick the pistons as the step begins."""
        self._begun_state[:] = self.state
        self._drift, self._booked = dt, booked
        begun = super().begin(before, time, dt, booked)
        middle = self.state[:, 0] + 0.5 * dt * self.state[:, 1]  # displacements expected in the middle of the step
        self._pistons.acceleration = self._pistons.loaded(middle)
        self._pistons.acceleration = self._pistons.limited(self.state[:, 1], dt)
        self._kick(booked)
        self._write()
        return begun

    def begin_drift(self) -> None:
        """Let the pistons drift with the velocities that contacts gave them."""
        self._read()
        super().begin_drift()
        half = 0.5 * self._drift
        for name, value in zip(GUIDE, (0.0, self.state[:, 1], self._pistons.acceleration, half, 0.0), strict=True):
            self._records[name][self._rows] = value
        self._accelerate()

    def arrive(self, time: float) -> None:
        """Move the pistons to the end of the step."""
        moved = self._records[self._rows]
        self.state[:, 1] = moved["guide_speed"]
        self.state[:, 0] += moved["guide_start"] + self.state[:, 1] * self._drift
        self._write()
        super().arrive(time)
        self._write()

    def push(self, distances: FloatArray) -> None:
        """Move the pistons along their normals by ``distances``, (k,) m, to correct overlaps."""
        self.state[:, 0] += distances
        self._write()

    def finish(self, time: float) -> None:
        """Kick the pistons at the end of the step."""
        super().finish(time)
        self._kick(self._after)
        self._write()

    def accelerate(self) -> FloatArray:
        """Return the velocities of the other walls, for the work of impulses on them; see `WallTranslation`."""
        velocity = super().accelerate().copy()
        velocity[self._rows] = 0.0
        self._write()
        return velocity

    def settle(self) -> float:
        """Note the velocities after the step; return the work of the pistons on the bodies in the step, in J."""
        self._read()
        mass, a = self._pistons.mass, self._pistons.acceleration
        (s0, u0, _), (s, u, _) = self._begun_state.T, self.state.T
        self.state[:, 2] += mass * (u0 + a * (self._booked + self._after) - u)
        work = mass * (a * (s - s0) - 0.5 * (u - u0) * (u + u0))
        self._load()
        return float(work.sum())

    def rest(self) -> None:
        """Keep the accelerations of the pistons: the correction of overlaps moves pistons, too."""
        super().rest()
        self._accelerate()

    @property
    def _at_start(self) -> FloatArray:
        rest = np.zeros_like(self._pistons.velocity)
        return np.stack([rest, self._pistons.velocity, rest], axis=1)

    def _kick(self, duration: float) -> None:
        self.state[:, 1] += self._pistons.acceleration * duration

    def _load(self) -> None:
        """Compute the loads on the pistons at their present places, for the next step."""
        self._pistons.acceleration = self._pistons.loaded(self.state[:, 0])
        self._write()

    def _write(self) -> None:
        """Write the state into the arrays of the solids."""
        for axis, along in zip(_AXES, self._pistons.normals.T, strict=True):
            shift = self.state[:, 0] * along
            self._records[f"motion_origin_{axis}"][self._rows] = self._records[f"motion_shift_{axis}"][self._rows] = (
                shift
            )
        self._velocity[self._rows] = self.state[:, 1:2] * self._pistons.normals
        self._accelerate()

    def _accelerate(self) -> None:
        self._acceleration[self._rows] = self._pistons.acceleration[:, None] * self._pistons.normals

    def _read(self) -> None:
        """Read the velocities that contacts have changed."""
        self.state[:, 1] = (self._velocity[self._rows] * self._pistons.normals).sum(axis=1)
