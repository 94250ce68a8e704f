"""Walton's law of impacts: restitution, friction, and a tangential restitution of impacts that stick.

If an impact sticks, measured spheres reverse the slip, which Coulomb's friction cannot do (Walton 1993; Foerster,
Louge, Chang & Allia 1994). With the slip g_t before the impact and μ the kinetic friction,

    g_t' = -β₀ g_t    where the contact sticks: J_t = (1 + β₀) times the impulse that ends the slip
    J_t = μ J_n       where that impulse would be larger

Contacts at rest have Coulomb's friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from carom.extend import ContactLaw, Section


class Walton(Section):
    """[contact.walton]: tangential restitution of impacts that stick."""

    tangential_restitution: float = Field(
        strict=True, ge=-1, le=1, description="β₀, reversed slip over the slip before the impact, from -1 to 1"
    )


def smaller(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """Return the smaller coefficient, as for the normal restitution; a geometric mean would have no sign."""
    return {name: min(value, other[name]) for name, value in one.items()}


def impact_friction(p: Any, normal: float, stopping: float) -> float:
    """Return the impulse that reverses the slip, limited to the impulse of kinetic friction."""
    impulse: float = min((1.0 + p.tangential_restitution) * stopping, p.kinetic_friction * normal)
    return impulse


LAW = ContactLaw(Walton, impact_friction=impact_friction, combined=smaller)
