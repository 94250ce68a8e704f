"""The time step that gravity allows where nothing can touch: a fraction of the shortest time scale of any pair.

A pair at the distance r passes in r/v and falls together in √(r³/(G M)), M = m_i + m_j. The two are combined, with
Plummer's R² = r² + ε², to

    1/τ² = v²/R² + G M/R³,    τ'/τ = (r·v/R²) (1 + 3/2 (G M/R) / (v² + G M/R))

(Pelupessy, Jänes & Portegies Zwart 2012 take the shorter of the two.) A step of η τ, with τ at its beginning, would be
longer on the way into an encounter than on the way out, and the energy would drift. Half the change of τ in the step is
therefore added, as in their method: h = η τ / (1 - η τ'/2) is the mean of both ends to first order, and an orbit is
stepped alike in both directions of time. At an eccentricity of 0.999, 20 orbits then keep their energy to 5 × 10⁻¹¹;
without the correction, to 10⁻⁶.

With more than `PAIRS_UP_TO` bodies the pairs are not examined. If the acceleration a of a body is due to one neighbour
of mass m, this neighbour is at r = √(G m/a), and the two fall together in (G m)^¼ a^(-¾). A body in the common field of
many others gets a shorter time by this than it needs. Softening ε bounds the time from below by √(ε/a).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.jit.decorators import inline, unowned
from carom.plan.auto import PAIRS_UP_TO
from carom.scene.schema import Gravity

SHORTEST_MEAN = 0.5  # smallest divisor 1 - η τ'/2, which could reach 0 for a large η


class PullTime(NamedTuple):
    """The constants of the step that gravity allows."""

    fraction: float  # η, the step over the shortest time scale
    constant: float  # m³/(kg s²), G
    softening: float  # m
    mean: float  # m³/s², G times the mean mass
    of_pairs: bool  # whether each pair is examined

    @classmethod
    def of(cls, gravity: Gravity, fraction: float, bodies: Bodies) -> PullTime:
        """Return those of a scene's section and its bodies. Fixed ones pull others and are not pulled."""
        mean = gravity.constant * float(np.mean(bodies.mass))
        return cls(fraction, gravity.constant, gravity.softening, mean, len(bodies) <= PAIRS_UP_TO)


@inline
def step_of_largest(largest: float, mean: float, softening: float, fraction: float) -> float:
    """Return the longest step in seconds, given the largest acceleration of a body in m/s² and G m in m³/s²."""
    if largest == 0.0:
        return np.inf
    alone = np.sqrt(np.sqrt(mean / largest) / largest)  # roots of squares of units: the same bits in powers of two
    step: float = fraction * max(alone, np.sqrt(softening / largest))
    return step


@unowned
def step_of_pairs(
    x: FloatArray, v: FloatArray, m: FloatArray, inverse_mass: FloatArray, G: float, softening: float, fraction: float
) -> float:
    """Return h of the pair with the shortest τ; infinite if no pair pulls."""
    soft2 = softening * softening
    fastest, change = 0.0, 0.0  # 1/τ², 1/s²; τ'/τ, 1/s
    for i in range(len(m) - 1):
        for j in range(i + 1, len(m)):
            if (inverse_mass[i] == 0.0 and inverse_mass[j] == 0.0) or m[i] + m[j] == 0.0:  # neither pulls the other
                continue
            R2, v2, along = soft2, 0.0, 0.0
            for k in range(3):
                d, u = x[j, k] - x[i, k], v[j, k] - v[i, k]
                R2, v2, along = R2 + d * d, v2 + u * u, along + d * u
            if R2 == 0.0:  # coincident centres do not pull each other
                continue
            pull = G * (m[i] + m[j]) / np.sqrt(R2)
            rate = (v2 + pull) / R2
            if rate > fastest:
                fastest, change = rate, (along / R2) * (1.0 + 1.5 * pull / (v2 + pull))
    if fastest == 0.0:
        return np.inf
    step: float = fraction / np.sqrt(fastest)
    return step / max(SHORTEST_MEAN, 1.0 - 0.5 * step * change)
