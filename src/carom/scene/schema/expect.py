"""[expect]: promises that are checked at the end."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carom.scene.schema.quantity import Count, NonNegative, Positive, Section
from carom.scene.units.dimension import TIME

ABOUT_THE_END = ("final_kinetic", "impacts")  # promises that apply only to a run of the promised duration


class Expect(Section):
    """[expect]: promises that are checked at the end; a run that misses one says so and exits with 1."""

    energy_error: NonNegative | None = Field(
        None,
        description="largest |integration error| over the energy scale, or energy put in by contacts if that is more",
    )
    energy_gain: NonNegative | None = Field(
        None,
        description="largest rise of the total energy above its lowest so far, over the energy scale, among the "
        "checks of the energy",
    )
    momentum_error: NonNegative | None = Field(None, description="largest change of momentum over its scale")
    angular_momentum_error: NonNegative | None = Field(
        None, description="largest change of angular momentum over its scale"
    )
    max_overlap: NonNegative | None = Field(None, description="deepest overlap over the smaller radius")
    final_kinetic: NonNegative | None = Field(
        None, description="kinetic energy at the end, of motion and spin, over the energy scale"
    )
    impacts: Count | None = Field(None, description="smallest number of impacts; 1 or more")
    contact_audit: NonNegative | None = Field(
        None,
        description="largest change of a speed or of the ledger in a step that impulses and forces do not explain",
    )
    duration: Annotated[Positive, TIME] | None = Field(
        None,
        description="s, the duration for which final_kinetic, impacts and warned are promised; default: that of [time]",
    )
    warned: tuple[Literal["energy-rise", "energy-ledger", "energy-lost", "limit"], ...] = Field(
        (), description='kinds of warnings that the run must give, such as "energy-lost"'
    )
