"""A repulsion of each pair of bodies that falls with the fourth power of their distance.

F = K / r⁴,    U = K / (3 r³)
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import Field

from carom.extend import Dimension, PairForce, Positive, Section

STRENGTH = Dimension("strength of a repulsion", "N m⁴", (5, -2, 1, 0), "2 N m^4")


class Repulsion(Section):
    """[forces.repulsion]: a repulsion of each pair of bodies, F = K/r⁴."""

    strength: Annotated[Positive, STRENGTH] = Field(description="N m⁴, K; more than 0")


def attraction(d2: float, m_i: float, m_j: float, p: Any) -> float:
    """Return F/r in N/m, negative because the force repels."""
    force: float = -p.strength / (d2 * d2 * math.sqrt(d2))
    return force


def potential(d2: float, m_i: float, m_j: float, p: Any) -> float:
    """Return the potential energy of a pair in J."""
    energy: float = p.strength / (3.0 * d2 * math.sqrt(d2))
    return energy


REPULSION = PairForce(Repulsion, attraction, potential, meaning="potential energy of the repulsion", colour="red")
