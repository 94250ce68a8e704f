"""The rule for the adaptive step, as kernels that single steps and calls of many steps share.

`carom.physics.time_step` describes the limits by accelerations and speeds. Where nothing can touch, gravity limits the
step to a fraction of the shortest time scale of any pair. A pair at distance r has a fly-by time r/v and a free-fall
time √(r³/(G M)), with M = m_i + m_j. With Plummer's R² = r² + ε², these combine to

    1/τ² = v²/R² + G M/R³,    τ'/τ = (r·v/R²) (1 + 3/2 (G M/R) / (v² + G M/R))

(Pelupessy, Jänes & Portegies Zwart 2012 use the shorter of the two.) A step of η τ, with τ at its start, would be
longer before an encounter than after it, and the energy would drift. Half of the change of τ in the step is therefore
added, as Pelupessy et al. do: to first order, h = η τ / (1 - η τ'/2) is the mean of the values at both ends, so the
steps along an orbit are the same in both directions of time. At an eccentricity of 0.999, the energy is then conserved
over 20 orbits to 5 × 10⁻¹¹, but only to 10⁻⁶ without the correction.

With more than `PAIRS_UP_TO` bodies, single pairs are not examined. If the acceleration a of a body is due to a single
neighbour of mass m, the neighbour is at distance r = √(G m/a), and the two fall together in a time (G m)^¼ a^(-¾). For
a body in the common field of many others, this time is shorter than necessary. Softening ε bounds the time from below
by √(ε/a).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray, dtype_of
from carom.physics.diagnostics.momentum import centre_velocity
from carom.physics.jit.decorators import inline, inner, kernel, long_kernel
from carom.physics.vector import Vector

SHORTEST_MEAN = 0.5  # smallest divisor 1 - η τ'/2, which could reach 0 for a large η


@inline
def step_of_largest(largest: float, mean: float, softening: float, fraction: float) -> float:
    """Return the largest step in seconds, given the largest acceleration of a body in m/s² and G m in m³/s²."""
    if largest == 0.0:
        return np.inf
    # nested square roots are exact in units scaled by powers of two, so the bits do not depend on such units
    alone = np.sqrt(np.sqrt(mean / largest) / largest)
    step: float = fraction * max(alone, np.sqrt(softening / largest))
    return step


@inner
def step_of_pairs(
    x: FloatArray, v: FloatArray, m: FloatArray, inverse_mass: FloatArray, G: float, softening: float, fraction: float
) -> float:
    """Return h of the pair with the shortest τ; infinite if no pair attracts."""
    soft2 = softening * softening
    fastest, change = 0.0, 0.0  # 1/τ² in 1/s², and τ'/τ in 1/s
    for i in range(len(m) - 1):
        for j in range(i + 1, len(m)):
            # neither body attracts the other
            if (inverse_mass[i] == 0.0 and inverse_mass[j] == 0.0) or m[i] + m[j] == 0.0:
                continue
            R2, v2, along = soft2, 0.0, 0.0
            for k in range(3):
                d, u = x[j, k] - x[i, k], v[j, k] - v[i, k]
                R2, v2, along = R2 + d * d, v2 + u * u, along + d * u
            if R2 == 0.0:  # coincident centres do not attract each other
                continue
            gm_over_r = G * (m[i] + m[j]) / np.sqrt(R2)
            rate = (v2 + gm_over_r) / R2
            if rate > fastest:
                fastest, change = rate, (along / R2) * (1.0 + 1.5 * gm_over_r / (v2 + gm_over_r))
    if fastest == 0.0:
        return np.inf
    step: float = fraction / np.sqrt(fastest)
    return step / max(SHORTEST_MEAN, 1.0 - 0.5 * step * change)


BODIES_PER_BLOCK = 1000  # bodies for about 10 µs of work
SUPPORTED_FRACTION = 0.5  # a body is held if contacts support at least this fraction of its acceleration
END_TOLERANCE = 1e-9  # fraction of a step; a shorter last step is merged into the previous one

CAP, VELOCITY, ACCELERATION, HELD, GRAVITY, GROWTH, FIXED, END = range(8)
LIMIT_NAMES = ("cap", "velocity", "acceleration", "held", "pull", "growth", "fixed", "end")


class RuleRecord(Protocol):
    """The limits of the steps."""

    max_dt: float  # s
    cfl: float  # `cfl`, 0 for no limit, like the other limits below
    by_fastest_body: bool  # whether only the fastest body limits the step
    target_dx: float  # m
    held_dx: float  # m, replaces ``target_dx`` for bodies held by lasting contacts
    held_part: float  # largest motion of a held body in a step, divided by its radius
    smoothing: float  # weight of the new step in the moving average
    anchored: bool  # whether anything is fixed; speeds are then relative to it
    measures_bodies: bool  # whether a limit needs the largest values of all bodies
    gravity_fraction: float  # η, the step as a fraction of the shortest time scale of gravity
    examines_pairs: bool  # whether the shortest time scale comes from a pair, rather than from the largest acceleration
    constant: float  # m³/(kg s²), G
    softening: float  # m
    mean: float  # m³/s², G times the mean mass


RULE = dtype_of(RuleRecord)


class LimitsRecord(Protocol):
    """The largest values of the bodies of a block."""

    largest_acceleration: float  # m/s²
    largest_free_acceleration: float  # m/s², largest acceleration of bodies not held by contacts
    largest_supported: float  # m/s², largest acceleration supported by contacts
    velocity_step: float  # s, smallest dt_v of all bodies; infinite if all bodies are at rest
    fastest_step: float  # s, dt_v of the fastest body
    fastest_squared: float  # m²/s², squared speed of the fastest body
    held_time: float  # s, shortest time in which a held body moves by its radius


LIMITS = dtype_of(LimitsRecord)


@kernel
def smooth_and_cut(
    dt: float, limit: int, smoothing: float, previous: float, remaining: float
) -> tuple[float, int, float]:
    """Smooth a step that grows, and cut the last step; return the step (s), its limit, and the new average (s).

    ``smoothing`` is the weight of the new step in the average. ``previous`` is the average so far, or 0 before the
    first step.
    """
    if 0.0 < previous < dt:
        dt, limit = previous + smoothing * (dt - previous), limit if smoothing == 1.0 else GROWTH
    if remaining <= dt * (1.0 + END_TOLERANCE):
        return remaining, END, dt
    return dt, limit, dt


MovingBodies = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Positions, velocities and accelerations (n, 3), radii and masses (n,), and inverse masses with planes (n + p,)."""


