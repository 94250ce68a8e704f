"""[record]: how often frames are recorded and the energy is checked."""

from __future__ import annotations

import warnings
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, Field, model_validator

from carom.scene.schema.quantity import Count, Positive, Section
from carom.scene.units.dimension import TIME


class Record(Section):
    """[record]: how often frames are recorded and the energy is checked. It never changes the physics."""

    every: Literal["auto", "step"] | Annotated[Positive, TIME] = Field(
        "auto",
        description='"auto", "step", or seconds of simulated time between frames; a frame is the end of a step, so '
        "longer steps leave fewer frames (time.max_dt limits them)",
    )
    colour_by: Literal["auto", "group", "material", "speed", "graph", "island"] = Field(
        "auto",
        description="what tells bodies apart in the viewer: group, material, speed, their colour in the collision "
        'graph, or the bodies that touch each other; "auto": material if one has a colour, else group; graph with '
        'contact.colouring = "bodies"',
    )
    impacts: Literal["auto", "all", "none"] = Field(
        "auto",
        description="impacts, and what contacts did, in the recording: all while they take at most a fifth of the "
        'file, else the largest between frames ("auto"); "all"; or "none"',
    )
    check_every: Count = Field(
        100,
        validation_alias=AliasChoices("check_every", "log_freq"),
        description="steps between energy checks, in addition to those at frames; 1 or more",
    )
    energy_tolerance: Positive = Field(
        1e-3, description="rise of the energy, relative to the energy scale, that causes a warning"
    )

    @model_validator(mode="before")
    @classmethod
    def _has_one_name_of_each_key(cls, given: Any) -> Any:
        if isinstance(given, dict) and "log_freq" in given and "check_every" in given:
            raise ValueError("log_freq is the old name of check_every: give one of the two")
        return given

    @property
    def log_freq(self) -> int:
        """The old name of ``check_every``."""
        warnings.warn("Record.log_freq is now called check_every", DeprecationWarning, stacklevel=2)
        return self.check_every
