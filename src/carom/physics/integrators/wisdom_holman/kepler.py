"""The Kepler problem in universal variables: motion about a fixed centre, for any time and any conic.

With r = |x|, β = 2μ/r - v², η = x·v and ζ = μ - β r at the start, the universal anomaly X solves (Stumpff 1962)

    r X + η G₂ + ζ G₃ = h,        G_k(X) = X^k c_k(β X²),        c_k(z) = Σ_j (-z)^j / (k + 2j)!

and the state after a time h is

    x' = f x + g v,     f = 1 - μ G₂/r,      g = h - μ G₃
    v' = ḟ x + ġ v,     ḟ = -μ G₁/(r r'),    ġ = 1 - μ G₂/r',      r' = r + η G₁ + ζ G₂

The left side of the equation for X increases with X, because its derivative is r' > 0. The equation is solved by steps
that use the first three derivatives (Danby 1988), and by bisection if a step leaves the bracket. Whole periods are
subtracted first. All computations are sums, products, quotients and square roots, so the bits are the same on any
processor.
"""

from __future__ import annotations

from fractions import Fraction
from math import factorial

import numpy as np

from carom.arrays import FloatArray
from carom.physics.jit.decorators import inner
from carom.physics.vector import vector, write

SERIES_UP_TO = 0.3  # largest |z| at which the omitted terms are below half a unit in the last place
TERMS = 7  # terms of the series
C2 = tuple(float(Fraction((-1) ** j, factorial(2 + 2 * j))) for j in range(TERMS))
C3 = tuple(float(Fraction((-1) ** j, factorial(3 + 2 * j))) for j in range(TERMS))
C2_0, C2_1, C2_2, C2_3, C2_4, C2_5, C2_6 = C2
C3_0, C3_1, C3_2, C3_3, C3_4, C3_5, C3_6 = C3
CONVERGED = 1e-5  # relative step of X after which the error of fourth order is below rounding
PATIENCE = 8  # number of steps after which every second step is a bisection, since steps down an exponential are short
MAX_STEPS = 150  # largest number of steps; half of them are bisections, of which about 60 suffice
NEARLY = 1e-8  # relative step of X after which a last step of second order is enough; compare `CONVERGED`
LANES = 64  # bodies in SIMD lanes
WIDEST = 8  # largest number of floats in a SIMD vector on any processor
# First columns of the arrays in the workspace: positions in m, velocities in m/s, μ, positions and velocities at the
# end, and whether two steps for the anomaly were enough. All columns share one array, so that the compiler knows that
# they do not overlap.
X, Y, Z, VX, VY, VZ, MU, END_X, END_Y, END_Z, END_VX, END_VY, END_VZ, ENOUGH = range(0, 14 * LANES, LANES)
WORKSPACE = 14 * LANES  # numbers in the workspace
TWO_PI = 6.283185307179586  # rad
WIDER = 1.01  # upper end of the bracket, in anomalies of one period, with room for rounding


@inner
def universal(beta: float, s: float) -> tuple[float, float, float, float]:
    """Return G₀ to G₃ at an anomaly."""
    z = beta * s * s
    quarters = 0
    while abs(z) > SERIES_UP_TO:
        z *= 0.25
        quarters += 1
    c2 = C2_0 + z * (C2_1 + z * (C2_2 + z * (C2_3 + z * (C2_4 + z * (C2_5 + z * C2_6)))))
    c3 = C3_0 + z * (C3_1 + z * (C3_2 + z * (C3_3 + z * (C3_4 + z * (C3_5 + z * C3_6)))))
    c1 = 1.0 - z * c3
    c0 = 1.0 - z * c2
    for _ in range(quarters):  # doubles the anomaly
        c3 = 0.25 * (c2 + c0 * c3)
        c2 = 0.5 * c1 * c1
        c1 = c0 * c1
        c0 = 2.0 * c0 * c0 - 1.0
    square = s * s
    return c0, s * c1, square * c2, square * s * c3


