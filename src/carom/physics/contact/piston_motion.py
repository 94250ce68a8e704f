"""A piston: a plane with a mass M that moves along its normal N only, under a constant force and gravity.

The piston is a body with one degree of freedom, its displacement s along N. It has a row among the ends of contacts
with the inverse mass 1/M, so the contact solver moves it like a body. Only two things differ: it takes the component
of an impulse along N, and the effective mass of friction does not contain M,

    Δu = J·N / M,    K_n = 1/m + 1/M,    K_t = 1/m + ρ²/I

Kicks change its velocity u by a h, with a = F/M + g·N, and drifts its displacement by u dt, as for bodies. Its impacts
are resolved at the end of a step, where it is one of the bodies that meet. Within a drift, each impact of a body with
the piston would change the paths of all others relative to it.

The bodies give it the energy ½ M u² - M a s, whose change the ledger books in its entry for walls. The impulse of the
bodies on its face, which a load cell there would measure, is

    ∫ P dt = M a t - M Δu

Records of bodies have the fields of a guide only in scenes with a piston; see `moving_walls`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, Records
from carom.physics.contact.translating_walls import WallTranslation
from carom.physics.jit.decorators import chosen_by_type
from carom.physics.vector import Vector
from carom.scene.schema import Scene
from carom.scene.schema.motion import WallMotion
from carom.scene.schema.piston import force_of, piston_of

if TYPE_CHECKING:
    from carom.physics.bodies import Ends

_AXES = ("x", "y", "z")
MOST_MOVED = 0.1  # of the smallest radius, by which the piston may move in a step: impacts are late by as much
MOST_FALLEN = 0.01  # of the smallest radius, by which its acceleration may move it from rest in a step


class Guide(Protocol):
    """Fields of bodies in a scene with a piston."""

    axis_x: float  # the axis along which the piston moves; 0 for bodies, which move freely
    axis_y: float
    axis_z: float


class PistonPlane(NamedTuple):
    """The piston of a scene."""

    row: int  # its number among the solids
    normal: FloatArray  # (3,)
    mass: float  # kg
    acceleration: float  # m/s², a, along the normal
    velocity: float  # m/s, at the start

    @classmethod
    def of(cls, scene: Scene, normals: FloatArray) -> PistonPlane | None:
        """Return the piston of a scene, given the normals of its planes; None if it has none."""
        found = piston_of(scene)
        if found is None:
            return None
        row, section = found
        normal = normals[row]
        gravity = sum(float(g) * float(along) for g, along in zip(scene.gravity.uniform, normal, strict=True))
        return cls(row, normal, section.mass, force_of(scene) / section.mass + gravity, section.velocity)


class PistonMotion(WallTranslation):
    """Moves the piston of a scene through the phases of a step, and walls with a prescribed motion, if there are any.

    Parameters
    ----------
    records, before, ends, motions
        As for `WallTranslation`.
    piston
        The piston.
    smallest
        m, radius of the smallest body.

    Attributes
    ----------
    state
        (3,) the displacement in m, the velocity in m/s, and the impulse of the bodies on it since the start in N s.
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
        self._drift = self._booked = 0.0  # s, of the step, and its first kick
        self.state = np.array([0.0, piston.velocity, 0.0])
        self._begun_state = self.state.copy()
        ends.inverse_mass[len(ends.velocity) - len(records) + piston.row] = 1.0 / piston.mass
        super().__init__(records, before, ends, motions)

    def forget(self) -> None:
        """Return to the start of the run."""
        self.recall(np.array([0.0, self._piston.velocity, 0.0]))

    def recall(self, state: FloatArray) -> None:
        """Return to an earlier `state`."""
        self.state[:] = state
        self._write()

    @property
    def longest_step(self) -> float:
        """The longest step (s) in which the piston moves by less than the bodies resolve; infinite at rest."""
        a, u = abs(self._piston.acceleration), abs(float(self.state[1]))
        reach, fall = MOST_MOVED * self._smallest, MOST_FALLEN * self._smallest
        if a == 0.0 and u == 0.0:
            return np.inf
        longest = 2.0 * reach / (u + np.sqrt(u * u + 2.0 * a * reach))
        return float(min(longest, np.sqrt(2.0 * fall / a)) if a > 0.0 else longest)

    def place(self, time: float) -> None:
        """Write where the piston is; see `WallTranslation`."""
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
        """Note the velocity with which contacts let the piston drift."""
        self._read()
        super().begin_drift()

    def arrive(self, time: float) -> None:
        """Move the piston to the end of the step."""
        self.state[0] += self.state[1] * self._drift
        self._write()
        super().arrive(time)
        self._write()

    def push(self, distance: float) -> None:
        """Move the piston by a distance along its normal (m), as the correction of overlaps does."""
        self.state[0] += distance
        self._write()

    def finish(self, time: float) -> None:
        """Kick the piston at the end of the step."""
        super().finish(time)
        self._kick(self._after)
        self._write()

    def accelerate(self) -> FloatArray:
        """Return the velocities of other walls, whose work is that of their impulses; see `WallTranslation`."""
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
        """Read the velocity, which contacts have changed."""
        self.state[1] = float((self._velocity[self._piston.row] * self._piston.normal).sum())


