"""Cube roots, powers, exponentials, sines and cosines with the same bits on any processor.

The last bits of NumPy's ``cbrt``, ``power``, ``exp`` and ``sin`` differ on processors with AVX-512. These functions use
only sums, products, quotients and changes of the exponent, which IEEE 754 defines to the last bit.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray

# m, period of an axis that is not periodic, so large that the nearest image of a point is the point itself
ENDLESS = 2.0**1000
NEWTON_STEPS = 6  # number of steps that reduce an error of a third of an octave to the last bit
LN2_HIGH, LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # ln 2 as a sum of two parts, from fdlibm
# fdlibm's minimax polynomials (Sun Microsystems, 1993): ln(1 + f) in s² = (f / (2 + f))², and eˣ in x²
LOG = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)
EXP = (
    1.66666666666666019037e-01,
    -2.77777777770155933842e-03,
    6.61375632143793436117e-05,
    -1.65339022054652515390e-06,
    4.13813679705723846039e-08,
)
SINE = (  # (sin x - x) / x³ in x², and (½ - (1 - cos x) / x²) / x² in x², for x up to π/4
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


def cube_root(x: FloatArray) -> FloatArray:
    """Return ∛x for x ≥ 0."""
    mantissa, exponent = np.frexp(x)
    third, left = exponent // 3, exponent % 3
    a = np.ldexp(mantissa, left)  # x = a 8^third, ½ ≤ a < 4
    y = 0.75 + 0.25 * a
    for _ in range(NEWTON_STEPS):
        y = y - (y * y * y - a) / (3.0 * y * y)
    return np.asarray(np.ldexp(np.where(a > 0.0, y, 0.0), third))


def power(base: FloatArray, exponent: FloatArray | float) -> FloatArray:
    """Return bᵖ for b > 0, to a few parts in 10¹⁵."""
    return exponential(exponent * _log(base))


def exponential(x: FloatArray) -> FloatArray:
    """Return eˣ, in the range where it neither overflows nor underflows."""
    k = np.rint(x / (LN2_HIGH + LN2_LOW))
    high, low = x - k * LN2_HIGH, k * LN2_LOW
    r = high - low
    c = r - r * r * _polynomial(r * r, EXP)
    return np.asarray(np.ldexp(1.0 - ((low - (r * c) / (2.0 - c)) - high), k.astype(np.int64)))


def cosine_and_sine(degrees: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the cosine and the sine of an angle in degrees."""
    angle = np.fmod(degrees, 360.0)  # this is exact, like the difference from a multiple of 90°
    quarter = np.rint(angle / 90.0)
    x = (angle - 90.0 * quarter) * (np.pi / 180.0)
    square = x * x
    cosine = 1.0 - square * (0.5 - square * _polynomial(square, COSINE))
    sine = x + x * square * _polynomial(square, SINE)
    turn = quarter.astype(np.int64) % 4
    is_odd = turn % 2 == 1
    first, second = np.where(is_odd, sine, cosine), np.where(is_odd, cosine, sine)
    return np.where((turn == 1) | (turn == 2), -first, first), np.where(turn >= 2, -second, second)


def _log(x: FloatArray) -> FloatArray:
    mantissa, exponent = np.frexp(x)
    low = mantissa < np.sqrt(0.5)
    k = np.where(low, exponent - 1, exponent)
    f = np.where(low, 2.0 * mantissa, mantissa) - 1.0
    s = f / (2.0 + f)
    half_square = 0.5 * f * f
    tail = s * (half_square + _polynomial(s * s, LOG) * (s * s)) + k * LN2_LOW
    return np.asarray(k * LN2_HIGH - ((half_square - tail) - f))


def _polynomial(x: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    value = np.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * x + coefficient
    return value
