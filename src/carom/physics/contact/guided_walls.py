"""Guided walls: planes with one degree of freedom, which contacts move.

A guided plane has a mass M and moves along its normal N only. A guided wall has a row among the ends of contacts, with
the inverse mass 1/M, so the contact solver moves it like a body. Only two things differ from a body: an impulse changes
its velocity along N only, and the effective mass of friction does not contain M,

    Δu = J·N / M,    K_n = 1/m + 1/M,    K_t = 1/m + ρ²/I

The correction of overlaps moves the wall, too. The loads and the motion of guided walls are an optional part, such as
the pistons (`piston_motion`). The part returns the `solid_records.GuidedPlanes` of a scene, whose motion extends
`WallTranslation`. Records of bodies have the fields of a guide only in scenes with such a plane; see `moving_walls`.

**Impacts during a drift.** As for bodies, the velocity u of the drift is the velocity in the middle of the step, and
the path bends with the acceleration a between contacts. At a time τ into a drift of dt, the plane is displaced along N
by

    r(τ) = r₀ + u τ - ½ a τ (dt - τ)

and its velocity is u + a (τ - ½ dt). An impact at τ changes u by Δu and r₀ by -Δu τ. Bodies only push a plane away:
after an impact, it meets no other body sooner than before. Impacts predicted along its earlier paths therefore come too
early, never too late, and each is predicted again when its turn comes. An impact with the plane does not change the
predictions of any other body.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import FloatArray
from carom.physics.jit.decorators import inline, with_field
from carom.physics.vector import Vector

NO_PUSHES: FloatArray = np.zeros(0)  # m, displacements of guided walls in a scene without them
GUIDE = (  # fields of a solid in a drift; zeros if contacts do not move the solid
    "guide_start",  # m, r₀
    "guide_speed",  # m/s, u
    "guide_bend",  # m/s², a; 0 if contacts hold the wall, so that its path is straight
    "guide_half",  # s, ½ dt
    "guide_impacts",  # impacts so far
)


@inline
def guided_displacement(wall: Any, time: float) -> float:
    """Return how far (m) contacts have moved a wall along its normal at a time (s) since the drift began."""
    if wall.guide_half == 0.0:
        return 0.0
    bent: float = wall.guide_bend * time * (wall.guide_half - 0.5 * time)
    return wall.guide_start + wall.guide_speed * time - bent  # type: ignore[no-any-return]


def _push(surface: Any, solid: int, time: float, change: float) -> None:
    wall = surface[solid]
    wall.guide_start -= change * time
    wall.guide_speed += change
    wall.guide_impacts += 1.0


@with_field(GUIDE[0], _push)
def push_guided(surface: FloatArray, solid: int, time: float, change: float) -> None:
    """Change the velocity of a guided wall along its normal (m/s) at a time (s) since the drift began."""


def _straighten(surface: Any, solid: int) -> None:
    surface[solid].guide_bend = 0.0


@with_field(GUIDE[0], _straighten)
def straighten_guided(surface: FloatArray, solid: int) -> None:
    """Make the path of a wall straight in this drift, because contacts hold it."""


@with_field(GUIDE[0], lambda surface, solid: int(surface[solid].guide_impacts))
def impacts_of_wall(surface: FloatArray, solid: int) -> int:
    """Return how many impacts have moved a wall in this drift."""
    return 0


@with_field("axis_x", lambda body: True)
def is_guided(body: object) -> bool:
    """Return whether bodies have the fields of a guide; a constant in compiled kernels."""
    return False


def _projected(body: Any, Jx: float, Jy: float, Jz: float) -> Vector:
    x, y, z = body.axis_x, body.axis_y, body.axis_z
    if x == 0.0 and y == 0.0 and z == 0.0:
        return Jx, Jy, Jz
    J = Jx * x + Jy * y + Jz * z
    return J * x, J * y, J * z


@with_field("axis_x", _projected)
def along_guide(body: object, Jx: float, Jy: float, Jz: float) -> Vector:
    """Return the part of an impulse (N s) that changes an end's velocity; for a guided wall, the axial part."""
    return Jx, Jy, Jz


@with_field("axis_x", lambda Kn, a, b: Kn if b.axis_x == b.axis_y == b.axis_z == 0.0 else a.inverse_mass, place=2)
def tangent_inverse_mass(Kn: float, a: object, b: object) -> float:
    """Return the inverse effective mass (1/kg) of a tangential impulse without spins, given ``Kn`` along the normal."""
    return Kn


def _rise_of_guided(guided: Any, pushed: Any, normal: Vector) -> float:
    if guided.axis_x == 0.0 and guided.axis_y == 0.0 and guided.axis_z == 0.0:
        return 0.0
    x, y, z = normal
    rise: float = x * pushed.x + y * pushed.y + z * pushed.z
    return rise


@with_field("axis_x", _rise_of_guided)
def pushed_rise(guided: object, pushed: object, normal: Vector) -> float:
    """Return how far (m) the correction of positions has moved a plane along a normal; 0 if it is not guided."""
    return 0.0
