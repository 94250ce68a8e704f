"""Restitution of viscoelastic spheres: faster impacts dissipate more.

A Hertzian contact whose material is viscoelastic rebounds with a coefficient that depends on the closing speed v alone
(Schwager & Pöschel 2008). Its Padé approximant (Müller & Pöschel, Phys. Rev. E 84, 021302, 2011) is within 0.01 of the
solution of the equation of motion at any speed:

    e(v) = (1 + c₁ x) / (1 + b₁ x + b₂ x² + b₃ x³ + b₄ x⁴),    x ∝ v^{1/10}

For slow impacts, e = 1 - b₂ x² + … is the series 1 - C₁ A v^{1/5} + … of Ramírez et al. (1999). A scene states one
measured coefficient and its speed. They fix the factor of x, and with it the curve.

In reality, the curve also depends on the sizes of the bodies. Here all pairs of two materials have the same curve.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Annotated, Any

from pydantic import Field

from carom.extend import VELOCITY, ContactLaw, Positive, Section

C1, B1, B2, B3, B4 = 0.501086, 0.501086, 1.15345, 0.577977, 0.532178
HALVINGS = 80  # of an interval of x; the last ones change nothing
MOST = 1e3  # largest x, where e = 9e-10
NEWTON_STEPS = 5  # from 8 % to round-off


class Viscoelastic(Section):
    """[contact.viscoelastic]: restitution of viscoelastic spheres, which falls with the speed of an impact."""

    restitution: float = Field(strict=True, gt=1e-6, lt=1, description="e at ``speed``; more than 1e-6, less than 1")
    speed: Annotated[Positive, VELOCITY] = Field(description="m/s, closing speed at which ``restitution`` was measured")


def numbers(section: Viscoelastic) -> dict[str, float]:
    """Return x at the stated speed, by bisection, and that speed."""
    low, high = 0.0, MOST
    for _ in range(HALVINGS):
        x = 0.5 * (low + high)
        e = restitution(SimpleNamespace(measured_x=x, measured_speed=1.0), 1.0, 0.0)
        low, high = (x, high) if e > section.restitution else (low, x)
    return {"measured_x": 0.5 * (low + high), "measured_speed": section.speed}


def restitution(p: Any, approach: float, rest_speed: float) -> float:
    """Return e(v); 0 for contacts that close no faster than the rest speed."""
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


def dissipates(p: Any) -> bool:
    """Return True: e < 1 at any speed."""
    return True


LAW = ContactLaw(Viscoelastic, restitution=restitution, dissipates=dissipates, coefficients=numbers)
