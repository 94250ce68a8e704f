"""The first impact within a step of Gauss–Radau integration, found from the polynomials of the bodies.

Let d(h) be the separation of two bodies, or of a body and a plane, and R the distance at which they touch. With f = d²
- R² and g = d·d' = f'/2, an impact is the first h in [0, 1] at which f ≤ 0 and g < 0: the two touch and close.

All pairs are tested only after the bodies may have moved by the clearance, the smallest gap of any pair at the last
test. If a pair may meet, its polynomial is followed from h = 0 on, in intervals that are halved until one of these
conditions holds, with M ≥ |d''| and K ≥ |g''|:

- the chord of d stays farther from 0 than R + M w²/8, where w is the width: they do not touch
- g stays positive by g + g' s - ½ K s²: they separate
- g stays negative by the same bound from the other end, and d ends inside R: the only root of f is in the interval

The first impact is therefore found however short or grazing it is. The step is then repeated so that it ends at that
root, because the polynomial has a lower order within a step than at its end.

A contact comes to rest if forces press it together so strongly that the next impact would follow within a fraction
`REST` of the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.physics.contact.impact_log import ROUNDING
from carom.physics.integrators.gauss_radau.radau_step import TERMS, Motion, ProgressRecord, acceleration_at_start
from carom.physics.jit.decorators import inline, inner

COEFFICIENTS = TERMS + 3  # coefficients of a position as a polynomial in h
TOUCHING = 8 * 2.0**-53  # largest gap, relative to the coordinates and R, that counts as rounding
SLACK = 1.0 + 1e-9  # allowance for the rounding of the bounds
NARROWEST = 2.0**-44  # an overlap for a shorter fraction of a step is a grazing pass
MOST_INTERVALS = 20_000  # largest number of intervals; a contact that needs more is at rest, up to rounding
REST = 1e-6  # shortest flight between impacts, as a fraction of a step; it is at most 10⁻¹⁴ R high, near rounding
NONE = np.inf  # no impact
AT_REST = -1.0  # marks a contact that forces press together


class Solids(NamedTuple):
    """The bodies and planes that may touch."""

    radius: FloatArray  # (n,) m
    surface: FloatArray  # (p, 3) unit normals of the planes
    offset: FloatArray  # (p,) m
    path: FloatArray  # (COEFFICIENTS, 3) m, coefficients of d; overwritten for each pair

    @classmethod
    def of(cls, radius: FloatArray, surface: FloatArray | None = None, offset: FloatArray | None = None) -> Solids:
        """List the bodies and planes; by default there are none."""
        none = np.zeros((0, 3)), np.zeros(0)
        planes = none if surface is None or offset is None else (surface, offset)
        return cls(np.ascontiguousarray(radius), *planes, np.zeros((COEFFICIENTS, 3)))


@inner
def first_impact(motion: Motion, solids: Solids, run: ProgressRecord, dt: float, displacement: float) -> float:
    """Return the fraction h of the step after which bodies meet, `NONE`, or `AT_REST`; write the pair to ``run``.

    No body moves farther than ``displacement``, in m.
    """
    x, moves, radius, n = motion.position, motion.moves, solids.radius, len(motion.position)
    first, clearance = NONE, np.inf
    for i in range(n):
        for j in range(i + 1, n):
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            d2, R = dx * dx + dy * dy + dz * dz, radius[i] + radius[j]
            is_clear = clearance > 2.0 * displacement and d2 > (R + clearance) * (R + clearance)
            if is_clear or moves[i] + moves[j] == 0.0:
                continue  # this pair cannot be nearer than the nearest pair so far
            gap = np.sqrt(d2) - R
            clearance = min(clearance, gap)
            if gap <= 2.0 * displacement:
                _lay_pair(motion, solids.path, i, j, dt)
                first = _earlier(i, j, R, motion, solids, run, dt, first)
        for p in range(len(solids.offset) if moves[i] > 0.0 else 0):
            gap = -solids.offset[p] - radius[i]
            for k in range(3):
                gap += solids.surface[p, k] * x[i, k]
            clearance = min(clearance, gap)
            if gap <= displacement:
                _lay_height(motion, solids, i, p, dt)
                first = _earlier(i, n + p, radius[i], motion, solids, run, dt, first)
    run.clearance = clearance - 2.0 * displacement
    return first


@inner
def _earlier(
    i: int, j: int, R: float, motion: Motion, solids: Solids, run: ProgressRecord, dt: float, first: float
) -> float:
    """Return the earlier of the first impact so far and a pair's first impact; note the pair if it is earlier."""
    v, distance = motion.velocity, R  # m, R plus the distances by which both bodies move
    for k in range(3):
        distance += dt * (abs(v[i, k]) + (abs(v[j, k]) if j < len(v) else 0.0))
    negligible = ROUNDING * distance
    h = _first_root(solids.path, R, rounding(motion.position, i, j, R), negligible)
    if h < first:
        run.i, run.j = i, j
        return h
    return first


