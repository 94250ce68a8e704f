"""The keys that a scene begins with."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from carom.scene.schema.quantity import Section
from carom.scene.schema.time import Time
from carom.scene.schema.units import Units

UNTITLED = "Untitled scene"


def called(title: str) -> str:
    """Return a title, or `UNTITLED` in place of a blank one."""
    return title if title.strip() else UNTITLED


def in_one_line(title: str) -> str:
    """Return a title without line breaks, or `UNTITLED` in place of a blank one."""
    return called(" ".join(title.splitlines()))


class Heading(Section):
    """What a scene is called, its seed, its units and its time."""

    title: Annotated[str, AfterValidator(in_one_line)] = Field(UNTITLED, description="one line; shown everywhere")
    description: str = Field("", description="what to look for, shown in the recording")
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = Field(
        0, description="seed of the random start; 0 or more, below 2**63"
    )
    units: str | Units | None = Field(
        None,
        description="the units of plain numbers, a section; or those that the scene is simulated in, a text such as "
        '"au, day, solar mass"; SI by default',
    )
    time: Time = Field(Time(), description="the duration, and how the step is chosen")
