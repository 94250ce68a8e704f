"""The prescribed motion of a plane or a wall: rotation about its axis, or translation.

A wall that translates is displaced from where its section puts it by

    D(t) = V t + A sin(2π f t + φ)
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.quantity import ORIGIN, Positive, Real, Section, Vector
from carom.scene.units.dimension import ANGLE, ANGULAR_VELOCITY, LENGTH, RATE, VELOCITY


class WallMotion(Section):
    """[plane.motion], [wall.motion]: a prescribed motion, whose work the ledger has as an entry."""

    rotation: Annotated[Real, ANGULAR_VELOCITY] = Field(
        0.0,
        description="rad/s, right-handed about the axis of a cylinder, cone, disc or sphere: only its friction moves",
    )
    velocity: Annotated[Vector, VELOCITY] = Field(
        ORIGIN, description="m/s, [x, y, z]: at the time t, the wall is displaced by `velocity` t"
    )
    amplitude: Annotated[Vector, LENGTH] = Field(
        ORIGIN, description="m, [x, y, z]: it is also displaced by `amplitude` sin(2π `frequency` t + `phase`)"
    )
    frequency: Annotated[Positive, RATE] | None = Field(None, description="1/s, of the oscillation, more than 0")
    phase: Annotated[Real, ANGLE] = Field(
        0.0, description='rad, of the oscillation; "-90 deg" starts it at rest, at -`amplitude`'
    )

    @property
    def translates(self) -> bool:
        """Whether the wall changes its place."""
        return any(self.velocity) or any(self.amplitude)

    @property
    def moves(self) -> bool:
        """Whether anything of it moves."""
        return self.translates or self.rotation != 0.0

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if not self.model_fields_set:
            raise ValueError("motion gives none; add rotation, velocity, or amplitude and frequency")
        if any(self.amplitude) and self.frequency is None:
            raise ValueError('amplitude without frequency; add the frequency, such as "30 Hz"')
        if not any(self.amplitude) and {"frequency", "phase"} & self.model_fields_set:
            given = "frequency" if self.frequency is not None else "phase"
            raise ValueError(f"{given} without amplitude; add the amplitude of the oscillation, such as [0, 0, 0.001]")
        if self.rotation != 0.0 and self.translates:
            given = "velocity" if any(self.velocity) else "amplitude"
            raise ValueError(f"rotation with {given}: a wall either rotates or translates; remove one of them")
        return self
