"""Matter of a sphere: a density or a mass, and how it is spread."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.quantity import NonNegative, Positive, Section
from carom.scene.units.dimension import DENSITY, MASS

SOLID = 2 / 5  # moment of inertia over m r² of a solid sphere


class Matter(Section):
    """Matter of a sphere: a density or a mass, not both."""

    density: Annotated[Positive, DENSITY] | None = Field(
        None, description="kg/m³, 1000 unless mass or a material is given; more than 0"
    )
    mass: Annotated[NonNegative, MASS] | None = Field(
        None,
        description="kg, of each body, in place of a density; 0 for test particles, which are attracted and do not "
        "attract, and need contact.enabled = false",
    )
    inertia_factor: Positive | None = Field(
        None,
        le=2 / 3,
        description="moment of inertia over m r²: 2/5, a solid sphere, unless given; 2/3 for a thin shell",
    )
    material: str | None = Field(
        None, description="name of a [[material]], which may give the density and the inertia_factor"
    )

    @property
    def inertia_ratio(self) -> float:
        """Moment of inertia over m r²."""
        return SOLID if self.inertia_factor is None else self.inertia_factor

    @model_validator(mode="after")
    def _density_or_mass(self) -> Self:
        if self.density is not None and self.mass is not None:
            raise ValueError("density and mass are both given; leave one out")
        return self
