"""A flat round plate with an edge, solid from both sides.

For a point at distance ρ from the axis, the nearest point of the plate is at min(ρ, R), in the same direction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.extend import LENGTH, Mesh, Positive, Real, Section, WallShape, mesh_of_revolution, unit_vector

FIELDS = ("radius", "x", "y", "z", "axis_x", "axis_y", "axis_z")


class Disc(Section):
    """[wall.disc]: a thin round plate, with its edge."""

    radius: Annotated[Positive, LENGTH] = Field(description="m, more than 0")
    centre: Annotated[tuple[Real, Real, Real], LENGTH] = Field((0.0, 0.0, 0.0), description="m, [x, y, z]")
    normal: tuple[Real, Real, Real] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], perpendicular to the disc; any length but 0"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.normal):
            raise ValueError("normal = [0, 0, 0] has no direction; give the disc's axis, such as [0, 0, 1]")
        return self


def parameters(section: Disc) -> Mapping[str, float]:
    """Return the radius, the centre and the normal."""
    values = (section.radius, *section.centre, *unit_vector(section.normal).tolist())
    return dict(zip(FIELDS, values, strict=True))


def nearest(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the normal and the distance from the plate or its edge; none of its level surfaces is concave."""
    dx, dy, dz = x - p.x, y - p.y, z - p.z
    h = dx * p.axis_x + dy * p.axis_y + dz * p.axis_z
    rx, ry, rz = dx - h * p.axis_x, dy - h * p.axis_y, dz - h * p.axis_z
    rho = math.sqrt(rx * rx + ry * ry + rz * rz)
    if rho <= p.radius:
        side = 1.0 if h >= 0.0 else -1.0
        return side * p.axis_x, side * p.axis_y, side * p.axis_z, side * h, math.inf
    out = (rho - p.radius) / rho
    nx, ny, nz = h * p.axis_x + out * rx, h * p.axis_y + out * ry, h * p.axis_z + out * rz
    distance = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / distance, ny / distance, nz / distance, distance, math.inf


def axis(section: Disc) -> tuple[FloatArray, FloatArray]:
    """Return a point and the direction of the axis."""
    return np.array(section.centre), unit_vector(section.normal)


def mesh(section: Disc, centre: FloatArray, reach: float) -> Mesh:
    """Return the whole plate."""
    profile = ((0.0, 0.0), (section.radius, 0.0))
    return mesh_of_revolution(*axis(section), profile)


WALL = WallShape(Disc, nearest, mesh, FIELDS, parameters, flat=True, thin=True, axis=axis)
