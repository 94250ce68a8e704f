"""[gravity], [drag] and [forces]: the forces on the bodies."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from pydantic.fields import FieldInfo

from carom import registry
from carom.scene.schema.quantity import LARGEST, ORIGIN, NonNegative, Positive, Section, Vector
from carom.scene.units.dimension import ACCELERATION, GRAVITATIONAL_CONSTANT, LENGTH, TIME, VELOCITY


class Gravity(Section):
    """[gravity]: the gravity between bodies, and a uniform field."""

    constant: Annotated[NonNegative, GRAVITATIONAL_CONSTANT] = Field(
        6.6743e-11, description="m³ kg⁻¹ s⁻², gravitational constant; 0 for no gravity; not negative"
    )
    method: Literal["auto", "direct", "tree", "fast-multipole", "none"] = Field(
        "auto",
        description="how gravity is summed; auto uses a tree for 5000 bodies or more; fast-multipole conserves "
        "momentum and is faster at small errors",
    )
    opening_angle: Positive = Field(
        0.5,
        le=1,
        description="radians; with a tree, a box whose angular radius is smaller attracts as a whole; with "
        "fast-multipole, two boxes whose radii together subtend a smaller angle do; more than 0, at most 1",
    )
    quadrupoles: Annotated[bool, Field(strict=True)] = Field(
        True, description="tree only: false treats distant boxes as points, which is faster and less accurate"
    )
    softening: Annotated[NonNegative, LENGTH] = Field(0.0, description="m, Plummer softening length; not negative")
    uniform: Annotated[Vector, ACCELERATION] = Field(ORIGIN, description="m/s², a uniform field [x, y, z]")


class Drag(Section):
    """[drag]: Stokes' drag in a medium, a = -(v - u)/τ."""

    relaxation_time: Annotated[Positive, TIME] = Field(
        description="s, τ, time in which the velocity relative to the medium falls to 1/e; more than 0"
    )
    medium_velocity: Annotated[Vector, VELOCITY] = Field(
        ORIGIN, description="m/s, u, the velocity [x, y, z] of the medium"
    )

    @model_validator(mode="after")
    def _the_push_of_the_medium_is_a_number(self) -> Self:
        largest = max(map(abs, self.medium_velocity))
        if largest > LARGEST * self.relaxation_time:
            raise ValueError(
                f"medium_velocity / relaxation_time is more than {LARGEST:g}; raise relaxation_time, or choose other "
                "units"
            )
        return self


class InstalledForces(Section):
    """[forces]: the forces of installed packages, with a section for each force that acts."""

    @property
    def given(self) -> dict[str, Any]:
        """The sections of the scene by the names of their forces, in alphabetical order."""
        return {name: section for name, section in sorted(self) if section is not None}


class _NotLoaded(Section):
    """A section of a force or a contact law that cannot be loaded."""

    @model_validator(mode="before")
    @classmethod
    def _say_why(cls, given: Any) -> Any:
        raise ValueError(cls.__doc__)


class Forces(Section):
    """The keys of the forces in a scene."""

    gravity: Gravity = Field(Gravity(), description="gravity between bodies, and a uniform field")
    drag: Drag | None = Field(None, description="Stokes' drag in a medium; none by default")
    forces: InstalledForces = Field(
        InstalledForces(), description="forces of installed packages, with a section for each"
    )


def section_of(kind: str, name: str) -> Any:
    """Return the section's model for a part of an installed package; it states why a part cannot be loaded."""
    try:
        return registry.load(kind, name).section
    except registry.ExtensionError as error:
        return type("NotLoaded", (_NotLoaded,), {"__doc__": str(error), "__module__": __name__})


@cache
def know_installed_forces(*holders: type[Section]) -> None:
    """Add a field for each force of an installed package to `InstalledForces` and the models that contain it.

    This is done when a scene is first used, not when this module is imported: a package that defines a force imports
    this module.
    """
    names = registry.installed("forces")
    for name in names:
        section = section_of("forces", name)
        meaning = (section.__doc__ or "").partition(": ")[2] or section.__doc__
        InstalledForces.model_fields[name] = FieldInfo(annotation=section | None, default=None, description=meaning)
    if names:
        InstalledForces.model_rebuild(force=True)
        for model in holders:
            model.model_rebuild(force=True)
