"""The Pareto front: the settings that no other setting beats in both cost and error.

Errors are the same in every run. Costs are noisy, so each is an interval. A setting is beaten if another one has no
larger error and its cost interval lies entirely below. It is on the front if the cost intervals of all others with no
larger error lie entirely above. Otherwise it is undecided. Two measurements with overlapping intervals, setting by
setting, therefore never contradict each other: no setting is on the front in one and beaten in the other. A front of
medians alone would change with every measurement where two settings cost the same. Errors that differ by less than the
uncertainty of the reference are not distinguished, unless they are equal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def pareto_front(
    cost: FloatArray, error: FloatArray, noise: FloatArray, doubt: float = 0.0
) -> tuple[BoolArray, BoolArray]:
    """Mark the points on the front, and the undecided ones.

    Parameters
    ----------
    cost, error
        (m,) each; a point with a NaN in either is never marked and beats nothing.
    noise
        (m,) of the cost: it lies between cost / (1 + noise) and cost (1 + noise).
    doubt
        Uncertainty of the errors; unequal errors that differ by less are not distinguished.

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
