"""Restitution as a power of the closing speed, as measured for ice and for materials that yield.

    e(v) = e₁                  up to the speed v₁
    e(v) = e₁ (v / v₁)^(-q)    above it

Bridges, Hatzes & Lin (Nature 309, 333, 1984) measured q = 0.234 for ice of Saturn's rings. Spheres that yield fully
have q = 1/4 (Johnson, *Contact Mechanics*, §11.5).
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import Field

from carom.extend import VELOCITY, ContactLaw, Positive, Section

BITS = 53  # binary digits of an exponent's fraction; the root for the last digit differs from 1 by less than round-off


class PowerLaw(Section):
    """[contact.power_law]: restitution that falls with a power of the speed of an impact."""

    restitution: float = Field(1.0, strict=True, gt=0, le=1, description="e of impacts up to ``speed``; at most 1")
    speed: Annotated[Positive, VELOCITY] = Field(description="m/s, closing speed from which restitution falls")
    exponent: Positive = Field(le=10, description="q of e ∝ v^(-q), such as 0.234 for ice and 0.25 where spheres yield")


def restitution(p: Any, approach: float, rest_speed: float) -> float:
    """Return e(v); 0 for contacts that close no faster than the rest speed."""
    if not approach > rest_speed:
        return 0.0
    if approach <= p.fastest_speed:
        return float(p.slow_restitution)
    # the power by square roots, one for each binary digit of the exponent: their bits are the same on any processor
    ratio, left = approach / p.fastest_speed, p.exponent
    power, root = 1.0, ratio
    while left >= 1.0:
        power *= ratio
        left -= 1.0
    for _ in range(BITS):
        root, left = math.sqrt(root), 2.0 * left
        if left >= 1.0:
            power *= root
            left -= 1.0
    e: float = p.slow_restitution / power
    return e


def numbers(section: PowerLaw) -> dict[str, float]:
    """Return the coefficients under names that Coulomb's law does not use."""
    return {"slow_restitution": section.restitution, "fastest_speed": section.speed, "exponent": section.exponent}


def dissipates(p: Any) -> bool:
    """Return True: fast impacts dissipate."""
    return True


LAW = ContactLaw(PowerLaw, restitution=restitution, dissipates=dissipates, coefficients=numbers)