@long_kernel
def target(
    rule: RecordArray[RuleRecord],
    bodies: MovingBodies,
    supported: FloatArray,
    field: FloatArray,
    limits: RecordArray[LimitsRecord],
    are_known: bool,
) -> tuple[float, int]:
    """Return the step (s) that the limits allow, before smoothing, and the limit that set it.

    ``supported``, (n + p,) m/s², are the accelerations that contacts support; it is empty if there are none. The
    acceleration that all bodies share, ``field``, (3,) m/s², is left out. ``limits`` has a row for each block of
    bodies; the rows are filled here unless they ``are_known``.
    """
    R, (x, v, _, _, m, inverse_mass) = rule[0], bodies
    dt, limit = R.max_dt, CAP
    a_max, a_free, b_max, every, fastest, held_time = 0.0, 0.0, 0.0, np.inf, np.inf, np.inf
    if R.measures_bodies:
        if not are_known:
            V = (0.0, 0.0, 0.0) if R.anchored else centre_velocity(v, m)
            cfl = R.cfl if R.cfl > 0.0 else 1.0
            find_limits(0, len(limits), bodies, (supported, field), cfl, V, limits)
        a_max, a_free, b_max, every, fastest, held_time = _strictest(limits)
    if R.cfl > 0.0:
        dt_v = fastest if R.by_fastest_body else every
        if dt_v < dt:
            dt, limit = dt_v, VELOCITY
    if R.target_dx > 0.0 and a_max > 0.0:
        dt_a, why = _of_acceleration(R.target_dx, R.held_dx, R.held_part, a_max, a_free, b_max, held_time)
        if dt_a < dt:
            dt, limit = dt_a, why
    if R.gravity_fraction > 0.0:
        if R.examines_pairs:
            dt_p = step_of_pairs(x, v, m, inverse_mass, R.constant, R.softening, R.gravity_fraction)
        else:
            dt_p = step_of_largest(a_max, R.mean, R.softening, R.gravity_fraction)
        if dt_p < dt:
            dt, limit = dt_p, GRAVITY
    return dt, limit


