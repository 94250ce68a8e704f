"""The prescribed motion of a plane or a wall: rotation about its axis, and translation.

The displacement of a translating wall from its place in the scene is

    D(t) = V t + ∫ V_k dt + A sin(2π f t + φ)

with velocities V_k that change at given times.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from carom.arrays import FloatArray
from carom.scene.portable_math import cosine_and_sine
from carom.scene.schema.quantity import ORIGIN, NonNegative, Positive, Real, Section, Vector
from carom.scene.units.dimension import ANGLE, ANGULAR_VELOCITY, LENGTH, RATE, TIME, VELOCITY


class WallMotion(Section):
    """[plane.motion], [wall.motion]: a prescribed motion, whose work is an entry of the ledger."""

    rotation: Annotated[Real, ANGULAR_VELOCITY] = Field(
        0.0,
        description="rad/s, right-handed about the axis of a cylinder, cone, disc or sphere; only friction feels it",
    )
    velocity: Annotated[Vector, VELOCITY] = Field(
        ORIGIN, description="m/s, [x, y, z]: at the time t, the wall is displaced by `velocity` t"
    )
    times: Annotated[tuple[NonNegative, ...], TIME] = Field(
        (), description="s, ascending times at which the wall takes the next of `velocities`; before them it is at rest"
    )
    velocities: Annotated[tuple[Vector, ...], VELOCITY] = Field(
        (),
        description="m/s, [[x, y, z], …], one for each of `times`; the last one lasts to the end. Steps end at `times`",
    )
    amplitude: Annotated[Vector, LENGTH] = Field(
        ORIGIN, description="m, [x, y, z]: the wall is also displaced by `amplitude` sin(2π `frequency` t + `phase`)"
    )
    frequency: Annotated[Positive, RATE] | None = Field(
        None, description="1/s, frequency of the oscillation; more than 0"
    )
    phase: Annotated[Real, ANGLE] = Field(
        0.0, description='rad, phase of the oscillation; "-90 deg" starts it at rest, at -`amplitude`'
    )

    @property
    def translates(self) -> bool:
        """Whether the wall changes its place."""
        return any(self.velocity) or any(self.amplitude) or any(map(any, self.velocities))

    @property
    def moves(self) -> bool:
        """Whether the wall rotates or translates."""
        return self.translates or self.rotation != 0.0

    def displacement(self, time: float | FloatArray, normal: FloatArray | None = None) -> FloatArray:
        """Return D(t) in m at times (...) in s, (..., 3); steps compute it in a kernel.

        With a ``normal`` (3,), only the components of velocities along it count, as for a drawn plane.
        """
        t = np.asarray(time, dtype=np.float64)
        velocities = [np.array(each) for each in (self.velocity, *self.velocities)]
        if normal is not None:
            velocities = [(each * normal).sum() * normal for each in velocities]
        cycles = (self.frequency or 0.0) * t + self.phase / (2.0 * np.pi)
        _, sine = cosine_and_sine(360.0 * (cycles - np.floor(cycles)))
        shift = t[..., None] * velocities[0] + sine[..., None] * np.array(self.amplitude)
        for (begin, end), velocity in zip(pairwise((*self.times, np.inf)), velocities[1:], strict=True):
            shift = shift + (np.clip(t, begin, end) - begin)[..., None] * velocity
        return np.asarray(shift)

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if not self.model_fields_set:
            raise ValueError("motion is empty; add rotation, velocity, times and velocities, or an amplitude")
        if any(self.amplitude) and self.frequency is None:
            raise ValueError('amplitude without frequency; add the frequency, such as "30 Hz"')
        if not any(self.amplitude) and {"frequency", "phase"} & self.model_fields_set:
            given = "frequency" if self.frequency is not None else "phase"
            raise ValueError(f"{given} without amplitude; add the amplitude of the oscillation, such as [0, 0, 0.001]")
        if len(self.times) != len(self.velocities):
            given = f"{len(self.times)} times and {len(self.velocities)} velocities"
            raise ValueError(f"{given}; give a velocity for each time, [0, 0, 0] for rest")
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            raise ValueError(f"times = {list(self.times)} do not ascend; sort them, and give each only once")
        if any(self.velocity) and self.velocities:
            raise ValueError(
                "velocity and velocities are both given; add velocity to each of velocities, and remove velocity"
            )
        return self
