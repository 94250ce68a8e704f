"""A harmonic trap about the origin.

a = -ω² x,    U = ½ m ω² x²
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from carom.extend import ANGULAR_VELOCITY, BodyForce, Positive, Section


class Trap(Section):
    """[forces.trap]: a harmonic trap about the origin, a = -ω² x."""

    frequency: Annotated[Positive, ANGULAR_VELOCITY] = Field(description="rad/s, ω; more than 0")


def acceleration(x: float, y: float, z: float, p: Any) -> tuple[float, float, float]:
    """Return a at a position, in m/s²."""
    k = p.frequency * p.frequency
    return -k * x, -k * y, -k * z


def potential(x: float, y: float, z: float, p: Any) -> float:
    """Return the potential in J/kg."""
    energy: float = 0.5 * p.frequency * p.frequency * (x * x + y * y + z * z)
    return energy


TRAP = BodyForce(Trap, acceleration, potential, meaning="potential energy in the trap", periodic=True)
