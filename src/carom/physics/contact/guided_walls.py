"""Guided walls: planes with one degree of freedom, which contacts move.

Such a plane has a mass M and moves along its normal N only. It has a row among the ends of contacts with the inverse
mass 1/M, so the contact solver moves it like a body. Only two things differ: it takes the component of an impulse along
N, and the effective mass of friction does not contain M,

    Δu = J·N / M,    K_n = 1/m + 1/M,    K_t = 1/m + ρ²/I

The correction of overlaps moves it, too. Its load and its motion are a part of the model that can be removed, such as
that of a piston (`piston_motion`): the part returns a `GuidedPlane` for a scene, whose motion extends
`WallTranslation`. Records of bodies have the fields of a guide only in scenes with such a plane; see `moving_walls`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from carom.arrays import FloatArray, Records
from carom.physics.jit.decorators import chosen_by_type
from carom.physics.vector import Vector

if TYPE_CHECKING:
    from carom.physics.bodies import Ends
    from carom.physics.contact.translating_walls import WallTranslation
    from carom.scene.schema.motion import WallMotion


class GuidedPlane(Protocol):
    """A plane that contacts move along its normal."""

    @property
    def row(self) -> int:
        """Its number among the solids."""
        ...

    @property
    def normal(self) -> FloatArray:
        """The normal, (3,)."""
        ...

    @property
    def acceleration(self) -> float:
        """The acceleration along the normal in m/s², but for contacts."""
        ...

    def motion(
        self, records: Records, before: Records, ends: Ends, motions: Sequence[WallMotion | None], smallest: float
    ) -> WallTranslation:
        """Return what moves it, and the walls with a prescribed motion, through the phases of a step.

        ``smallest`` is the radius of the smallest body in m; the other parameters are those of `WallTranslation`.
        """
        ...


class Guide(Protocol):
    """Fields of bodies in a scene with a guided wall."""

    axis_x: float  # the axis along which the wall moves; 0 for bodies, which move freely
    axis_y: float
    axis_z: float


def is_guided(body: object) -> bool:
    """Return whether bodies have the fields of a guide; a constant in compiled kernels."""
    raise NotImplementedError("only kernels call it")


def along_guide(body: object, Jx: float, Jy: float, Jz: float) -> Vector:
    """Return the part of an impulse (N s) that changes the velocity of a body: along the axis of a guided wall."""
    raise NotImplementedError("only kernels call it")


def tangent_inverse_mass(Kn: float, a: object, b: object) -> float:
    """Return the inverse effective mass (1/kg) of a tangential impulse without spins, given that of a normal one."""
    raise NotImplementedError("only kernels call it")


def pushed_rise(guided: object, pushed: object, normal: Vector) -> float:
    """Return how far (m) the correction of positions has moved a plane along a normal; 0 if it is not guided."""
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
    return _rise_of_guided


def _projected(body: Any, Jx: float, Jy: float, Jz: float) -> Vector:
    x, y, z = body.axis_x, body.axis_y, body.axis_z
    if x == 0.0 and y == 0.0 and z == 0.0:
        return Jx, Jy, Jz
    J = Jx * x + Jy * y + Jz * z
    return J * x, J * y, J * z


def _rise_of_guided(guided: Any, pushed: Any, normal: Vector) -> float:
    if guided.axis_x == 0.0 and guided.axis_y == 0.0 and guided.axis_z == 0.0:
        return 0.0
    x, y, z = normal
    rise: float = x * pushed.x + y * pushed.y + z * pushed.z
    return rise
