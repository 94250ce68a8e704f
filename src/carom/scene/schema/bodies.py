"""[[bodies]]: many bodies, from a file or from arrays."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.matter import Matter
from carom.scene.schema.quantity import Count, Positive, Section, Vector
from carom.scene.units.dimension import ANGULAR_VELOCITY, LENGTH, VELOCITY

Name = Annotated[str, Field(strict=True, min_length=1)]
Axes = tuple[Name, Name, Name]
DIGEST = r"^[0-9a-f]{64}$"
_RIVALS = {  # of which one follows from the other
    **{"mass": "density", "density": "mass", "inertia": "inertia_factor", "diameter": "radius"}
}


class Columns(Section):
    """Which columns of a file hold which quantity; those left out are found by their usual names."""

    position: Axes | Name | None = Field(None, description="m; three columns, or one that holds [x, y, z]")
    velocity: Axes | Name | None = Field(None, description="m/s; three columns, or one that holds [x, y, z]")
    angular_velocity: Axes | Name | None = Field(None, description="rad/s; three columns, or one of [x, y, z]")
    mass: Name | None = Field(None, description="kg")
    density: Name | None = Field(None, description="kg/m³, in place of a mass")
    radius: Name | None = Field(None, description="m")
    diameter: Name | None = Field(None, description="m, in place of a radius")
    inertia: Name | None = Field(None, description="kg m², moment of inertia, in place of inertia_factor")
    fixed: Name | None = Field(None, description="true or 1: the body neither moves nor turns")
    name: Name | None = Field(None, description="names of the bodies")


class BodyData(Matter):
    """[[bodies]]: many bodies, from a file or from arrays; a value given here holds for all of them."""

    name: str = Field("", description="shown in the recording with a number for each body")
    file: Name | None = Field(
        None, description=".csv, .tsv, .parquet, .arrow, .feather, .npz, .h5 or .bin (REBOUND); relative to the scene"
    )
    columns: Columns = Field(Columns(), description="names of the columns; by default the usual ones are found")
    snapshot: Annotated[int, Field(strict=True)] = Field(
        -1, description="which step of a file of several, counted from 0, or from the end with -1, the last"
    )
    radius: Annotated[Positive, LENGTH] | None = Field(
        None, description="m, of all bodies, in place of a column; more than 0"
    )
    velocity: Annotated[Vector, VELOCITY] | None = Field(
        None, description="m/s, [x, y, z], of all bodies, in place of columns"
    )
    angular_velocity: Annotated[Vector, ANGULAR_VELOCITY] | None = Field(
        None, description="rad/s, [x, y, z], of all bodies, in place of columns"
    )
    fixed: Annotated[bool, Field(strict=True)] | None = Field(
        None, description="true: the bodies neither move nor turn; in place of a column"
    )
    count: Count | None = Field(None, description="number of bodies; written by carom, and checked if given")
    sha256: Annotated[str, Field(strict=True, pattern=DIGEST)] | None = Field(
        None, description="digest of the file, 64 hexadecimal digits; written by carom, and checked if given"
    )

    @model_validator(mode="after")
    def _one_source_for_each_quantity(self) -> Self:
        for quantity in sorted(self.columns.model_fields_set - {"name"}):
            for given in (quantity, _RIVALS.get(quantity)):
                if given in self.model_fields_set:
                    raise ValueError(f"{given} and columns.{quantity} are both given; leave one out")
        return self

    @property
    def called(self) -> str:
        """What messages call the source of the bodies."""
        return self.file or "the arrays"

    def is_like(self, other: BodyData) -> bool:
        """Tell whether both describe the same bodies, whatever they say about names and digests."""
        return all(
            getattr(self, key) == getattr(other, key)
            for key in type(self).model_fields
            if key not in ("name", "count", "sha256")
        )
