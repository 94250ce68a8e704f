"""[[body]]: one body."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.matter import Matter
from carom.scene.schema.quantity import ORIGIN, Positive, Vector


class Body(Matter):
    """[[body]]: one body."""

    name: str = Field("", description="shown in the recording and in warnings")
    position: Vector = Field(ORIGIN, description="m, [x, y, z] of the centre")
    velocity: Vector = Field(ORIGIN, description="m/s, [x, y, z]")
    angular_velocity: Vector = Field(ORIGIN, description="rad/s, [x, y, z]")
    radius: Positive = Field(1.0, description="m; more than 0")
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
