"""[[body]]: one body."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.matter import Matter
from carom.scene.schema.quantity import ORIGIN, Positive, Vector
from carom.scene.units.dimension import ANGULAR_VELOCITY, LENGTH, VELOCITY


class Body(Matter):
    """[[body]]: one body."""

    name: str = Field("", description="shown in the recording and in warnings")
    position: Annotated[Vector, LENGTH] = Field(ORIGIN, description="m, [x, y, z] of the centre")
    velocity: Annotated[Vector, VELOCITY] = Field(ORIGIN, description="m/s, [x, y, z]")
    angular_velocity: Annotated[Vector, ANGULAR_VELOCITY] = Field(ORIGIN, description="rad/s, [x, y, z]")
    radius: Annotated[Positive, LENGTH] = Field(1.0, description="m; more than 0")
    fixed: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: the body neither moves nor turns, whatever acts on it"
    )

    @model_validator(mode="after")
    def _a_fixed_body_does_not_move(self) -> Self:
        if self.fixed and (any(self.velocity) or any(self.angular_velocity)):
            raise ValueError(
                "fixed = true with a velocity or an angular_velocity; leave them out, or set fixed = false"
            )
        return self