@inner
def rounding(x: FloatArray, i: int, j: int, R: float) -> float:
    """Return the largest gap (m) between body i and body or plane j that may be due to rounding."""
    largest = R
    for k in range(3):
        largest = max(largest, abs(x[i, k]))
        if j < len(x):
            largest = max(largest, abs(x[j, k]))
    return TOUCHING * largest


@inline
def max_displacement(motion: Motion, planes: int, dt: float) -> float:
    """Return a bound on the distance (m) that any body moves in a step; without planes, relative to the mean motion."""
    v, b, n = motion.velocity, motion.b, len(motion.velocity)
    ux, uy, uz = 0.0, 0.0, 0.0
    if planes == 0:
        for i in range(n):
            ux, uy, uz = ux + v[i, 0], uy + v[i, 1], uz + v[i, 2]
        ux, uy, uz = ux / n, uy / n, uz / n
    farthest = 0.0
    for i in range(n):
        wx, wy, wz = v[i, 0] - ux, v[i, 1] - uy, v[i, 2] - uz
        largest = 0.0
        for k in range(3):
            size = abs(acceleration_at_start(motion, i, k))
            for m in range(TERMS):
                size += abs(b[3 * i + k, m])
            largest += size
        farthest = max(farthest, np.sqrt(wx * wx + wy * wy + wz * wz) + 0.5 * dt * largest)
    return float(SLACK * dt * farthest)


@inner
def _lay_pair(motion: Motion, path: FloatArray, i: int, j: int, dt: float) -> None:
    """Write the coefficients of the separation of body j from body i."""
    for k in range(3):
        for m in range(COEFFICIENTS):
            path[m, k] = coefficient(motion, j, k, m, dt) - coefficient(motion, i, k, m, dt)


@inner
def _lay_height(motion: Motion, solids: Solids, i: int, p: int, dt: float) -> None:
    """Write the coefficients of the separation of plane p from body i, along its normal."""
    N = solids.surface[p]
    for m in range(COEFFICIENTS):
        height = -solids.offset[p] if m == 0 else 0.0
        for k in range(3):
            height += N[k] * coefficient(motion, i, k, m, dt)
        for k in range(3):
            solids.path[m, k] = -height * N[k]


@inner
def coefficient(motion: Motion, i: int, k: int, m: int, dt: float) -> float:
    """Return the coefficient of h^m in a coordinate of body i, in m."""
    if m == 0:
        return float(motion.position[i, k] + motion.position_compensation[i, k])
    if m == 1:
        return float(dt * motion.velocity[i, k])
    if m == 2:
        return float(0.5 * dt * dt * acceleration_at_start(motion, i, k))
    return float(dt * dt * motion.b[3 * i + k, m - 3] / ((m - 1) * m))


@inner
def _at(path: FloatArray, h: float) -> tuple[float, float, float, float]:
    """Return |d|², g, g' and |d'|² at h."""
    d2, g, speed2, bend = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        d, v, a = 0.0, 0.0, 0.0
        for m in range(COEFFICIENTS - 1, -1, -1):
            a = a * h + 2.0 * v
            v = v * h + d
            d = d * h + path[m, k]
        d2, g, speed2, bend = d2 + d * d, g + d * v, speed2 + v * v, bend + d * a
    return d2, g, speed2 + bend, speed2


