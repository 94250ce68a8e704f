"""[group.region] and [outlet.region]: a part of space."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from carom.scene.schema.quantity import ORIGIN, Positive, Section, Vector
from carom.scene.units.dimension import LENGTH

LENGTHS = {  # lengths that each shape of a region requires, and further lengths that it allows
    "ball": (("radius",), ()),
    "box": (("size",), ()),
    "cylinder": (("radius", "height"), ()),
    "shell": (("inner_radius", "radius"), ()),
    "plummer": (("scale",), ("radius",)),
}
ALL_LENGTHS = ("radius", "size", "height", "inner_radius", "scale")


class Region(Section):
    """A part of space: where the bodies of a group are placed, or where bodies leave.

    The spheres of a group lie entirely inside; in a plummer region, only their centres do.
    """

    shape: Literal["ball", "box", "cylinder", "shell", "plummer"] = Field(
        "ball", description="ball, box, upright cylinder, shell between two radii, or Plummer's model of a star cluster"
    )
    radius: Annotated[Positive, LENGTH] | None = Field(
        None,
        description="m, of a ball, a cylinder or a shell; in a plummer region the largest distance of a centre, by "
        "default 10 scale",
    )
    size: Annotated[tuple[Positive, Positive, Positive], LENGTH] | None = Field(
        None, description="m, [x, y, z] of a box"
    )
    height: Annotated[Positive, LENGTH] | None = Field(None, description="m, height of a cylinder along z; more than 0")
    inner_radius: Annotated[Positive, LENGTH] | None = Field(None, description="m, radius of the cavity in a shell")
    scale: Annotated[Positive, LENGTH] | None = Field(
        None, description="m, Plummer's radius a; half of the mass is within 1.3 a"
    )
    centre: Annotated[Vector, LENGTH] = Field(ORIGIN, description="m, [x, y, z]")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        needed, allowed = LENGTHS[self.shape]
        missing = [key for key in needed if getattr(self, key) is None]
        given = [key for key in ALL_LENGTHS if getattr(self, key) is not None and key not in (*needed, *allowed)]
        if missing or given:
            values = " and ".join(f"{key} = {'[x, y, z]' if key == 'size' else '…'}" for key in needed)
            others = f", and no {given[0]}" if given else ""
            raise ValueError(f'shape = "{self.shape}" needs {values}{others}')
        if self.inner_radius is not None and self.radius is not None and self.inner_radius >= self.radius:
            raise ValueError("inner_radius is not below radius; swap them")
        return self
