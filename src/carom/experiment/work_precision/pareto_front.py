"""Which settings are worth having: those that no other one beats in both cost and error.

Errors are the same in every run, costs are not: each is known to a part of itself, its noise, and so is an interval. A
setting is beaten where another one is no worse and its interval lies wholly below; it is on the front where that of
every other one that is no worse lies wholly above. Between, the noise does not tell. So two measurements whose
intervals overlap, setting by setting, never contradict each other: none is on the front by the one and beaten by the
other. The front of the medians alone, as if they were exact, would change with every measurement wherever two settings
cost the same. Likewise errors that differ by less than what the reference is uncertain by are not told apart, unless
they are the very same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def front(cost: FloatArray, error: FloatArray, noise: FloatArray, doubt: float = 0.0) -> tuple[BoolArray, BoolArray]:
    """Mark the points on the front, and those of which neither noise nor doubt tells.

    Parameters
    ----------
    cost, error
        (m,) each; a point with a NaN in either is never marked and beats nothing.
    noise
        (m,) of the cost: it lies between cost / (1 + noise) and cost (1 + noise).
    doubt
        Of the errors: by less than that, unequal ones are not told apart.

    Returns
    -------
    on, near
        (m,) each; no point is both.
    """
    known = ~np.isnan(cost + error)
    low, high = cost / (1.0 + noise), cost * (1.0 + noise)
    one, other = error[:, None], error[None, :]  # [j, k]: j beside k
    better = one + doubt < other
    no_worse = better | (one + doubt == other) | (one == other)
    rivals = known[:, None] & ~np.eye(len(cost), dtype=bool)
    below = (high[:, None] < low[None, :]) | (better & (high[:, None] <= low[None, :]))
    beaten = np.any(rivals & no_worse & below, axis=0)
    in_doubt = np.any(rivals & (one <= other + doubt) & (low[:, None] < high[None, :]), axis=0)
    return known & ~beaten & ~in_doubt, known & ~beaten & in_doubt