@inner
def _chord(path: FloatArray, a: float, b: float) -> float:
    """Return the smallest |d|² on the chord of d from a to b."""
    far, along, length = 0.0, 0.0, 0.0
    for k in range(3):
        p, q = 0.0, 0.0
        for m in range(COEFFICIENTS - 1, -1, -1):
            p, q = p * a + path[m, k], q * b + path[m, k]
        far, along, length = far + p * p, along + p * (q - p), length + (q - p) * (q - p)
    if along >= 0.0:
        return far
    if -along >= length:
        return far + 2.0 * along + length
    return far - along * along / length


@inner
def _bounds(path: FloatArray) -> tuple[float, float, float]:
    """Return bounds on |d'|, |d''| and |d'''| for h in [0, 1]."""
    first, second, third = 0.0, 0.0, 0.0
    for m in range(1, COEFFICIENTS):
        size = np.sqrt(path[m, 0] * path[m, 0] + path[m, 1] * path[m, 1] + path[m, 2] * path[m, 2])
        first += m * size
        second += m * (m - 1) * size
        third += m * (m - 1) * (m - 2) * size
    return first, second, third


@inner
def _first_root(path: FloatArray, R: float, gap: float, negligible: float) -> float:
    """Return the first h at which bodies touch and close, `NONE` or `AT_REST`, with lengths in m.

    ``path``, (COEFFICIENTS, 3), is d, ``gap`` is the rounding of d, and ``negligible`` is the largest change of d by a
    closing speed that counts as rounding.
    """
    fastest, M, third = _bounds(path)
    still = negligible * R
    d2, g, bend, _ = _at(path, 0.0)
    touches = d2 <= (R + gap) * (R + gap)
    if touches and g < -still:
        return 0.0
    if touches and bend < 0.0 and 2.0 * g < -REST * bend:
        return AT_REST
    a, width = 0.0, 1.0
    for _ in range(MOST_INTERVALS):
        if not a < 1.0:
            return NONE
        b = min(1.0, a + width)
        w = b - a
        far = R + SLACK * M * w * w / 8.0 + gap
        end_d2, end_g, end_bend, _ = _at(path, b)
        K = SLACK * (3.0 * fastest * M + (np.sqrt(max(d2, end_d2)) + fastest * w) * third)
        done = _chord(path, a, b) > far * far
        if not done:
            done = g > -still and g + bend * w - 0.5 * K * w * w > -still
        if not done and end_d2 <= R * R and end_g < -still and end_g - end_bend * w + 0.5 * K * w * w < 0.0:
            return _solve(path, R, a, b) if d2 > R * R else a
        if not done and w <= NARROWEST:
            if end_d2 <= R * R and end_g < -still:
                return b
            done = True
        if done:
            a, d2, g, bend = b, end_d2, end_g, end_bend
            width = min(1.0, 2.0 * width)
        else:
            width *= 0.5
    return AT_REST


@inner
def _solve(path: FloatArray, R: float, a: float, b: float) -> float:
    """Return the root of d² - R², which falls in [a, b], by Newton's method and bisection."""
    h = 0.5 * (a + b)
    for _ in range(100):
        d2, g, _, _ = _at(path, h)
        f = d2 - R * R
        if f > 0.0:
            a = h
        else:
            b = h
        next_h = h - 0.5 * f / g if g < 0.0 else a
        if not a < next_h < b:
            next_h = 0.5 * (a + b)
        if next_h == h or not a < next_h < b:
            break
        h = next_h
    return h


@inner
def time_to_touch(motion: Motion, solids: Solids, i: int, j: int, dt: float) -> float:
    """Return the change (s) of the step's length with which a closing pair would touch at the end of the step."""
    n = len(motion.position)
    if j < n:
        _lay_pair(motion, solids.path, i, j, dt)
        R = solids.radius[i] + solids.radius[j]
    else:
        _lay_height(motion, solids, i, j - n, dt)
        R = solids.radius[i]
    d2, g, _, _ = _at(solids.path, 1.0)
    # (d - R) / -d', with d - R = (d² - R²)/(d + R), which avoids cancellation, and d' = g/d
    d = np.sqrt(d2)
    return float(dt * (d2 - R * R) * d / ((d + R) * -g)) if g < 0.0 else 0.0
