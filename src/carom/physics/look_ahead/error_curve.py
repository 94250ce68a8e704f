"""Errors over the times at which runs are compared."""

from __future__ import annotations

import math

import numpy as np

from carom.arrays import FloatArray

GOLDEN = 0.3819660112501051  # of the time from one comparison to the next


def samples(end: float, count: int) -> FloatArray:
    """Return times up to ``end`` at which runs are compared, (count,) s."""
    return np.asarray(end * (np.arange(1, count + 1) / count))


def between_round_times(end: float, count: int) -> FloatArray:
    """Return times up to ``end`` at which steps of runs ahead may end, (count,) s.

    Something that happens in the middle of a step makes an error; at the end of a step it makes none. What happens in
    a scene happens at round parts of its duration more often than elsewhere.
    """
    times = end * ((np.arange(1, count + 1) - GOLDEN) / count)
    times[-1] = end
    return np.asarray(times)


def with_start(values: FloatArray, start: float) -> FloatArray:
    """Return the values with that at time 0 in front."""
    return np.concatenate(([start], values))


def kept_until(times: FloatArray, error: FloatArray, accuracy: float) -> float:
    """Return the time at which the error exceeds the accuracy, in s; the last if it does not."""
    over = np.flatnonzero(~(error <= accuracy))
    if not len(over):
        return float(times[-1])
    k = int(over[0])
    if k == 0:
        return 0.0
    low, high = error[k - 1], error[k]
    share = 0.0
    if math.isfinite(high) and low > 0.0:
        share = math.log(accuracy / low) / math.log(high / low)
    return float(times[k - 1] + share * (times[k] - times[k - 1]))
