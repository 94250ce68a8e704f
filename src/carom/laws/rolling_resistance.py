"""Rolling and twisting resistance: torques of a contact that do not depend on the speed.

The torque acts against the relative rotation Ω of the bodies, as in model A of Ai, Chen, Rotter & Ooi (2011). Ω has the
components Ω_t in the tangential plane and Ω_n along the normal:

    M_r = -μ_r R F_n Ω_t/|Ω_t|,    M_t = -μ_t R F_n Ω_n/|Ω_n|,    R = r_i r_j / (r_i + r_j)

A ball that rolls on a plane decelerates by μ_r g / (1 + I/(m r²)), which is 5/7 μ_r g for a solid ball.
"""

from __future__ import annotations

import math
from typing import Any

from pydantic import Field

from carom.extend import ContactLaw, Friction, Section


class RollingResistance(Section):
    """[contact.rolling_resistance]: resistance to rolling and twisting, by torques that do not depend on the speed."""

    rolling_friction: Friction = Field(0.0, description="μ_r, torque against rolling over R F_n; not negative")
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


LAW = ContactLaw(RollingResistance, rolling=rolling, twisting=twisting)
