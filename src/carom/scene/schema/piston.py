"""[plane.piston]: a plane with a mass that moves along its normal, under a constant force or a pressure."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.quantity import Positive, Real, Section
from carom.scene.units.dimension import FORCE, MASS, PRESSURE, VELOCITY


class Piston(Section):
    """[plane.piston]: a mass that moves along the normal of the plane only, under a force and gravity.

    Contacts move it, so it exerts the given force on the bodies whenever it does not accelerate. Several pistons keep
    the stresses on the sides of a box.
    """

    mass: Annotated[Positive, MASS] = Field(description="kg, more than 0")
    force: Annotated[Real, FORCE] | None = Field(
        None, description="N, force along the normal; a positive force presses on the bodies"
    )
    pressure: Annotated[Real, PRESSURE] | None = Field(
        None,
        description=(
            "Pa, instead of a force: on the present face between pistons and the planes opposite to them, and where no "
            "piston moves, of `domain.size`"
        ),
    )
    velocity: Annotated[Real, VELOCITY] = Field(0.0, description="m/s, velocity along the normal at the start")
    max_speed: Annotated[Positive, VELOCITY] | None = Field(
        None, description="m/s, largest speed to which the load accelerates the piston; by default unlimited"
    )

    @model_validator(mode="after")
    def _has_one_load(self) -> Self:
        if self.force is not None and self.pressure is not None:
            raise ValueError("force and pressure are both given; leave one out")
        if self.max_speed is not None and abs(self.velocity) > self.max_speed:
            raise ValueError(
                f"velocity = {self.velocity:g} exceeds max_speed = {self.max_speed:g}; lower it, or raise max_speed"
            )
        return self