@inner
def revolve(x: FloatArray, v: FloatArray, i: int, mu: float, h: float) -> None:
    """Advance row i of positions, (n, 3) m, and velocities, (n, 3) m/s, by h (s) about a centre of G M = μ at 0."""
    direction = 1.0 if h >= 0.0 else -1.0  # backward in time is forward with the opposite velocity
    x0, x1, x2 = vector(x, i)
    v0, v1, v2 = vector(v, i)
    v0, v1, v2 = direction * v0, direction * v1, direction * v2
    r = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    over_r = 1.0 / r
    beta = 2.0 * mu * over_r - (v0 * v0 + v1 * v1 + v2 * v2)
    eta = x0 * v0 + x1 * v1 + x2 * v2
    zeta = mu - beta * r
    t = abs(h)
    low, high = 0.0, np.inf
    if beta > 0.0:
        root = np.sqrt(beta)
        period = TWO_PI * mu / (beta * root)
        if t >= period:
            t -= period * np.floor(t / period)
        high = WIDER * TWO_PI / root
    s = t * over_r
    bend = 0.5 * s * over_r * eta
    if abs(bend) < 0.5:
        s *= 1.0 - bend  # starting value, accurate to second order in t
    if s > high:
        s = 0.5 * high
    g0, g1, g2, g3 = 1.0, 0.0, 0.0, 0.0
    for trial in range(MAX_STEPS):
        g0, g1, g2, g3 = universal(beta, s)
        late = r * s + eta * g2 + zeta * g3 - t
        d1 = r + eta * g1 + zeta * g2
        d2 = eta * g0 + zeta * g1
        d3 = zeta * g0 - beta * eta * g1
        newton = -late / d1
        halley = -late / (d1 + 0.5 * newton * d2)
        step = -late / (d1 + 0.5 * halley * (d2 + halley * d3 * (1.0 / 3.0)))
        if abs(newton) <= CONVERGED * s:
            # the functions at the new anomaly follow from their derivatives G'_k = G_{k-1}; the remainder is below
            # rounding
            third = step * (1.0 / 3.0)
            g3 += step * (g2 + 0.5 * step * (g1 + third * g0))
            g2 += step * (g1 + 0.5 * step * (g0 - third * beta * g1))
            g1 += step * (g0 - 0.5 * step * beta * (g1 + third * g0))
            break
        if late <= 0.0:
            low = s
        else:
            high = s  # the anomaly is too large, or overflows
        further = s + step
        if not low < further < high or (trial > PATIENCE and trial % 2 == 0 and high < np.inf):
            further = 0.5 * (low + high) if high < np.inf else 2.0 * s
        if further == s:
            break
        s = further
    moved = r + eta * g1 + zeta * g2
    over = mu * over_r
    f = -over * g2
    g = t - mu * g3
    rate = over * g1 / moved
    slow = mu * g2 / moved
    write(x, i, x0 + (f * x0 + g * v0), x1 + (f * x1 + g * v1), x2 + (f * x2 + g * v2))
    v0, v1, v2 = v0 - (rate * x0 + slow * v0), v1 - (rate * x1 + slow * v1), v2 - (rate * x2 + slow * v2)
    write(v, i, direction * v0, direction * v1, direction * v2)


@inner
def revolve_all(x: FloatArray, v: FloatArray, mu: FloatArray, h: float, lanes: FloatArray) -> None:
    """Advance all rows of positions, (n, 3) m, and velocities, (n, 3) m/s, except the first by a time h (s).

    μ is (n,) m³/s². ``lanes`` is a workspace of `WORKSPACE` numbers.
    """
    n = len(x)
    direction = 1.0 if h >= 0.0 else -1.0
    for first in range(1, n, LANES):
        count = min(LANES, n - first)
        for k in range(count):
            i = first + k
            lanes[X + k], lanes[Y + k], lanes[Z + k] = x[i, 0], x[i, 1], x[i, 2]
            lanes[VX + k], lanes[VY + k], lanes[VZ + k] = direction * v[i, 0], direction * v[i, 1], direction * v[i, 2]
            lanes[MU + k] = mu[i]
        padded = (count + WIDEST - 1) // WIDEST * WIDEST  # padded, since a remainder would be computed one by one
        for k in range(count, padded):
            for row in range(X, MU + 1, LANES):
                lanes[row + k] = lanes[row]
        _revolve_lanes(lanes, padded, abs(h))
        for k in range(count):
            i = first + k
            if lanes[ENOUGH + k] > 0.0:
                write(x, i, lanes[END_X + k], lanes[END_Y + k], lanes[END_Z + k])
                write(v, i, direction * lanes[END_VX + k], direction * lanes[END_VY + k], direction * lanes[END_VZ + k])
            else:
                revolve(x, v, i, mu[i], h)


