"""A swirl about the z axis, which drives the bodies in circles.

a = s (-y, x, 0)

Its curl is (0, 0, 2 s), so it has no potential: carom books its work in the ledger.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from carom.extend import BodyForce, Dimension, Real, Section

STRENGTH = Dimension("strength of a swirl", "1/s^2", (0, -2, 0, 0), "3 s^-2")


class Swirl(Section):
    """[forces.swirl]: a swirl about the z axis, a = s (-y, x, 0)."""

    strength: Annotated[Real, STRENGTH] = Field(description="1/s², s; anticlockwise if positive")


def acceleration(x: float, y: float, z: float, p: Any) -> tuple[float, float, float]:
    """Return a at a position, in m/s²."""
    return -p.strength * y, p.strength * x, 0.0


SWIRL = BodyForce(Swirl, acceleration, legend="swirl")
