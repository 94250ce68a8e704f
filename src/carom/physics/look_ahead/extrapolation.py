"""The error with shorter steps, extrapolated from the distances between runs whose steps halve each time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.physics.look_ahead.error_curve import kept_until
from carom.physics.look_ahead.twins import APART

FloatArray = NDArray[np.float64]

SAFETY = 3.0  # the step is chosen for an error that is smaller than requested by this factor
FARTHEST = 3  # halvings of the step beyond the finest run ahead, which then costs an eighth of the run itself
COARSER = -1  # instead of halvings: the step of the coarser of two runs ahead
TRIED = 2  # comparisons before an order is believed
NEARLY = 0.95  # part of the longest time with the accuracy that is enough, unless that is the whole run
FALLING = 0.7  # largest part of the distance that a halving should leave


def extrapolate(
    times: FloatArray, apart: list[FloatArray], highest: int, accuracy: float, farthest: int
) -> tuple[int, float, FloatArray]:
    """Return how often to halve the finer step, the time in s until which it keeps the accuracy, and its error.

    It is at most ``farthest``; `COARSER` takes the coarser step. The factor in front of h^p depends on where in its
    step an impact happens, so the largest of the last three distances counts, each scaled to the present step by the
    order.
    """
    order = _observed(apart, highest)
    latest = apart[-1:-4:-1]
    distance = np.max([each / 2.0 ** (order * age) for age, each in enumerate(latest)], axis=0)
    surely = len(apart) >= TRIED and bool(latest[0].any())
    if not surely and farthest != COARSER:
        return farthest, 0.0, distance
    tried = range(COARSER, farthest + 1)
    errors = [distance / (1.0 - 2.0**-order) / 2.0 ** (order * (halvings + 1)) for halvings in tried]
    kept = [kept_until(times, SAFETY * error, accuracy) for error in errors]
    longest = max(kept)
    enough = longest if longest >= times[-1] else NEARLY * longest
    k = next(k for k, until in enumerate(kept) if until >= enough)
    return tried[k], kept[k], errors[k]


def stays(times: FloatArray, apart: list[FloatArray], kept: float) -> bool:
    """Tell whether the last halving hardly changed the distance at the time when the accuracy is lost."""
    k = min(int(np.searchsorted(times, kept, side="right")), len(times) - 1)
    return len(apart) > 1 and bool(FALLING * apart[-2][k] < apart[-1][k] < APART)


def _observed(apart: list[FloatArray], order: int) -> float:
    """Return the order that the last distances show where they can be compared: 1 to that of the integrator."""
    coarse, fine = apart[max(0, len(apart) - 3)], apart[-1]
    usable = np.flatnonzero((coarse < APART) & (coarse > 0.0) & (fine > 0.0))
    if len(apart) < TRIED or not len(usable):
        return 1.0
    k = int(usable[-1])
    return min(max(math.log2(coarse[k] / fine[k]) / min(2, len(apart) - 1), 1.0), float(order))
