"""A flat rectangular plate with edges, solid from both sides.

Along each side, the nearest point has the coordinate of the given point, limited to half the length of the side.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.extend import LENGTH, Mesh, Real, Section, WallShape

LARGEST_COSINE = 1e-9  # largest cosine of the angle between the sides; rounding to ten digits causes less
FIELDS = (
    *("x", "y", "z", "one_x", "one_y", "one_z", "other_x", "other_y", "other_z"),
    *("normal_x", "normal_y", "normal_z", "half_one", "half_other"),
)


class Rectangle(Section):
    """[wall.rectangle]: a thin rectangular plate, with its edges."""

    centre: Annotated[tuple[Real, Real, Real], LENGTH] = Field((0.0, 0.0, 0.0), description="m, [x, y, z]")
    side: Annotated[tuple[Real, Real, Real], LENGTH] = Field(
        description="m, [x, y, z], vector from one corner to the next"
    )
    other_side: Annotated[tuple[Real, Real, Real], LENGTH] = Field(
        description="m, [x, y, z], vector along the other side, at right angles to the first"
    )

    @model_validator(mode="after")
    def _has_right_angles(self) -> Self:
        one, other = np.array(self.side), np.array(self.other_side)
        lengths = math.sqrt((one * one).sum()) * math.sqrt((other * other).sum())
        if lengths == 0.0:
            raise ValueError("side or other_side has no length; give both, such as [1, 0, 0] and [0, 1, 0]")
        if abs((one * other).sum()) > LARGEST_COSINE * lengths:
            raise ValueError("side and other_side are not at right angles")
        return self


def parameters(section: Rectangle) -> Mapping[str, float]:
    """Return the centre, the directions and the lengths of the sides, and the normal."""
    sides = [np.array(side) for side in (section.side, section.other_side)]
    one, other = (math.sqrt((side * side).sum()) for side in sides)
    normal = np.cross(sides[0] / one, sides[1] / other)
    directions = (*(sides[0] / one).tolist(), *(sides[1] / other).tolist(), *normal.tolist())
    return dict(zip(FIELDS, (*section.centre, *directions, 0.5 * one, 0.5 * other), strict=True))


def nearest(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the normal and the distance from the plate, its edges or corners; no level surface is concave."""
    dx, dy, dz = x - p.x, y - p.y, z - p.z
    a = dx * p.one_x + dy * p.one_y + dz * p.one_z
    b = dx * p.other_x + dy * p.other_y + dz * p.other_z
    h = dx * p.normal_x + dy * p.normal_y + dz * p.normal_z
    side = 1.0 if h >= 0.0 else -1.0
    if abs(a) <= p.half_one and abs(b) <= p.half_other:
        return side * p.normal_x, side * p.normal_y, side * p.normal_z, side * h, math.inf
    a -= max(-p.half_one, min(p.half_one, a))
    b -= max(-p.half_other, min(p.half_other, b))
    distance = math.sqrt(a * a + b * b + h * h)
    nx = (a * p.one_x + b * p.other_x + h * p.normal_x) / distance
    ny = (a * p.one_y + b * p.other_y + h * p.normal_y) / distance
    nz = (a * p.one_z + b * p.other_z + h * p.normal_z) / distance
    return nx, ny, nz, distance, math.inf


def periodic(section: Rectangle, axis: int, period: float) -> Mapping[str, float] | None:
    """Return an endless half of the side along the axis, if this side is at least as long as the period."""
    for name, side in (("half_one", section.side), ("half_other", section.other_side)):
        if np.count_nonzero(side) == 1 and abs(side[axis]) >= period:
            return {name: math.inf}
    return None


def mesh(section: Rectangle, centre: FloatArray, reach: float) -> Mesh:
    """Return both triangles."""
    one, other = 0.5 * np.array(section.side), 0.5 * np.array(section.other_side)
    corners = np.array(section.centre) + np.array([-one - other, one - other, one + other, -one + other])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


WALL = WallShape(Rectangle, nearest, mesh, FIELDS, parameters, flat=True, thin=True, periodic=periodic)