@inline
def _of_acceleration(
    dx: float, held_dx: float, held_part: float, a_max: float, a_free: float, b_max: float, held_time: float
) -> tuple[float, int]:
    """Return the step allowed by the accelerations, and its limit."""
    dt_a = np.sqrt(2.0 * dx / a_max)
    if held_dx == 0.0 or a_free == a_max:
        return dt_a, ACCELERATION
    dt_free = np.sqrt(2.0 * dx / a_free) if a_free > 0.0 else np.inf
    by_load = np.sqrt(2.0 * held_dx / max(a_max, b_max))
    dt_held = max(dt_a, min(by_load, held_part * held_time))
    if dt_free < dt_held:
        return dt_free, ACCELERATION
    return dt_held, HELD


@long_kernel
def find_limits(
    lo: int,
    hi: int,
    bodies: MovingBodies,
    discounted: tuple[FloatArray, FloatArray],
    cfl: float,
    V: Vector,
    found: RecordArray[LimitsRecord],
) -> None:
    """Write the limits set by the bodies of the blocks [lo, hi), with speeds relative to V (m/s).

    ``discounted`` is the pair (``supported``, ``field``) of `target`.
    """
    _, velocity, acceleration, radius, _, _ = bodies
    (supported, field), (Vx, Vy, Vz) = discounted, V
    for block in range(lo, hi):
        a_max, v2_max, fastest, every, a_free, held_time, b_max = 0.0, 0.0, np.inf, np.inf, 0.0, np.inf, 0.0
        for i in range(block * BODIES_PER_BLOCK, min((block + 1) * BODIES_PER_BLOCK, len(radius))):
            ax, ay, az = acceleration[i, 0] - field[0], acceleration[i, 1] - field[1], acceleration[i, 2] - field[2]
            a = np.sqrt(ax * ax + ay * ay + az * az)
            a_max = max(a_max, a)
            vx, vy, vz = velocity[i, 0], velocity[i, 1], velocity[i, 2]
            ux, uy, uz = vx - Vx, vy - Vy, vz - Vz
            u = np.sqrt(ux * ux + uy * uy + uz * uz)
            if len(supported) > 0:
                b_max = max(b_max, supported[i])
            if len(supported) > 0 and supported[i] >= SUPPORTED_FRACTION * a:
                held_time = min(held_time, radius[i] / u) if u > 0.0 else held_time
            else:
                a_free = max(a_free, a)
            s = cfl * radius[i]
            every = min(every, 2.0 * s / (u + np.sqrt(u * u + 2.0 * a * s)))
            v2 = vx * vx + vy * vy + vz * vz
            if v2 > v2_max:
                v2_max, fastest = v2, s / np.sqrt(v2)
        limits = found[block]
        limits.largest_acceleration, limits.largest_free_acceleration, limits.largest_supported = a_max, a_free, b_max
        limits.velocity_step, limits.held_time = every, held_time
        limits.fastest_step, limits.fastest_squared = fastest, v2_max


@kernel
def _strictest(found: RecordArray[LimitsRecord]) -> tuple[float, float, float, float, float, float]:
    """Return the strictest value over all blocks of each field of `LIMITS` except ``fastest_squared``."""
    a_max, a_free, b_max, every, fastest, v2_max, held_time = 0.0, 0.0, 0.0, np.inf, np.inf, 0.0, np.inf
    for block in range(len(found)):
        limits = found[block]
        a_max = max(a_max, limits.largest_acceleration)
        a_free, b_max = max(a_free, limits.largest_free_acceleration), max(b_max, limits.largest_supported)
        every, held_time = min(every, limits.velocity_step), min(held_time, limits.held_time)
        if limits.fastest_squared > v2_max:
            v2_max, fastest = limits.fastest_squared, limits.fastest_step
    return a_max, a_free, b_max, every, fastest, held_time
