"""A hollow sphere with the bodies inside.

If ρ is the distance of a point from the centre, the wall is R - ρ away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.extend import LENGTH, Mesh, Positive, Real, Section, WallShape, mesh_of_revolution, unit_vector

POINTS = 25  # points of the drawn sphere from pole to pole
FIELDS = ("radius", "x", "y", "z")


class Sphere(Section):
    """[wall.sphere]: a hollow sphere with the bodies inside."""

    radius: Annotated[Positive, LENGTH] = Field(description="m, more than 0")
    centre: Annotated[tuple[Real, Real, Real], LENGTH] = Field((0.0, 0.0, 0.0), description="m, [x, y, z]")
    axis: tuple[Real, Real, Real] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], of a rotation by wall.motion; any length but 0"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis = [0, 0, 0] has no direction; give the direction of the rotation, such as [0, 0, 1]")
        return self


def parameters(section: Sphere) -> Mapping[str, float]:
    """Return the radius and the centre."""
    return dict(zip(FIELDS, (section.radius, *section.centre), strict=True))


def nearest(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the inward normal, the distance R - ρ, and ρ: level surfaces are spheres about the centre."""
    dx, dy, dz = x - p.x, y - p.y, z - p.z
    rho = math.sqrt(dx * dx + dy * dy + dz * dz)
    if rho > 0.0:
        return -dx / rho, -dy / rho, -dz / rho, p.radius - rho, rho
    return 0.0, 0.0, 1.0, p.radius, 0.0


def axis(section: Sphere) -> tuple[FloatArray, FloatArray]:
    """Return the centre and the direction of the axis."""
    return np.array(section.centre), unit_vector(section.axis)


def mesh(section: Sphere, centre: FloatArray, reach: float) -> Mesh:
    """Return the whole sphere."""
    angles = np.linspace(0.0, np.pi, POINTS)
    profile = zip((section.radius * np.sin(angles)).tolist(), (section.radius * np.cos(angles)).tolist(), strict=True)
    return mesh_of_revolution(np.array(section.centre), np.array([0.0, 0.0, 1.0]), list(profile))


WALL = WallShape(Sphere, nearest, mesh, FIELDS, parameters, axis=axis)
