"""e^{-z} and what follows from it, with the same bits on any machine.

    φ₁ = (1 - e^{-z})/z,    φ₂ = (1 - φ₁)/z,    M = (-ln(1 - y) - y)/y²

Each is right to a rounding or two at any argument, also where these differences would cancel. The last bits of libm's
functions differ between machines.
"""

from __future__ import annotations

import math

import numpy as np

from carom.physics.jit.decorators import kernel
from carom.scene.portable_math import LN2_HIGH, LN2_LOW

VANISHED = 745.0  # e^-z underflows to 0 for larger z
TERMS = 20  # of a series on [0, 1]: 1/22! is below round-off
LOG_TERMS = 10  # of the series of artanh up to 1/7: 7⁻²⁰ is below round-off
LOG_SERIES_UP_TO = 0.25


@kernel
def exponentials(z: float) -> tuple[float, float, float]:
    """Return e^{-z}, φ₁ and φ₂ for z ≥ 0."""
    r, octaves = z, 0
    if z > VANISHED:
        return 0.0, 1.0 / z, (1.0 - 1.0 / z) / z
    if z > 1.0:
        octaves = int(z / LN2_HIGH)
        r = (z - octaves * LN2_HIGH) - octaves * LN2_LOW
    series = 1.0
    for k in range(TERMS + 2, 2, -1):
        series = 1.0 - r / k * series
    phi2 = 0.5 * series
    phi1 = 1.0 - r * phi2
    decay = 1.0 - r * phi1
    if z <= 1.0:
        return decay, phi1, phi2
    decay = math.ldexp(decay, -octaves)
    phi1 = (1.0 - decay) / z
    return decay, phi1, (1.0 - phi1) / z


@kernel
def log_remainder(y: float) -> float:
    """Return M for 0 ≤ y < 1, so that -ln(1 - y) = y + y² M."""
    small, doublings = y, 0
    while small > LOG_SERIES_UP_TO:  # 1 - y is the square of 1 - y/(1 + √(1 - y))
        small = small / (1.0 + np.sqrt(1.0 - small))
        doublings += 1
    t = small / (2.0 - small)  # -ln(1 - y) = 2 artanh t
    series = 0.0
    for k in range(LOG_TERMS, 0, -1):
        series = 1.0 / (2 * k + 1) + t * t * series
    remainder = (1.0 + 2.0 * t * series / (2.0 - small)) / (2.0 - small)
    if doublings == 0:
        return remainder
    return (math.ldexp(small + small * small * remainder, doublings) - y) / (y * y)
