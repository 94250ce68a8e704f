"""[[group]]: many bodies at random positions, or on a lattice."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from carom.scene.schema.matter import Matter
from carom.scene.schema.quantity import ORIGIN, Count, NonNegative, Positive, Real, Section, Vector
from carom.scene.units.dimension import ANGULAR_VELOCITY, LENGTH, VELOCITY

STEEPEST = 300  # decades that a power of radii may span
LENGTHS = {  # that each shape of a region needs, and those that it may have
    "ball": (("radius",), ()),
    "box": (("size",), ()),
    "cylinder": (("radius", "height"), ()),
    "shell": (("inner_radius", "radius"), ()),
    "plummer": (("scale",), ("radius",)),
}
ALL_LENGTHS = ("radius", "size", "height", "inner_radius", "scale")
LATTICES = ("cubic", "fcc", "hcp")


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
            raise ValueError("min is above max; exchange them")
        if abs(self.exponent + 1.0) * math.log10(self.max / self.min) > STEEPEST:
            raise ValueError(
                f"exponent = {self.exponent:g} is too steep for such different radii; lower it or their ratio"
            )
        return self


class Region(Section):
    """Where the bodies of a group are placed; every sphere lies entirely inside, but in a plummer region its centre."""

    shape: Literal["ball", "box", "cylinder", "shell", "plummer"] = Field(
        "ball", description="ball, box, upright cylinder, shell between two radii, or Plummer's model of a star cluster"
    )
    radius: Annotated[Positive, LENGTH] | None = Field(
        None,
        description="m, of a ball, a cylinder or a shell; in a plummer region the farthest centre, 10 scale if absent",
    )
    size: Annotated[tuple[Positive, Positive, Positive], LENGTH] | None = Field(
        None, description="m, [x, y, z] of a box"
    )
    height: Annotated[Positive, LENGTH] | None = Field(None, description="m, of a cylinder along z; more than 0")
    inner_radius: Annotated[Positive, LENGTH] | None = Field(None, description="m, of the hollow in a shell")
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
            raise ValueError("inner_radius is not below radius; exchange them")
        return self


class Velocity(Section):
    """Velocities of a group: Maxwellian about a mean."""

    mean: Annotated[Vector, VELOCITY] = Field(ORIGIN, description="m/s, [x, y, z]")
    dispersion: Annotated[NonNegative, VELOCITY] = Field(
        0.0, description="m/s, standard deviation of each component; not negative"
    )
    virial: NonNegative | None = Field(
        None,
        description="kinetic over potential energy of a plummer region, whose velocities are added: 0.5 is equilibrium",
    )


class Spin(Section):
    """Spins of a group: Maxwellian about its bulk rotation."""

    dispersion: Annotated[NonNegative, ANGULAR_VELOCITY] = Field(
        0.0, description="rad/s, standard deviation of each component; not negative"
    )


class Group(Matter):
    """[[group]]: many bodies at random positions or on a lattice, without overlaps."""

    name: str = Field("", description="shown in the recording")
    count: Count = Field(100, description="number of bodies; 1 or more")
    radius: Annotated[RadiusRange, LENGTH, BeforeValidator(_constant_as_range)] = Field(
        RadiusRange(min=1.0, max=1.0), description="m, one number or { min, max, distribution }"
    )
    region: Region | None = Field(
        None, description="where the bodies are placed; by default a ball that is one tenth full"
    )
    arrangement: Literal["random", "compressed", "cubic", "fcc", "hcp"] = Field(
        "random",
        description="at random up to a packing of 0.38; compressed: at random up to 0.62, of unequal radii more, and "
        "together with all groups of the same region; or on a lattice",
    )
    spacing: Annotated[Positive, LENGTH] | None = Field(
        None, description="m, between neighbours on a lattice; by default the bodies fill the region"
    )
    velocity: Velocity = Field(Velocity(), description="{ mean, dispersion, virial } in m/s")
    spin: Spin = Field(Spin(), description="{ dispersion } in rad/s")
    bulk_rotation: Annotated[Vector, ANGULAR_VELOCITY] = Field(
        ORIGIN, description="rad/s, [x, y, z], rigid rotation of the whole group about its centre"
    )

    @model_validator(mode="after")
    def _arranged_where_it_can_be(self) -> Self:
        shape = None if self.region is None else self.region.shape
        if self.spacing is not None and self.arrangement not in LATTICES:
            raise ValueError(f'spacing with arrangement = "{self.arrangement}"; take {", ".join(LATTICES)}')
        if self.arrangement in LATTICES and self.region is None:
            raise ValueError(f'arrangement = "{self.arrangement}" needs a region')
        if self.arrangement != "random" and shape == "plummer":
            raise ValueError(f'arrangement = "{self.arrangement}" in a plummer region, which is random; leave one out')
        if self.velocity.virial is not None and shape != "plummer":
            raise ValueError('velocity.virial without a region of shape = "plummer"; leave it out')
        if self.velocity.virial is not None and self.mass == 0.0:
            raise ValueError("velocity.virial of test particles (mass = 0), which have no potential; leave it out")
        return self
