"""A cylinder with the bodies inside, such as a drum or a tube.

If ρ is the distance of a point from the axis, the wall is R - ρ away. A body of radius r that moves freely inside meets
the wall where ρ = R - r, which is a quadratic equation for the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.extend import LENGTH, Mesh, Positive, Real, Section, WallShape, across, mesh_of_revolution, unit_vector

FIELDS = ("radius", "x", "y", "z", "axis_x", "axis_y", "axis_z", "side_x", "side_y", "side_z")


class Cylinder(Section):
    """[wall.cylinder]: an endless cylinder with the bodies inside."""

    radius: Annotated[Positive, LENGTH] = Field(description="m, more than 0")
    point: Annotated[tuple[Real, Real, Real], LENGTH] = Field(
        (0.0, 0.0, 0.0), description="m, position [x, y, z] of any point of the axis"
    )
    axis: tuple[Real, Real, Real] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction of the axis; any length but 0"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis = [0, 0, 0] has no direction; give the direction of the cylinder, such as [0, 0, 1]")
        return self


def parameters(section: Cylinder) -> Mapping[str, float]:
    """Return the radius, a point of the axis, its direction, and a direction across it."""
    direction = unit_vector(section.axis)
    values = (section.radius, *section.point, *direction.tolist(), *across(direction).tolist())
    return dict(zip(FIELDS, values, strict=True))


def nearest(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the inward normal, the distance R - ρ, and ρ: level surfaces are cylinders about the axis."""
    dx, dy, dz = x - p.x, y - p.y, z - p.z
    along = dx * p.axis_x + dy * p.axis_y + dz * p.axis_z
    dx, dy, dz = dx - along * p.axis_x, dy - along * p.axis_y, dz - along * p.axis_z
    rho = math.sqrt(dx * dx + dy * dy + dz * dz)
    if rho > 0.0:
        return -dx / rho, -dy / rho, -dz / rho, p.radius - rho, rho
    return p.side_x, p.side_y, p.side_z, p.radius, 0.0


def axis(section: Cylinder) -> tuple[FloatArray, FloatArray]:
    """Return a point and the direction of the axis."""
    return np.array(section.point), unit_vector(section.axis)


def periodic(section: Cylinder, axis: int, period: float) -> Mapping[str, float] | None:
    """Return no changes for a cylinder along the periodic axis; None for any other cylinder."""
    return {} if abs(unit_vector(section.axis)[axis]) == 1.0 else None


def mesh(section: Cylinder, centre: FloatArray, reach: float) -> Mesh:
    """Return a prism that is as long as the scene."""
    point, direction = axis(section)
    middle = (direction * (centre - point)).sum()
    ends = ((section.radius, middle - reach), (section.radius, middle + reach))
    return mesh_of_revolution(point, direction, ends)


WALL = WallShape(Cylinder, nearest, mesh, FIELDS, parameters, axis=axis, periodic=periodic)