@inner
def _revolve_lanes(lanes: FloatArray, count: int, t: float) -> None:
    """Move bodies in SIMD lanes by t ≥ 0, with two steps for the anomaly."""
    for k in range(count):
        x0, x1, x2 = lanes[X + k], lanes[Y + k], lanes[Z + k]
        v0, v1, v2 = lanes[VX + k], lanes[VY + k], lanes[VZ + k]
        mu = lanes[MU + k]
        r = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
        over_r = 1.0 / r
        beta = 2.0 * mu * over_r - (v0 * v0 + v1 * v1 + v2 * v2)
        eta = x0 * v0 + x1 * v1 + x2 * v2
        zeta = mu - beta * r
        s = t * over_r
        bend = 0.5 * s * over_r * eta
        # starting value, accurate to third order in t
        s *= 1.0 - bend + (2.0 * bend * bend - s * s * over_r * zeta * (1.0 / 6.0))
        # the first step
        square = s * s
        z = beta * square
        w = z * z
        c2 = (C2_0 + z * C2_1) + w * ((C2_2 + z * C2_3) + w * ((C2_4 + z * C2_5) + w * C2_6))
        c3 = (C3_0 + z * C3_1) + w * ((C3_2 + z * C3_3) + w * ((C3_4 + z * C3_5) + w * C3_6))
        g0, g1, g2, g3 = 1.0 - z * c2, s * (1.0 - z * c3), square * c2, square * s * c3
        late = t - r * s - eta * g2 - zeta * g3
        d1 = r + eta * g1 + zeta * g2
        d2 = eta * g0 + zeta * g1
        newton = late / d1
        s += late / (d1 + 0.5 * newton * d2)
        # the second step
        square = s * s
        z = beta * square
        w = z * z
        c2 = (C2_0 + z * C2_1) + w * ((C2_2 + z * C2_3) + w * ((C2_4 + z * C2_5) + w * C2_6))
        c3 = (C3_0 + z * C3_1) + w * ((C3_2 + z * C3_3) + w * ((C3_4 + z * C3_5) + w * C3_6))
        g0, g1, g2, g3 = 1.0 - z * c2, s * (1.0 - z * c3), square * c2, square * s * c3
        late = t - r * s - eta * g2 - zeta * g3
        step = late / (r + eta * g1 + zeta * g2)
        g3 += step * g2
        g2 += step * g1
        g1 += step * g0
        moved = 1.0 / (r + eta * g1 + zeta * g2)
        over = mu * over_r
        f = -over * g2
        g = t - mu * g3
        rate = over * g1 * moved
        slow = mu * g2 * moved
        lanes[END_X + k] = x0 + (f * x0 + g * v0)
        lanes[END_Y + k] = x1 + (f * x1 + g * v1)
        lanes[END_Z + k] = x2 + (f * x2 + g * v2)
        lanes[END_VX + k] = v0 - (rate * x0 + slow * v0)
        lanes[END_VY + k] = v1 - (rate * x1 + slow * v1)
        lanes[END_VZ + k] = v2 - (rate * x2 + slow * v2)
        near = abs(step) <= NEARLY * s
        short = abs(z) <= SERIES_UP_TO
        lanes[ENOUGH + k] = (1.0 if near else 0.0) * (1.0 if short else 0.0)
