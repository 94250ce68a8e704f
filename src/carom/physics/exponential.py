"""Exponentials, logarithms and powers, with the same bits on any machine.

`exponentials` and `log_remainder` compute the functions that drag needs:

    φ₁ = (1 - e^{-z})/z,    φ₂ = (1 - φ₁)/z,    M = (-ln(1 - y) - y)/y²

Each function is accurate to one or two roundings for any argument, even where these differences would cancel. libm is
not used, since the last bits of its functions differ between machines.
"""

from __future__ import annotations

import math

import numpy as np

from carom.physics.jit.decorators import kernel
from carom.scene.portable_math import EXP, LN2_HIGH, LN2_LOW, LOG

VANISHED = 745.0  # e^-z underflows to 0 for z above this
TERMS = 20  # terms of the series on [0, 1]: 1/22! is below round-off
LOG_TERMS = 10  # terms of the series of artanh up to 1/7: 7⁻²⁰ is below round-off
LOG_SERIES_UP_TO = 0.25
OVERFLOWS = 709.78  # e^z is infinite for z above this
HALF_ROOT = math.sqrt(0.5)


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


@kernel
def exponential(x: float) -> float:
    """Return eˣ, infinite above 709.78 and 0 below -745, with the same bits as `carom.scene.portable_math`."""
    if x > OVERFLOWS:
        return math.inf
    if not x >= -VANISHED:
        return 0.0 if x < 0.0 else x
    k = np.rint(x / (LN2_HIGH + LN2_LOW))
    high, low = x - k * LN2_HIGH, k * LN2_LOW
    r = high - low
    square = r * r
    series = EXP[4]
    for i in range(3, -1, -1):
        series = series * square + EXP[i]
    c = r - square * series
    return math.ldexp(1.0 - ((low - (r * c) / (2.0 - c)) - high), int(k))


@kernel
def logarithm(x: float) -> float:
    """Return ln x for x > 0."""
    mantissa, exponent = math.frexp(x)
    if mantissa < HALF_ROOT:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    f = mantissa - 1.0
    s = f / (2.0 + f)
    square = s * s
    series = LOG[6]
    for i in range(5, -1, -1):
        series = series * square + LOG[i]
    half_square = 0.5 * f * f
    tail = s * (half_square + series * square) + exponent * LN2_LOW
    return exponent * LN2_HIGH - ((half_square - tail) - f)


@kernel
def power(base: float, exponent: float) -> float:
    """Return bᵖ for b > 0, to a few parts in 10¹⁵."""
    return exponential(exponent * logarithm(base))
