"""[plane.piston]: a plane with a mass that moves along its normal, under a constant force."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.quantity import Positive, Real, Section
from carom.scene.units.dimension import FORCE, MASS, PRESSURE, VELOCITY


class Piston(Section):
    """[plane.piston]: a mass that moves along the normal of the plane only, under a force and gravity.

    Contacts move it, so it exerts the given force on the bodies whenever it does not accelerate.
    """

    mass: Annotated[Positive, MASS] = Field(description="kg, more than 0")
    force: Annotated[Real, FORCE] | None = Field(None, description="N, along the normal: presses on the bodies if > 0")
    pressure: Annotated[Real, PRESSURE] | None = Field(
        None, description="Pa, instead of a force: on the face of `domain.size` that the normal is perpendicular to"
    )
    velocity: Annotated[Real, VELOCITY] = Field(0.0, description="m/s, along the normal, at the start")

    @model_validator(mode="after")
    def _has_one_load(self) -> Self:
        if self.force is not None and self.pressure is not None:
            raise ValueError("force and pressure are both given; leave one out")
        return self
