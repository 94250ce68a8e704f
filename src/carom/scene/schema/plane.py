"""[[plane]]: a static half-space."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.material import Surface
from carom.scene.schema.quantity import ORIGIN, AnyReal, Vector
from carom.scene.units.dimension import LENGTH


class Plane(Surface):
    """[[plane]]: a static half-space; the normal points out of the solid.

    Its coefficients hold for all contacts with it; those that it does not give follow from both materials.
    """

    name: str = Field("", description="shown in warnings")
    point: Annotated[Vector, LENGTH] = Field(ORIGIN, description="m, [x, y, z] of any point of the surface")
    normal: tuple[AnyReal, AnyReal, AnyReal] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction out of the solid; any length but 0"
    )
    material: str | None = Field(None, description="name of a [[material]], in place of coefficients")

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.normal):
            raise ValueError(
                "normal = [0, 0, 0] has no direction; give the direction out of the solid, such as [0, 0, 1]"
            )
        return self
