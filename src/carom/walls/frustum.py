"""A part of a cone's surface with edges, such as a hopper: open at both ends, and solid from both sides.

In the half-plane of the distances ρ from the axis and h along it, the wall is a segment. The nearest point is on the
segment, or at one of its ends, which are the rims.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.extend import (
    LENGTH,
    Mesh,
    NonNegative,
    Positive,
    Real,
    Section,
    WallShape,
    across,
    mesh_of_revolution,
    unit_vector,
)

FIELDS = (
    *("radius", "x", "y", "z", "axis_x", "axis_y", "axis_z", "side_x", "side_y", "side_z"),
    *("along_rho", "along_h", "slant"),
)


class Frustum(Section):
    """[wall.cone]: the surface between two circles about one axis, such as a funnel; open at both ends."""

    radius: Annotated[NonNegative, LENGTH] = Field(description="m, radius of the circle about `point`; not negative")
    end_radius: Annotated[NonNegative, LENGTH] = Field(
        description="m, radius of the circle at the other end; not negative"
    )
    height: Annotated[Positive, LENGTH] = Field(
        description="m, distance along the axis from `point` to the other end; more than 0"
    )
    point: Annotated[tuple[Real, Real, Real], LENGTH] = Field(
        (0.0, 0.0, 0.0), description="m, [x, y, z], centre of the first circle"
    )
    axis: tuple[Real, Real, Real] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction from `point` to the other end; any length but 0"
    )

    @model_validator(mode="after")
    def _has_a_surface(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis = [0, 0, 0] has no direction; give the direction of the cone, such as [0, 0, 1]")
        if self.radius == 0.0 and self.end_radius == 0.0:
            raise ValueError("radius and end_radius are 0; one of them must be more than 0")
        return self


def parameters(section: Frustum) -> Mapping[str, float]:
    """Return the first circle, the axis, a direction across it, and the segment from circle to circle."""
    direction = unit_vector(section.axis)
    rho, h = section.end_radius - section.radius, section.height
    slant = math.sqrt(rho * rho + h * h)
    directions = (*direction.tolist(), *across(direction).tolist())
    values = (section.radius, *section.point, *directions, rho / slant, h / slant, slant)
    return dict(zip(FIELDS, values, strict=True))


def nearest(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the normal from the nearest point of the segment, the distance from it, and ρ."""
    dx, dy, dz = x - p.x, y - p.y, z - p.z
    h = dx * p.axis_x + dy * p.axis_y + dz * p.axis_z
    dx, dy, dz = dx - h * p.axis_x, dy - h * p.axis_y, dz - h * p.axis_z
    rho = math.sqrt(dx * dx + dy * dy + dz * dz)
    ux, uy, uz = p.side_x, p.side_y, p.side_z
    if rho > 0.0:
        ux, uy, uz = dx / rho, dy / rho, dz / rho
    s = (rho - p.radius) * p.along_rho + h * p.along_h
    if 0.0 < s < p.slant:
        n_rho, n_h = -p.along_h, p.along_rho  # normal towards the axis
        distance = (rho - p.radius) * n_rho + h * n_h
        if distance < 0.0:
            n_rho, n_h, distance = -n_rho, -n_h, -distance
    else:
        s = max(0.0, min(p.slant, s))
        n_rho, n_h = rho - p.radius - s * p.along_rho, h - s * p.along_h
        distance = math.sqrt(n_rho * n_rho + n_h * n_h)
        if distance > 0.0:
            n_rho, n_h = n_rho / distance, n_h / distance
        else:
            n_rho, n_h = -p.along_h, p.along_rho
    nx, ny, nz = n_rho * ux + n_h * p.axis_x, n_rho * uy + n_h * p.axis_y, n_rho * uz + n_h * p.axis_z
    return nx, ny, nz, distance, rho


def axis(section: Frustum) -> tuple[FloatArray, FloatArray]:
    """Return a point and the direction of the axis."""
    return np.array(section.point), unit_vector(section.axis)


def mesh(section: Frustum, centre: FloatArray, reach: float) -> Mesh:
    """Return the whole surface."""
    ends = ((section.radius, 0.0), (section.end_radius, section.height))
    return mesh_of_revolution(*axis(section), ends)


WALL = WallShape(Frustum, nearest, mesh, FIELDS, parameters, thin=True, axis=axis)
