"""Which settings are worth having: those that no other one beats in both cost and error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def front(cost: FloatArray, error: FloatArray) -> BoolArray:
    """Mark the points that no other one dominates: none is as good in both and better in one.

    Parameters
    ----------
    cost, error
        (m,) each; a point with a NaN in either is never marked and dominates nothing.
    """
    marked = np.zeros(len(cost), dtype=bool)
    known = np.flatnonzero(~(np.isnan(cost) | np.isnan(error)))
    best = np.inf
    for k in known[np.lexsort((error[known], cost[known]))]:
        cheapest = cost[k]
        if error[k] < best:
            best, last = error[k], cheapest
            marked[k] = True
        elif error[k] == best and cheapest == last:  # one and the same point twice
            marked[k] = True
    return marked


def near(cost: FloatArray, error: FloatArray, noise: float) -> BoolArray:
    """Mark the points that are not on the front but would be if they cost less by the noise, a part of the cost."""
    close = np.zeros(len(cost), dtype=bool)
    on = front(cost, error)
    for k in np.flatnonzero(~on):
        if not np.isnan(cost[k] + error[k]):
            cheaper = cost.copy()
            cheaper[k] *= 1.0 - noise
            close[k] = front(cheaper, error)[k]
    return close
