"""[domain] shear: a periodic box whose images move past each other (Lees & Edwards 1972)."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.scene.schema.quantity import Real, Section
from carom.scene.units.dimension import RATE

Axis = Literal["x", "y", "z"]


class Shear(Section):
    """[domain.shear]: uniform shear of a periodic box, whose mean velocity is ``rate`` times the gradient's coordinate.

    The images of the box along the gradient move along the flow. The velocity of the flow is added to the initial
    velocities of groups, but not to velocities of single bodies and of data. Nothing orbits: the Coriolis and tidal
    forces of a planetary ring (Hill's approximation) are not modelled.
    """

    rate: Annotated[Real, RATE] = Field(description="1/s, change of the velocity along the gradient")
    flow: Axis = Field("x", description="axis of the mean velocity")
    gradient: Axis = Field("y", description="axis along which the mean velocity changes")

    @model_validator(mode="after")
    def _axes_differ(self) -> Self:
        if self.flow == self.gradient:
            raise ValueError(f'flow and gradient are both "{self.flow}"; choose two different axes')
        return self

    @property
    def axes(self) -> tuple[int, int]:
        """The flow and the gradient as numbers of axes."""
        return "xyz".index(self.flow), "xyz".index(self.gradient)

    def shift(self, size: FloatArray, time: float) -> float:
        """Return the displacement (m) along the flow, at a time (s), of the next image along the gradient.

        Whole lengths of the box, whose size is (3,) m, are subtracted.
        """
        flow, gradient = self.axes
        path, width = self.rate * float(size[gradient]) * time, float(size[flow])
        return path - width * math.floor(path / width + 0.5)

    def cell(self, size: FloatArray, time: float) -> FloatArray:
        """Return the vectors to the next images of the box at a time (s), (3, 3) m, each in a row."""
        flow, gradient = self.axes
        cell = np.diag(size)
        cell[gradient, flow] = self.shift(size, time)
        return cell
