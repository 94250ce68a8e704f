"""[group.release] and [[outlet]]: bodies that enter during a run, and bodies that leave it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from carom.scene.schema.part_of_space import Region
from carom.scene.schema.quantity import AnyReal, NonNegative, Positive, Section, Vector
from carom.scene.units.dimension import LENGTH, RATE, TIME


class Release(Section):
    """[group.release]: when the bodies of a group enter.

    A body that waits is outside of the physics. The body enters at its place, with the velocity and the spin of the
    scene, as soon as nothing overlaps it there.
    """

    at: Annotated[NonNegative, TIME] = Field(0.0, description="s, time at which the first body enters; not negative")
    rate: Annotated[Positive, RATE] | None = Field(
        None, description="1/s, rate at which bodies enter one by one, in their order; by default, all enter together"
    )
    until: Annotated[Positive, TIME] | None = Field(
        None, description="s, time after which no body of the group enters; by default the end of the run"
    )

    @model_validator(mode="after")
    def _begins_before_it_ends(self) -> Self:
        if not self.model_fields_set & {"at", "rate"}:
            raise ValueError("release needs the key at or rate, such as { at = 2.0 } or { rate = 500.0 }")
        if self.until is not None and self.until <= self.at:
            raise ValueError(f"until = {self.until:g} is not after at = {self.at:g}; raise it, or remove it")
        return self


class Outlet(Section):
    """[[outlet]]: a region, or the side of a plane, whose bodies leave.

    A body leaves if its centre is there at the beginning of a step. Fixed bodies do not leave.
    """

    name: str = Field("", description="shown in the recording")
    region: Region | None = Field(
        None, description="a ball, a box, a cylinder or a shell; a body leaves if its centre is in it"
    )
    point: Annotated[Vector, LENGTH] | None = Field(
        None, description="m, [x, y, z] of any point on a plane, instead of a region; a body that crosses it leaves"
    )
    normal: tuple[AnyReal, AnyReal, AnyReal] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction from the plane to the bodies that stay, of any length but 0"
    )
    to: Literal["inlet", "out"] = Field(
        "inlet", description="inlet: the body enters again as its group does; out: it stays outside"
    )

    @model_validator(mode="after")
    def _is_one_place(self) -> Self:
        if (self.region is None) == (self.point is None):
            raise ValueError("an outlet needs either a region or a point of a plane")
        if self.region is not None and "normal" in self.model_fields_set:
            raise ValueError("normal of a region; it belongs to a plane, so remove it, or give a point instead")
        if self.region is not None and self.region.shape == "plummer":
            raise ValueError('region.shape = "plummer" has no border; use "ball"')
        if not any(self.normal):
            raise ValueError("normal = [0, 0, 0] has no direction; give the direction to the bodies that stay")
        return self
