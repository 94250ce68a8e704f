"""Orientations: the exact rotation of a constant angular velocity, without a libm call.

    q(t + dt) = exp(½ ω dt) q(t),    exp(½ ω dt) = (ω/|ω| sin θ, cos θ),    θ = ½ |ω| dt

Sine and cosine are Taylor series on [-π/4, π/4] after a reduction by multiples of π/2, so their bits are the same on
any machine. The error is below 2.3 × 10⁻¹⁶ for θ up to 10⁵ (tests/physics/test_rotation.py). A larger θ is first
reduced modulo 2π; the rounding of 2π adds an error of θ × 4 × 10⁻¹⁷.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.jit import inline, kernel, long_kernel
from carom.physics.parallel.thread_team import SOLO, Team

FloatArray = NDArray[np.float64]

# π/2 in two parts (Cody & Waite): the first has 33 bits, so that its product with a count up to 2²⁰ is exact.
HALF_PI_HIGH = 1.57079632673412561417
HALF_PI_LOW = 6.07710050650619224932e-11
TWO_PI = 6.28318530717958647693
LARGEST = 1e5  # rad
TWO_OVER_PI = 0.63661977236758134308

MIN_BODIES_PER_TASK = 500


@inline
def _sine(r: float) -> float:
    s = r * r
    series = -1 / 1307674368000.0 + s / 355687428096000.0
    series = 1 / 6227020800.0 + s * series
    series = -1 / 39916800.0 + s * series
    series = 1 / 362880.0 + s * series
    series = -1 / 5040.0 + s * series
    series = 1 / 120.0 + s * series
    series = -1 / 6.0 + s * series
    return r + r * s * series


@inline
def _cosine(r: float) -> float:
    s = r * r
    series = 1 / 20922789888000.0 - s / 6402373705728000.0
    series = -1 / 87178291200.0 + s * series
    series = 1 / 479001600.0 + s * series
    series = -1 / 3628800.0 + s * series
    series = 1 / 40320.0 + s * series
    series = -1 / 720.0 + s * series
    series = 1 / 24.0 + s * series
    return 1.0 - 0.5 * s + s * s * series


@kernel
def sine_cosine(theta: float) -> tuple[float, float]:
    """Return sin θ and cos θ."""
    if abs(theta) > LARGEST:
        theta = theta % TWO_PI
    count = math.floor(theta * TWO_OVER_PI + 0.5)
    r = (theta - count * HALF_PI_HIGH) - count * HALF_PI_LOW
    sine, cosine = _sine(r), _cosine(r)
    quadrant = count - 4 * math.floor(count / 4)
    if quadrant == 0:
        return sine, cosine
    if quadrant == 1:
        return cosine, -sine
    if quadrant == 2:
        return -sine, -cosine
    return -cosine, sine


def rotate(orientation: FloatArray, angular_velocity: FloatArray, dt: float, team: Team = SOLO) -> None:
    """Turn every orientation, (n, 4) xyzw, by ω dt and normalise it; a negative dt turns it back."""
    team.divide(len(orientation), MIN_BODIES_PER_TASK, turn, orientation, angular_velocity, dt)


@long_kernel
def turn(lo: int, hi: int, orientation: FloatArray, angular_velocity: FloatArray, dt: float) -> None:
    """Turn the orientations [lo, hi)."""
    for i in range(lo, hi):
        wx, wy, wz = angular_velocity[i, 0], angular_velocity[i, 1], angular_velocity[i, 2]
        w = np.sqrt(wx * wx + wy * wy + wz * wz)
        if w == 0.0:
            continue
        s, c = sine_cosine(0.5 * w * dt)
        s /= w
        ax, ay, az = s * wx, s * wy, s * wz
        qx, qy, qz, qw = orientation[i, 0], orientation[i, 1], orientation[i, 2], orientation[i, 3]
        px = c * qx + ax * qw + ay * qz - az * qy
        py = c * qy + ay * qw + az * qx - ax * qz
        pz = c * qz + az * qw + ax * qy - ay * qx
        pw = c * qw - ax * qx - ay * qy - az * qz
        length = np.sqrt(px * px + py * py + pz * pz + pw * pw)
        orientation[i, 0] = px / length
        orientation[i, 1] = py / length
        orientation[i, 2] = pz / length
        orientation[i, 3] = pw / length
