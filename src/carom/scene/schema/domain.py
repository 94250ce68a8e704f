"""[domain]: the space around the bodies."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from carom.scene.schema.quantity import Positive, Section
from carom.scene.units.dimension import LENGTH


class Domain(Section):
    """[domain]: the space around the bodies."""

    boundary: Literal["open", "periodic", "walls"] = Field(
        "open", description="open space, a periodic box, or a box with walls"
    )
    size: Annotated[tuple[Positive, Positive, Positive], LENGTH] | None = Field(
        None, description="m, [x, y, z] of the box about the origin; needed unless the boundary is open"
    )

    material: str | None = Field(None, description="name of a [[material]], that of the walls")

    @model_validator(mode="after")
    def _walls_have_a_material(self) -> Self:
        if self.material is not None and self.boundary != "walls":
            raise ValueError(f'material = "{self.material}" without walls; set boundary = "walls", or leave it out')
        return self

    @model_validator(mode="after")
    def _a_box_has_a_size(self) -> Self:
        if self.boundary != "open" and self.size is None:
            raise ValueError(f'boundary = "{self.boundary}" needs size = [x, y, z]')
        if self.size is not None and "boundary" not in self.model_fields_set:
            raise ValueError('size without a boundary; add boundary = "walls" or "periodic", or leave it out')
        return self
