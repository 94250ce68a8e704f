"""Restitution of viscoelastic spheres: faster impacts dissipate more.

In a Hertzian contact between two given viscoelastic spheres, the coefficient of restitution depends only on the closing
speed v (Schwager & Pöschel 2008). Its Padé approximant (Müller & Pöschel, Phys. Rev. E 84, 021302, 2011) agrees with
the solution of the equation of motion within 0.01 at any speed:

    e(v) = (1 + c₁ x) / (1 + b₁ x + b₂ x² + b₃ x³ + b₄ x⁴),    x ∝ v^{1/10} (√r/m)^{1/5}

with the reduced radius r and the reduced mass m of the two bodies. For slow impacts, e = 1 - b₂ x² + … is the series
1 - C₁ A v^{1/5} + … of Ramírez et al. (1999). A scene states one measured coefficient and its speed, which determine
the factor of x for the measured spheres, and thus the curve. If the scene also states the radius and the density of
these spheres, larger bodies rebound faster and smaller bodies more slowly, since 1 - e ∝ 1/R for equal spheres of one
material. Otherwise all pairs of two materials have the same curve.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from carom.extend import DENSITY, LENGTH, VELOCITY, ContactLaw, Positive, Section

C1, B1, B2, B3, B4 = 0.501086, 0.501086, 1.15345, 0.577977, 0.532178
HALVINGS = 80  # number of halvings of an interval of x; the last halvings change nothing
MOST = 1e3  # largest x, where e = 9e-10
NEWTON_STEPS = 5  # number of steps that reduce an error of 8 % to round-off


class Viscoelastic(Section):
    """[contact.viscoelastic]: restitution of viscoelastic spheres, which falls with the speed of an impact."""

    restitution: float = Field(strict=True, gt=1e-6, lt=1, description="e at ``speed``; more than 1e-6, less than 1")
    speed: Annotated[Positive, VELOCITY] = Field(description="m/s, closing speed at which ``restitution`` was measured")
    radius: Annotated[Positive, LENGTH] | None = Field(
        None, description="m, radius of the two equal spheres that were measured; by default, sizes do not matter"
    )
    density: Annotated[Positive, DENSITY] | None = Field(None, description="kg/m³, of these spheres")

    @model_validator(mode="after")
    def _knows_the_spheres(self) -> Self:
        if (self.radius is None) != (self.density is None):
            given, missing = ("density", "radius") if self.radius is None else ("radius", "density")
            raise ValueError(f"{given} without {missing}; give both of the spheres that were measured, or neither")
        return self


def numbers(section: Viscoelastic) -> dict[str, float]:
    """Return x at the stated speed (found by bisection), the speed, and r/m² of the measured spheres in m/kg²."""
    low, high = 0.0, MOST
    for _ in range(HALVINGS):
        x = 0.5 * (low + high)
        e = restitution(SimpleNamespace(measured_x=x, measured_speed=1.0), 1.0, 0.0)
        low, high = (x, high) if e > section.restitution else (low, x)
    size = 0.0  # sizes of bodies do not matter
    if section.radius is not None and section.density is not None:
        mass = 0.5 * section.density * 4.0 / 3.0 * math.pi * section.radius**3
        size = 0.5 * section.radius / (mass * mass)
    return {"measured_x": 0.5 * (low + high), "measured_speed": section.speed, "measured_size": size}


def restitution(p: Any, approach: float, rest_speed: float) -> float:
    """Return e(v) of the measured spheres; 0 for contacts that close no faster than the rest speed."""
    if not approach > rest_speed:
        return 0.0
    ratio = approach / p.measured_speed
    # the fifth root by Newton's iteration: y⁵ = ratio, from ratio^{1/8 + 1/16 + 1/64}
    eighth = math.sqrt(math.sqrt(math.sqrt(ratio)))
    sixteenth = math.sqrt(eighth)
    y = eighth * sixteenth * math.sqrt(math.sqrt(sixteenth))
    for _ in range(NEWTON_STEPS):
        y += (ratio / (y * y * y * y) - y) / 5.0
    x = p.measured_x * math.sqrt(y)
    e: float = (1.0 + C1 * x) / (1.0 + x * (B1 + x * (B2 + x * (B3 + x * B4))))
    return e


def equivalent_speed(p: Any, approach: float, mass: float, radius: float) -> float:
    """Return the speed at which the measured spheres have the restitution of the given bodies."""
    speed: float = approach
    if p.measured_size > 0.0:
        speed *= radius / (mass * mass) / p.measured_size
    return speed


def dissipates(p: Any) -> bool:
    """Return True: e < 1 at any speed."""
    return True


LAW = ContactLaw(
    Viscoelastic,
    restitution=restitution,
    equivalent_speed=equivalent_speed,
    dissipates=dissipates,
    coefficients=numbers,
)