def is_guided(body: object) -> bool:
    """Return whether bodies have the fields of a guide; a constant in compiled kernels."""
    raise NotImplementedError("only kernels call it")


def along_guide(body: object, Jx: float, Jy: float, Jz: float) -> Vector:
    """Return the part of an impulse (N s) that changes the velocity of a body: for a piston, that along its axis."""
    raise NotImplementedError("only kernels call it")


def tangent_inverse_mass(Kn: float, a: object, b: object) -> float:
    """Return the inverse effective mass (1/kg) of a tangential impulse without spins, given that of a normal one."""
    raise NotImplementedError("only kernels call it")


def pushed_rise(guided: object, pushed: object, normal: Vector) -> float:
    """Return how far (m) the correction of positions has moved a plane along a normal; 0 if it is no piston."""
    raise NotImplementedError("only kernels call it")


def _has_guide(body: Any) -> bool:
    return "axis_x" in body.fields


@chosen_by_type(is_guided)
def _is_guided(body: Any) -> Any:
    guided = _has_guide(body)
    return lambda body: guided


@chosen_by_type(along_guide)
def _along_guide(body: Any, Jx: Any, Jy: Any, Jz: Any) -> Any:
    return _projected if _has_guide(body) else lambda body, Jx, Jy, Jz: (Jx, Jy, Jz)


@chosen_by_type(tangent_inverse_mass)
def _tangent_inverse_mass(Kn: Any, a: Any, b: Any) -> Any:
    if not _has_guide(b):
        return lambda Kn, a, b: Kn
    return lambda Kn, a, b: Kn if b.axis_x == b.axis_y == b.axis_z == 0.0 else a.inverse_mass


@chosen_by_type(pushed_rise)
def _pushed_rise(guided: Any, pushed: Any, normal: Any) -> Any:
    if not _has_guide(guided):
        return lambda guided, pushed, normal: 0.0
    return _rise_of_piston


def _projected(body: Any, Jx: float, Jy: float, Jz: float) -> Vector:
    x, y, z = body.axis_x, body.axis_y, body.axis_z
    if x == 0.0 and y == 0.0 and z == 0.0:
        return Jx, Jy, Jz
    J = Jx * x + Jy * y + Jz * z
    return J * x, J * y, J * z


def _rise_of_piston(guided: Any, pushed: Any, normal: Vector) -> float:
    if guided.axis_x == 0.0 and guided.axis_y == 0.0 and guided.axis_z == 0.0:
        return 0.0
    x, y, z = normal
    rise: float = x * pushed.x + y * pushed.y + z * pushed.z
    return rise
