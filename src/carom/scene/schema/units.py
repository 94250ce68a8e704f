"""[units]: the units of the plain numbers of a scene."""

from __future__ import annotations

from pydantic import Field

from carom.scene.schema.quantity import Section


class Units(Section):
    """[units]: the units of plain numbers, and of what carom prints. The simulation and the recording are in SI."""

    length: str | None = Field(None, description='such as "km" or "au"; m by default')
    time: str | None = Field(None, description='such as "h" or "day"; s by default')
    mass: str | None = Field(None, description='such as "g" or "solar mass"; kg by default')
    angle: str | None = Field(None, description='such as "deg"; rad by default')
    velocity: str | None = Field(None, description='such as "km/s"; by default the length over the time')
    acceleration: str | None = Field(
        None, description='such as "standard gravity"; by default the length over the time squared'
    )
    angular_velocity: str | None = Field(None, description='such as "rpm"; by default the angle over the time')
    density: str | None = Field(None, description='such as "g/cm^3"; by default the mass over the length cubed')
    energy: str | None = Field(
        None, description='such as "erg", printed only; by default mass times length squared over time squared'
    )
