"""A mesh of triangles from a file, solid from both sides.

Each triangle is a facet, so that a body can touch several at once (`carom.walls.mesh.facet`). carom reads the file
(`carom.walls.mesh.mesh_file`) once and keeps its content in the section, so that recordings contain it.
"""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.extend import LENGTH, Facets, Mesh, Positive, Real, Section, UnitSystem, WallShape, unit_vector
from carom.walls.mesh.facet_fields import FIELDS, fields_of
from carom.walls.mesh.mesh_file import enclosed, read, unpacked

SMALLEST, LARGEST = 1.0, 2000.0  # widths of a mesh, in radii of the bodies, beyond which its unit is doubtful
LARGEST_COSINE = 1e-9  # largest cosine of the angle between the axes; rounding to ten digits causes less


class MeshWall(Section):
    """[wall.mesh]: triangles of a file in STL, OBJ or PLY; thin, open or closed, with bodies on any side."""

    file: str = Field("", description="a mesh in STL, OBJ or PLY; a path relative to the scene")
    unit: Annotated[Positive, LENGTH] = Field(1.0, description='m, the unit of the file, such as "1 mm"; more than 0')
    centre: Annotated[tuple[Real, Real, Real], LENGTH] = Field(
        (0.0, 0.0, 0.0), description="m, [x, y, z], where the origin of the file is"
    )
    x_axis: tuple[Real, Real, Real] = Field(
        (1.0, 0.0, 0.0), description="[x, y, z], direction of the file's x axis; any length but 0"
    )
    z_axis: tuple[Real, Real, Real] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction of the file's z axis, at right angles to `x_axis`"
    )
    content: str = Field("", description="the triangles of the file; written by carom, and used in place of the file")

    @model_validator(mode="after")
    def _is_a_mesh(self) -> Self:
        for name, axis in (("x_axis", self.x_axis), ("z_axis", self.z_axis)):
            if not any(axis):
                raise ValueError(f"{name} = [0, 0, 0] has no direction; give one, such as [0, 0, 1]")
        if abs((unit_vector(self.x_axis) * unit_vector(self.z_axis)).sum()) > LARGEST_COSINE:
            raise ValueError("x_axis and z_axis are not at right angles")
        if not self.content:
            raise ValueError('file is missing; name a mesh in STL, OBJ or PLY, such as "hopper.stl"')
        unpacked(self.content)
        return self


def _placed(section: MeshWall) -> Mesh:
    """Return the triangles at the place given in the section."""
    corners, triangles = unpacked(section.content)
    one, third = unit_vector(section.x_axis), unit_vector(section.z_axis)
    axes = one, np.cross(third, one), third
    turned = sum(corners[:, k, None] * axis for k, axis in enumerate(axes))
    return Mesh(np.array(section.centre) + section.unit * turned, triangles)


def facets(section: MeshWall) -> Facets:
    """Return the triangles as facets."""
    corners, triangles, _ = _placed(section)
    return Facets(corners[triangles], fields_of(corners, triangles))


def mesh(section: MeshWall, centre: FloatArray, reach: float) -> Mesh:
    """Return all triangles."""
    return _placed(section)


def doubts(section: MeshWall, radius: float, units: UnitSystem) -> list[str]:
    """Return doubts about the unit and the normals of a mesh; ``radius`` is the median radius of the bodies in m."""
    corners, triangles, _ = _placed(section)
    size, found = float(np.ptp(corners, axis=0).max()), list[str]()
    if not SMALLEST * radius <= size <= LARGEST * radius:
        found.append(
            f"the mesh is {units.text(size, LENGTH, '.3g')} wide, and bodies have radii of about "
            f'{units.text(radius, LENGTH, ".3g")}; if the file has another unit, state it, such as unit = "1 mm"'
        )
    volume = enclosed(corners, triangles)
    if volume is not None and volume < 0.0:
        found.append(
            "the mesh is closed and inside out: its normals point inwards; it works, since walls are solid from both "
            "sides, but other programs may refuse it"
        )
    return found


WALL = WallShape(
    MeshWall,
    "carom.walls.mesh.facet:nearest",
    mesh,
    FIELDS,
    flat=True,
    thin=True,
    facets=facets,
    touches="carom.walls.mesh.facet:touches",
    read=read,
    doubts=doubts,
)
