"""[[material]] and [[pair]]: what bodies and planes are made of, and how two materials meet."""

from __future__ import annotations

import math
import re
from typing import Annotated, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from carom.scene.nearest import suggestion
from carom.scene.schema.quantity import AnyReal, Friction, Positive, Section
from carom.scene.units.dimension import DENSITY

DEFAULT = "default"  # the material of [contact]
COLOURS = ("orange", "sky-blue", "green", "yellow", "blue", "vermilion", "purple", "grey", "white")
_HEX = re.compile(r"#[0-9a-fA-F]{6}")


class Coefficients(NamedTuple):
    """Coefficients of the contact law."""

    restitution: float
    static_friction: float
    kinetic_friction: float


def combined(one: Coefficients, other: Coefficients) -> Coefficients:
    """Return the coefficients of a contact of two materials: the smaller restitution, the mean friction.

    The geometric mean, as in Box2D: friction is 0 where one of the two is smooth. A material keeps its own coefficients
    against itself, to the last bit.
    """
    if one == other:
        return one
    return Coefficients(
        min(one.restitution, other.restitution),
        _geometric_mean(one.static_friction, other.static_friction),
        _geometric_mean(one.kinetic_friction, other.kinetic_friction),
    )


def _geometric_mean(a: float, b: float) -> float:
    return a if a == b else math.sqrt(a) * math.sqrt(b)  # the product of both may underflow


class Surface(Section):
    """Coefficients of the contact law, each of which may be left out."""

    restitution: AnyReal | None = Field(
        None, ge=0, le=1, description="rebound speed over approach speed, from 0 to 1; else that of [contact]"
    )
    static_friction: Friction | None = Field(None, description="of a sticking contact; else that of [contact]")
    kinetic_friction: Friction | None = Field(
        None, description="of a sliding contact, at most static_friction; else that of [contact]"
    )

    @model_validator(mode="after")
    def _sliding_is_not_harder_than_starting(self) -> Self:
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is not None and kinetic is not None and kinetic > static:
            raise ValueError(
                f"kinetic_friction = {kinetic:g} is above static_friction = {static:g}; it must be the smaller"
            )
        return self

    @property
    def given(self) -> list[str]:
        """The coefficients that are given."""
        return [name for name in Coefficients._fields if getattr(self, name) is not None]

    def completed(self, default: Coefficients) -> Coefficients:
        """Return all coefficients; a missing coefficient of friction adapts to the one that is given."""
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is None:
            static = default.static_friction if kinetic is None else max(kinetic, default.static_friction)
        if kinetic is None:
            kinetic = min(static, default.kinetic_friction)
        restitution = default.restitution if self.restitution is None else self.restitution
        return Coefficients(restitution, static, kinetic)


def _known_colour(colour: str) -> str:
    if not _HEX.fullmatch(colour) and colour not in COLOURS:
        raise ValueError(f'"{colour}" is not "#rrggbb"; {suggestion(colour, COLOURS)}')
    return colour


class Material(Surface):
    """[[material]]: what bodies, groups and planes may be made of; they name it by ``material``."""

    name: str = Field(min_length=1, description='what bodies, groups, planes and pairs call it; not "default"')
    density: Annotated[Positive, DENSITY] | None = Field(
        None, description="kg/m³, of bodies that have no mass of their own; more than 0"
    )
    inertia_factor: Positive | None = Field(
        None, le=2 / 3, description="moment of inertia over m r²: 2/5 for a solid sphere, 2/3 for a thin shell"
    )
    colour: Annotated[str, AfterValidator(_known_colour)] | None = Field(
        None, description=f'in the viewer: "#rrggbb", or {", ".join(COLOURS)}'
    )

    @model_validator(mode="after")
    def _is_not_the_default(self) -> Self:
        if self.name == DEFAULT:
            raise ValueError(f'name = "{DEFAULT}" is the material of [contact]; choose another')
        return self


class Pair(Surface):
    """[[pair]]: the coefficients of contacts between two materials, in place of the combined ones."""

    materials: tuple[str, str] = Field(
        description='names of two materials, or of one twice for contacts of it with itself; "default" is that of '
        "[contact]"
    )

    @model_validator(mode="after")
    def _gives_a_coefficient(self) -> Self:
        if not self.given:
            raise ValueError(f"gives none of {', '.join(Coefficients._fields)}; add one, or leave the pair out")
        return self
