"""The error with shorter steps, extrapolated from the distances between runs with ever shorter steps.

No step of a run ahead is a multiple of another one's. Where a ball stops to slide in the middle of a step of length h,
the step errs by C h² f (1 - f), for the fraction f of the step before it. Steps that halve each time end where those
before them did. If one of them ends at such an event, f is 0 in all runs ahead, and they agree on a wrong answer.
"""

from __future__ import annotations

import math

import numpy as np

from carom.arrays import FloatArray
from carom.physics.look_ahead.error_curve import kept_until
from carom.physics.look_ahead.twins import APART

COARSEST, RATIO = 1.0618, 1.4715  # refinement of the first run ahead, and of each over the one before
SAFETY = 3.5  # the step is chosen for an error that is smaller than requested by this factor
FARTHEST = 8.0  # times as fine as the finest run ahead, which then costs an eighth of the run itself
TRIED = 3  # comparisons before they are believed: one or two may be small by chance, see above
LATEST = 4  # comparisons that count
NEARLY = 0.95  # part of the longest time with the accuracy that is enough, unless that is the whole run
FALLING = 0.82  # largest part of the distance that shorter steps should leave


def extrapolate(
    times: FloatArray, apart: list[FloatArray], finest: float, highest: int, accuracy: float
) -> tuple[float, float, FloatArray]:
    """Return a refinement, the time in s until which it keeps the accuracy, and its error.

    The refinement is a power of two, so that steps and frames end together: from the latest run ahead but one to
    `FARTHEST` times the latest. The factor in front of h^p depends on where in its step an impact happens, so the
    largest of the latest distances counts, each scaled by the order.

    Parameters
    ----------
    apart
        (K,) each, over the size, the distances of each run ahead from the next.
    finest
        The refinement of the latest run ahead.
    highest
        Order of the integrator.
    """
    order = _observed(apart, highest)
    scaled = [each / RATIO ** (order * age) for age, each in enumerate(apart[: -LATEST - 1 : -1])]
    with np.errstate(invalid="ignore"):
        error = np.max(scaled, axis=0) / (RATIO**order - 1.0)  # of the latest run
    lowest, highest_power = math.ceil(math.log2(finest / RATIO)), math.floor(math.log2(FARTHEST * finest))
    tried = [2.0**power for power in range(min(lowest, highest_power), highest_power + 1)]
    errors = [error * (finest / each) ** order for each in tried]
    kept = [kept_until(times, SAFETY * each, accuracy) for each in errors]
    longest = max(kept)
    enough = longest if longest >= times[-1] else NEARLY * longest
    k = next(k for k, until in enumerate(kept) if until >= enough)
    return tried[k], kept[k], errors[k]


def stays(times: FloatArray, apart: list[FloatArray], kept: float) -> bool:
    """Tell whether shorter steps hardly changed the distance at the time when the accuracy is lost."""
    k = min(int(np.searchsorted(times, kept, side="right")), len(times) - 1)
    return len(apart) > 1 and bool(FALLING * apart[-2][k] < apart[-1][k] < APART)


def _observed(apart: list[FloatArray], order: int) -> float:
    """Return the order that the latest distances show where they can be compared: 1 to that of the integrator."""
    age = min(LATEST, len(apart)) - 1
    coarse, fine = apart[-1 - age], apart[-1]
    usable = np.flatnonzero((coarse < APART) & (coarse > 0.0) & (fine > 0.0) & np.isfinite(fine))
    if age == 0 or not len(usable):
        return 1.0
    k = int(usable[-1])
    return min(max(math.log(coarse[k] / fine[k]) / (age * math.log(RATIO)), 1.0), float(order))
