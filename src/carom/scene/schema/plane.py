"""[[plane]]: a static half-space."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from carom.scene.schema.contact import Contact, Material
from carom.scene.schema.quantity import ORIGIN, AnyReal, Friction, Section, Vector
from carom.scene.units.dimension import LENGTH


class Plane(Section):
    """[[plane]]: a static half-space; the normal points out of the solid."""

    name: str = Field("", description="shown in warnings")
    point: Annotated[Vector, LENGTH] = Field(ORIGIN, description="m, [x, y, z] of any point of the surface")
    normal: tuple[AnyReal, AnyReal, AnyReal] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction out of the solid; any length but 0"
    )
    restitution: AnyReal | None = Field(None, ge=0, le=1, description="as in [contact], whose value is the default")
    static_friction: Friction | None = Field(None, description="as in [contact], whose value is the default")
    kinetic_friction: Friction | None = Field(
        None, description="as in [contact], whose value is the default; at most static_friction"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.normal):
            raise ValueError(
                "normal = [0, 0, 0] is no direction; give the direction out of the solid, such as [0, 0, 1]"
            )
        return self

    @model_validator(mode="after")
    def _sliding_is_not_harder_than_starting(self) -> Self:
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is not None and kinetic is not None and kinetic > static:
            raise ValueError(
                f"kinetic_friction = {kinetic:g} is above static_friction = {static:g}; it must be the smaller"
            )
        return self

    def material(self, contact: Contact) -> Material:
        """Return the coefficients at the plane; a missing coefficient of friction adapts to the one that is given."""
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is None:
            static = contact.static_friction if kinetic is None else max(kinetic, contact.static_friction)
        if kinetic is None:
            kinetic = min(static, contact.kinetic_friction)
        restitution = contact.restitution if self.restitution is None else self.restitution
        return Material(restitution, static, kinetic)
