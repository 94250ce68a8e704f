"""A shape of a wall: a tube that is bent to a ring, with the bodies inside.

With ρ the distance from the axis, h the height along it, and s the distance from the circle ρ = R in the middle of the
tube, s² = (ρ - R)² + h², the wall is r - s away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from carom.extend import LENGTH, Mesh, Positive, Real, Section, WallShape, mesh_of_revolution

POINTS = 33  # of the drawn circle around the tube
FIELDS = ("radius", "tube", "x", "y", "z")
UP = np.array([0.0, 0.0, 1.0])


class Ring(Section):
    """[wall.ring]: a tube that is bent to a ring about the z axis, with the bodies inside."""

    radius: Annotated[Positive, LENGTH] = Field(description="m, R, from the centre to the middle of the tube")
    tube: Annotated[Positive, LENGTH] = Field(description="m, r, of the tube; less than the radius")
    centre: Annotated[tuple[Real, Real, Real], LENGTH] = Field((0.0, 0.0, 0.0), description="m, [x, y, z]")

    @model_validator(mode="after")
    def _has_a_hole(self) -> Self:
        if self.tube >= self.radius:
            raise ValueError(f"tube = {self.tube:g} closes the hole of the ring; it must be less than the radius")
        return self


def parameters(section: Ring) -> Mapping[str, float]:
    """Return the radii and the centre."""
    return dict(zip(FIELDS, (section.radius, section.tube, *section.centre), strict=True))


def nearest(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the normal towards the middle of the tube, the distance r - s, and the focal distance s.

    Level surfaces of the distance are tubes of radius s about the same circle. Around the tube, their centre of
    curvature is on that circle, s away. Along the tube they curve towards the axis, which is farther away.
    """
    dx, dy, h = x - p.x, y - p.y, z - p.z
    rho = math.sqrt(dx * dx + dy * dy)
    ux, uy = (dx / rho, dy / rho) if rho > 0.0 else (1.0, 0.0)
    out = rho - p.radius
    s = math.sqrt(out * out + h * h)
    if s > 0.0:
        return -out / s * ux, -out / s * uy, -h / s, p.tube - s, s
    return 0.0, 0.0, 1.0, p.tube, 0.0


def axis(section: Ring) -> tuple[Any, Any]:
    """Return the centre and the direction of the axis: a surface of revolution may rotate."""
    return np.array(section.centre), UP


def mesh(section: Ring, centre: Any, reach: float) -> Mesh:
    """Return the whole ring; a shape without an end would be drawn within about ``reach`` (m) of ``centre`` (m)."""
    angles = np.linspace(0.0, 2.0 * np.pi, POINTS)
    rho, h = section.radius + section.tube * np.cos(angles), section.tube * np.sin(angles)
    return mesh_of_revolution(np.array(section.centre), UP, list(zip(rho.tolist(), h.tolist(), strict=True)))


RING = WallShape(Ring, nearest, mesh, FIELDS, parameters, axis=axis)
