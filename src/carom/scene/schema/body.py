"""[[body]], [[bodies]], [[group]] and [[plane]]: the contents of a scene."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from carom.scene.schema.contact import Surface
from carom.scene.schema.motion import WallMotion
from carom.scene.schema.part_of_space import Region
from carom.scene.schema.piston import Piston
from carom.scene.schema.quantity import (
    MOST,
    ORIGIN,
    AnyReal,
    Count,
    Name,
    NonNegative,
    Positive,
    Real,
    Section,
    Vector,
)
from carom.scene.schema.release import Release
from carom.scene.units.dimension import ANGULAR_VELOCITY, DENSITY, LENGTH, MASS, TIME, VELOCITY

SOLID = 2 / 5  # moment of inertia of a solid sphere, divided by m r²


class Matter(Section):
    """The matter of a sphere: a density or a mass, not both."""

    density: Annotated[Positive, DENSITY] | None = Field(
        None, description="kg/m³, density; 1000 unless a mass or a material is given; more than 0"
    )
    mass: Annotated[NonNegative, MASS] | None = Field(
        None,
        description="kg, mass of each body, instead of a density; 0 for test particles, which are attracted but "
        "attract nothing, and need contact.enabled = false",
    )
    inertia_factor: Positive | None = Field(
        None,
        le=2 / 3,
        description="moment of inertia over m r²; by default 2/5, as for a solid sphere; 2/3 for a thin shell",
    )
    material: str | None = Field(
        None, description="name of a [[material]], which may define the density and the inertia_factor"
    )

    @property
    def inertia_ratio(self) -> float:
        """Moment of inertia divided by m r²."""
        return SOLID if self.inertia_factor is None else self.inertia_factor

    @model_validator(mode="after")
    def _density_or_mass(self) -> Self:
        if self.density is not None and self.mass is not None:
            raise ValueError("density and mass are both given; leave one out")
        return self


class Body(Matter):
    """[[body]]: one body."""

    name: str = Field("", description="name, which the recording and warnings show")
    position: Annotated[Vector, LENGTH] = Field(ORIGIN, description="m, [x, y, z] of the centre")
    velocity: Annotated[Vector, VELOCITY] = Field(ORIGIN, description="m/s, [x, y, z]")
    angular_velocity: Annotated[Vector, ANGULAR_VELOCITY] = Field(ORIGIN, description="rad/s, [x, y, z]")
    radius: Annotated[Positive, LENGTH] = Field(1.0, description="m; more than 0")
    fixed: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: the body neither moves nor rotates, whatever acts on it"
    )

    @model_validator(mode="after")
    def _a_fixed_body_does_not_move(self) -> Self:
        if self.fixed and any((*self.velocity, *self.angular_velocity)):
            raise ValueError(
                "fixed = true with a velocity or an angular_velocity; leave them out, or set fixed = false"
            )
        return self


Axes = tuple[Name, Name, Name] | tuple[Name, Name]
DIGEST = r"^[0-9a-f]{64}$"
# pairs of keys that determine each other
_RIVALS = {"mass": "density", "density": "mass", "inertia": "inertia_factor", "diameter": "radius"}


class Columns(Section):
    """The column of a file for each quantity; where none is given, the usual name is used."""

    position: Axes | Name | None = Field(
        None, description="m; three columns, two in the plane z = 0, or one that holds [x, y, z]"
    )
    velocity: Axes | Name | None = Field(None, description="m/s; three columns, or one that holds [x, y, z]")
    angular_velocity: Axes | Name | None = Field(None, description="rad/s; three columns, or one that holds [x, y, z]")
    mass: Name | None = Field(None, description="kg")
    density: Name | None = Field(None, description="kg/m³, instead of a mass")
    radius: Name | None = Field(None, description="m")
    diameter: Name | None = Field(None, description="m, instead of a radius")
    inertia: Name | None = Field(None, description="kg m², moment of inertia, instead of `inertia_factor`")
    fixed: Name | None = Field(None, description="true or 1: the body neither moves nor rotates")
    name: Name | None = Field(None, description="names of the bodies")
    header: tuple[Name, ...] | None = Field(
        None, description="names of all columns, for a text file without a header; also columns = [...]"
    )


class _OrNames:
    """States in the JSON schema that a list of names may replace a section."""

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        """Describe a section, or a list of names."""
        return {"anyOf": [handler(core), {"type": "array", "items": {"type": "string", "minLength": 1}}]}


class KeplerianOrbits(Section):
    """How a file of orbital elements is read. Its columns are a or q, e, i, om, w, and ma or tp."""

    central_mass: Annotated[Positive, MASS] | None = Field(
        None, description="kg, mass of the body at rest at the origin; more than 0"
    )
    central_body: Name | None = Field(
        None,
        description="name of the [[body]] instead of central_mass; orbits are relative to its position and velocity",
    )
    epoch: Real | None = Field(
        None,
        description="initial time of the scene, in the unit of the columns epoch and tp, such as a Julian date; by "
        "default the time of the file",
    )
    angle: Literal["deg", "rad"] | None = Field(
        None, description="unit of the angles; by default the unit of the file or of [units], else degrees"
    )

    @model_validator(mode="after")
    def _one_centre(self) -> Self:
        if (self.central_mass is None) == (self.central_body is None):
            raise ValueError("orbit needs either a central_mass or a central_body")
        return self


class Missing(Section):
    """Replacements for missing values in a file: used for entries that are empty, not a number, or a size of 0."""

    radius: Annotated[Positive, LENGTH] | None = Field(
        None, description="m, radius of bodies without a radius or diameter in the file"
    )
    mass: Annotated[NonNegative, MASS] | None = Field(
        None, description="kg, mass of bodies without a mass in the file; a mass of 0 is kept"
    )
    density: Annotated[Positive, DENSITY] | None = Field(
        None, description="kg/m³, density of bodies without a density in the file"
    )
    leave_out: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: leave out rows without a position, such as rows of bodies that have merged"
    )


class BodyData(Matter):
    """[[bodies]]: many bodies, from a file or from arrays; a value given here applies to all of them."""

    name: str = Field("", description="name, which the recording shows with a number for each body")
    file: Name | None = Field(
        None,
        description=".csv, .txt, .parquet, .arrow, .npz, .h5, .bin (REBOUND) or another of docs/data.md; relative to "
        "the scene",
    )
    columns: Annotated[
        Columns,
        _OrNames(),
        BeforeValidator(lambda value: {"header": value} if isinstance(value, list | tuple) else value),
    ] = Field(Columns(), description="names of the columns; by default the usual names")
    snapshot: Annotated[int, Field(strict=True, gt=-MOST, lt=MOST)] = Field(
        -1, description="step of a file with several steps, counted from 0, or from the end: -1 is the last"
    )
    snapshot_time: Annotated[Real, TIME] | None = Field(
        None, description="s, time of the snapshot, instead of its number; the nearest one is read"
    )
    missing: Missing | None = Field(
        None, description="{ radius, mass, density, leave_out }, for rows of the file that lack a value"
    )
    orbit: KeplerianOrbits | None = Field(
        None,
        description="{ central_mass or central_body, epoch, angle }, for a file with orbital elements instead of "
        "positions",
    )
    origin: Annotated[Vector, LENGTH] | None = Field(
        None, description="m, the point [x, y, z] of the file that becomes the origin of the scene"
    )
    radius: Annotated[Positive, LENGTH] | None = Field(
        None, description="m, radius of all bodies, instead of a column; more than 0"
    )
    velocity: Annotated[Vector, VELOCITY] | None = Field(
        None, description="m/s, velocity [x, y, z] of all bodies, instead of columns"
    )
    angular_velocity: Annotated[Vector, ANGULAR_VELOCITY] | None = Field(
        None, description="rad/s, angular velocity [x, y, z] of all bodies, instead of columns"
    )
    fixed: Annotated[bool, Field(strict=True)] | None = Field(
        None, description="true: the bodies neither move nor rotate; the key replaces a column"
    )
    count: Count | None = Field(None, description="number of bodies; written by carom, and checked if given")
    sha256: Annotated[str, Field(strict=True, pattern=DIGEST)] | None = Field(
        None, description="digest of the file, 64 hexadecimal digits; written by carom, and checked if given"
    )

    @model_validator(mode="after")
    def _one_source_for_each_quantity(self) -> Self:
        for quantity in sorted(self.columns.model_fields_set - {"name", "header"}):
            for given in (quantity, _RIVALS.get(quantity)):
                if given in self.model_fields_set:
                    raise ValueError(f"{given} and columns.{quantity} are both given; leave one out")
        if {"snapshot", "snapshot_time"} <= self.model_fields_set and self.snapshot_time is not None:
            raise ValueError("snapshot and snapshot_time are both given; leave one out")
        if self.orbit is not None:
            keys = self.columns.model_fields_set & {"position", "velocity"}
            others = sorted(f"columns.{key}" for key in keys) + (["velocity"] if self.velocity is not None else [])
            if others:
                raise ValueError(f"orbit and {others[0]} are both given; leave one out")
        return self

    @property
    def called(self) -> str:
        """The source of the bodies, as messages name it."""
        return self.file or "the arrays"

    def is_like(self, other: BodyData) -> bool:
        """Return whether two tables describe the same bodies; names and digests may differ."""
        return all(
            getattr(self, key) == getattr(other, key)
            for key in type(self).model_fields
            if key not in ("name", "count", "sha256")
        )


STEEPEST = 300  # largest ratio of radii in decades, if they are distributed by a power law
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
    distribution: Literal["uniform", "log-uniform", "power-law"] = Field(
        "uniform", description="distribution of the radii"
    )
    exponent: Real = Field(-3.5, description="exponent of the power law, dN/dr ∝ r^exponent")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min > self.max:
            raise ValueError("min is above max; swap them")
        if abs(self.exponent + 1.0) * math.log10(self.max / self.min) > STEEPEST:
            raise ValueError(
                f"exponent = {self.exponent:g} is too steep for such different radii; lower it or their ratio"
            )
        return self


class Velocity(Section):
    """Velocities of a group: a Maxwellian distribution about a mean."""

    mean: Annotated[Vector, VELOCITY] = Field(ORIGIN, description="m/s, [x, y, z]")
    dispersion: Annotated[NonNegative, VELOCITY] = Field(
        0.0, description="m/s, standard deviation of each component; not negative"
    )
    virial: NonNegative | None = Field(
        None,
        description="kinetic over potential energy of a plummer region, whose velocities are added; 0.5 is equilibrium",
    )


class Spin(Section):
    """Spins of a group: a Maxwellian distribution about its bulk rotation."""

    dispersion: Annotated[NonNegative, ANGULAR_VELOCITY] = Field(
        0.0, description="rad/s, standard deviation of each component; not negative"
    )


class BodyGroup(Matter):
    """[[group]]: many bodies at random positions or on a lattice, without overlaps."""

    name: str = Field("", description="shown in the recording")
    count: Count = Field(100, description="number of bodies; 1 or more")
    radius: Annotated[RadiusRange, LENGTH, BeforeValidator(_constant_as_range)] = Field(
        RadiusRange(min=1.0, max=1.0), description="m, one number or { min, max, distribution }"
    )
    region: Region | None = Field(
        None,
        description="where the bodies are placed; by default a ball that is one tenth full, or a domain without open "
        "sides if they find no place in it",
    )
    arrangement: Literal["random", "compressed", "cubic", "fcc", "hcp"] = Field(
        "random",
        description="random positions, up to a packing of 0.38; compressed, random positions up to 0.62 (more with "
        "unequal radii), shared with all compressed groups in the same region; or a lattice",
    )
    spacing: Annotated[Positive, LENGTH] | None = Field(
        None, description="m, distance of neighbours on a lattice; by default the bodies fill the region"
    )
    velocity: Velocity = Field(Velocity(), description="{ mean, dispersion, virial } in m/s")
    spin: Spin = Field(Spin(), description="{ dispersion } in rad/s")
    bulk_rotation: Annotated[Vector, ANGULAR_VELOCITY] = Field(
        ORIGIN,
        description="rad/s, angular velocity [x, y, z] with which the whole group rotates rigidly about its centre",
    )
    release: Release | None = Field(
        None, description="{ at, rate, until }: when the bodies enter; by default they exist from the start"
    )

    @model_validator(mode="after")
    def _arranged_where_it_can_be(self) -> Self:
        shape = None if self.region is None else self.region.shape
        if self.spacing is not None and self.arrangement not in LATTICES:
            raise ValueError(f'spacing with arrangement = "{self.arrangement}"; use {", ".join(LATTICES)}')
        if self.arrangement in LATTICES and self.region is None:
            raise ValueError(f'arrangement = "{self.arrangement}" needs a region')
        if self.arrangement != "random" and shape == "plummer":
            raise ValueError(
                f'arrangement = "{self.arrangement}" in a plummer region, which is random; remove one of them'
            )
        if self.velocity.virial is not None and shape != "plummer":
            raise ValueError('velocity.virial without a region of shape = "plummer"; remove it')
        if self.velocity.virial is not None and self.mass == 0.0:
            raise ValueError("velocity.virial of test particles (mass = 0), which have no potential; remove it")
        return self


class SolidPlane(Surface):
    """[[plane]]: a half-space, at rest by default; the normal points out of the solid.

    Its coefficients apply to all contacts with it; missing ones are combined from both materials.
    """

    name: str = Field("", description="shown in warnings")
    point: Annotated[Vector, LENGTH] = Field(ORIGIN, description="m, position [x, y, z] of any point on the surface")
    normal: tuple[AnyReal, AnyReal, AnyReal] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction out of the solid, of any length but 0"
    )
    material: str | None = Field(None, description="name of a [[material]], instead of coefficients")
    motion: WallMotion | None = Field(None, description="a prescribed motion; at rest by default")
    piston: Piston | None = Field(None, description="a mass and a force that move it, instead of a prescribed motion")

    @property
    def translates(self) -> bool:
        """Whether the plane moves."""
        return self.piston is not None or (self.motion is not None and self.motion.translates)

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.normal):
            raise ValueError(
                "normal = [0, 0, 0] has no direction; give the direction out of the solid, such as [0, 0, 1]"
            )
        if self.motion is not None and self.motion.rotation:
            raise ValueError("motion.rotation of a plane, which has no axis; use a [[wall]] with a disc, or remove it")
        if self.motion is not None and self.piston is not None:
            raise ValueError("motion and piston are both given; leave one out")
        return self
