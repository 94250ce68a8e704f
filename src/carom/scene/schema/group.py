"""[[group]]: many bodies at random positions."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from carom.scene.schema.matter import Matter
from carom.scene.schema.quantity import ORIGIN, Count, NonNegative, Positive, Real, Section, Vector
from carom.scene.units.dimension import ANGULAR_VELOCITY, LENGTH, VELOCITY

STEEPEST = 300  # decades that a power of radii may span


def _constant_as_range(value: Any) -> Any:
    """Read a single number as a range of zero width."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return {"min": value, "max": value}
    return value


class RadiusRange(Section):
    """Radii of a group: one number, or a range with its distribution."""

    min: Annotated[Positive, LENGTH] = Field(description="m, smallest radius; more than 0")
    max: Annotated[Positive, LENGTH] = Field(description="m, largest radius; more than 0")
    distribution: Literal["uniform", "log-uniform", "power-law"] = Field("uniform", description="of the radii")
    exponent: Real = Field(-3.5, description="of the power law, dN/dr ∝ r^exponent")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min > self.max:
            raise ValueError(f"min = {self.min:g} is above max = {self.max:g}; exchange them")
        if abs(self.exponent + 1.0) * math.log10(self.max / self.min) > STEEPEST:
            raise ValueError(
                f"exponent = {self.exponent:g} is too steep for such different radii; lower it or their ratio"
            )
        return self


class Region(Section):
    """Where the bodies of a group are placed; every sphere lies entirely inside."""

    shape: Literal["ball", "box"] = Field("ball", description="shape of the region")
    radius: Annotated[Positive, LENGTH] | None = Field(None, description="m, of a ball; more than 0")
    size: Annotated[tuple[Positive, Positive, Positive], LENGTH] | None = Field(
        None, description="m, [x, y, z] of a box"
    )
    centre: Annotated[Vector, LENGTH] = Field(ORIGIN, description="m, [x, y, z]")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.shape == "ball" and (self.radius is None or self.size is not None):
            raise ValueError('shape = "ball" needs radius = … in metres, and no size')
        if self.shape == "box" and (self.size is None or self.radius is not None):
            raise ValueError('shape = "box" needs size = [x, y, z] in metres, and no radius')
        return self


class Velocity(Section):
    """Velocities of a group: Maxwellian about a mean."""

    mean: Annotated[Vector, VELOCITY] = Field(ORIGIN, description="m/s, [x, y, z]")
    dispersion: Annotated[NonNegative, VELOCITY] = Field(
        0.0, description="m/s, standard deviation of each component; not negative"
    )


class Spin(Section):
    """Spins of a group: Maxwellian about its bulk rotation."""

    dispersion: Annotated[NonNegative, ANGULAR_VELOCITY] = Field(
        0.0, description="rad/s, standard deviation of each component; not negative"
    )


class Group(Matter):
    """[[group]]: many bodies at random positions, without overlaps."""

    name: str = Field("", description="shown in the recording")
    count: Count = Field(100, description="number of bodies; 1 or more")
    radius: Annotated[RadiusRange, LENGTH, BeforeValidator(_constant_as_range)] = Field(
        RadiusRange(min=1.0, max=1.0), description="m, one number or { min, max, distribution }"
    )
    region: Region | None = Field(
        None, description="where the bodies are placed; by default a ball that is one tenth full"
    )
    velocity: Velocity = Field(Velocity(), description="{ mean, dispersion } in m/s")
    spin: Spin = Field(Spin(), description="{ dispersion } in rad/s")
    bulk_rotation: Annotated[Vector, ANGULAR_VELOCITY] = Field(
        ORIGIN, description="rad/s, [x, y, z], rigid rotation of the whole group about its centre"
    )
