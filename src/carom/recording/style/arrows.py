"""Arrows for vectors whose SI magnitudes are arbitrary and span decades.

An arrow starts at its body's centre and sticks out of the sphere by

    L(m) = L_max · s / (1 + s),   s = (m / m_ref)^(1/3)

so its vector is ``(r + L) m̂`` (`encoding.draw_arrows`). L grows with m, is less than L_max and can be inverted:
m = m_ref · (u / (1 - u))³ with u = L / L_max. Thanks to the cube root, six decades fit between 9 % and 91 % of L_max.
m_ref is therefore taken from the first frame that has arrows and holds for the whole recording; even if it is wrong by
a factor of 1000, the arrows are visible.

A sphere's torque and angular acceleration are parallel (τ = I α). Torques are drawn short and thick, angular
accelerations long and thin.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

TORQUE_REACH = 2.0  # L_max in median body radii
ANGULAR_ACCELERATION_REACH = 4.0
_ROUND_OFF = 1e-6  # of the natural unit: smaller vectors are rounding noise and set no scale


def part_of_longest(magnitude: Any, unit: Any) -> Any:
    """Return L / L_max of magnitudes in a unit, both numbers or arrays; 1 where the magnitude is infinite."""
    s = np.cbrt(magnitude / unit)
    return 1.0 - 1.0 / (1.0 + s)


def longest(radius: NDArray[np.float64], reach: float) -> float:
    """Return L_max in metres."""
    return reach * float(np.median(radius))


def magnitudes(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of ``(k, 3)`` vectors; the largest component is the unit, so that no square overflows."""
    largest = np.abs(vectors).max(initial=0.0, where=np.isfinite(vectors))
    if largest == 0.0:
        return np.zeros(len(vectors))
    unit = vectors / largest
    return np.asarray(largest * np.sqrt(np.einsum("ki,ki->k", unit, unit)))


def reference(magnitude: NDArray[np.float64], natural_unit: float) -> float:
    """Choose m_ref from the first magnitudes: their median, unless they are rounding noise."""
    return max(float(np.median(magnitude)), _ROUND_OFF * natural_unit, np.finfo(np.float64).tiny)
