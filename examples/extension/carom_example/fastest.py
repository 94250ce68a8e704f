"""A recorded series: the speed of the fastest body."""

from __future__ import annotations

import numpy as np

from carom.extend import LINES, Plot, Sample, Series


def speed(sample: Sample) -> float:
    """Return the largest speed in m/s."""
    return float(np.linalg.norm(sample.frame.velocity, axis=1).max())


FASTEST = Series(
    "step/fastest", "m/s", "fastest body", LINES["green"], Plot("Speed", "m/s"), speed, "speed of the fastest body"
)
