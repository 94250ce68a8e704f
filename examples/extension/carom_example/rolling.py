"""A contact law whose contacts resist rolling and twisting, beside Coulomb's friction.

The torque is the standard one, constant and against the rotation (Ai, Chen, Rotter & Ooi 2011, their model A):

    M_r = -μ_r R F_n Ω_t/|Ω_t|,    M_t = -μ_t R F_n Ω_n/|Ω_n|,    R = r_i r_j / (r_i + r_j)

with Ω the rotation of body j relative to i, its part Ω_t in the tangential plane and Ω_n along the normal. A ball that
rolls on a plane slows down by a = μ_r g / (1 + I/(m r²)), 5/7 μ_r g for a solid one: with the friction F at the
contact point, m a = F and I a/r = μ_r m g r - F r.
"""

from __future__ import annotations

import math
from typing import Any

from pydantic import Field

from carom.extend import ContactLaw, Friction, Section


class Rolling(Section):
    """[contact.rolling]: resistance to rolling and twisting, by torques that do not depend on the speed."""

    rolling_friction: Friction = Field(0.0, description="μ_r, torque over R F_n; not negative")
    twisting_friction: Friction = Field(0.0, description="μ_t, torque about the normal over R F_n; not negative")


def rolling(p: Any, normal: float, radius: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the angular impulse that ends the rolling, at most μ_r R times the normal impulse, in N m s."""
    most = p.rolling_friction * radius * normal
    squared = x * x + y * y + z * z
    if squared > most * most:
        scale = most / math.sqrt(squared)
        return scale * x, scale * y, scale * z
    return x, y, z


def twisting(p: Any, normal: float, radius: float, stopping: float) -> float:
    """Return the angular impulse that ends the twisting, at most μ_t R times the normal impulse, in N m s."""
    most: float = p.twisting_friction * radius * normal
    return max(-most, min(most, stopping))


ROLLING = ContactLaw(Rolling, rolling=rolling, twisting=twisting)
