"""Time of impact of two bodies on straight paths.

Let d and v be the separation and the velocity of j relative to i, and R = r_i + r_j. Bodies that close, d·v < 0, are
nearest at t_c = -d·v/v², where their separation is p = d + v t_c. The bodies touch before the closest approach if |p| <
R:

    τ = t_c - √((R² - p²)/v²)

p is computed as a vector, because the discriminant (d·v)² - v² (d² - R²) would lose the radius of a small, distant
sphere to rounding. Bodies that already overlap and close meet at once.

Where a uniform field bends the path of only one of two bodies, their separation is d + w t + ½ b t². The second
derivative of the gap between their surfaces is at least -|b|. A gap g that closes at the speed c therefore stays open
for

    2 g / (c + √(c² + 2 |b| g))

Steps of this length converge to the first root from below, at the rate of Newton's method. Under drag with the rate λ,
the separation is d + w t φ₁ + b t² φ₂, with φ₁ and φ₂ of λ t (`carom.physics.exponential`), and its second derivative
is (b - λ w) e^{-λt}, whose magnitude only shrinks.

A drift moves bodies with the velocities of the middle of the step. At τ, the velocity is v + a (τ - h), where h is the
kick before the drift; under drag, a - λ v takes the place of a. A meeting is an impact only if the bodies then close
faster than a given speed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.physics.contact.impact_log import ROUNDING
from carom.physics.contact.solver.prepare import TOUCHING
from carom.physics.exponential import exponentials
from carom.physics.jit.decorators import inline, kernel, with_field
from carom.physics.sheared_box import along_gradient, in_axes
from carom.physics.vector import Vector, between, nearest_image, vector

CLEARANCE = 1e-6  # clearance relative to the squared distance; it exceeds the rounding of times of impact
MOST_PASSES = 100
GAP_TOLERANCE = 2.0**-50  # gap, relative to the sum of radii, that counts as rounding

# Constants of `step_by_impacts`.
PASSES = 3  # passes, each of which uses the mean velocity up to the impact that the previous pass found
SLOW_CONTACT = 2.0  # least closing speed of an impact, divided by the speed that a contact at rest may gain in the span
APPROACH = 0.9  # fraction of the time to an impact that a step covers
SHORT = 1e-4  # fraction of the span; a step of this length passes over impacts that come sooner


@inline
def stay_apart(d: Vector, v: Vector, R: float, span: float) -> bool:
    """Return whether two bodies certainly stay farther apart than R within a span, without a division or a root.

    |d + v t|² is at least d² + 2 d·v t. Most neighbours pass this test. The arguments have the units of
    `time_of_impact`.
    """
    (dx, dy, dz), (vx, vy, vz) = d, v
    closing = min(0.0, dx * vx + dy * vy + dz * vz)
    return bool((1.0 - CLEARANCE) * (dx * dx + dy * dy + dz * dz) + 2.0 * closing * span > R * R)


@kernel
def time_of_impact(d: Vector, v: Vector, a: Vector, R: float, span: float, since_kick: float, slow: float) -> float:
    """Return the time (s) until two bodies meet in an impact; infinite if they do not within a span (s).

    One body has the separation d (m), the velocity v (m/s) and the acceleration a (m/s²) relative to the other. R is
    the sum of their radii in m, ``since_kick`` is the present time minus the time of the velocities in s, and ``slow``
    is the largest closing speed in m/s that is not an impact.
    """
    (dx, dy, dz), (vx, vy, vz), (ax, ay, az) = d, v, a
    b = dx * vx + dy * vy + dz * vz
    if not b < 0.0:
        return np.inf
    tau = 0.0
    if dx * dx + dy * dy + dz * dz > R * R:
        v2 = vx * vx + vy * vy + vz * vz
        tau = -b / v2
        px, py, pz = dx + vx * tau, dy + vy * tau, dz + vz * tau
        half_chord2 = R * R - (px * px + py * py + pz * pz)
        if not half_chord2 > 0.0:  # bodies in a grazing pass do not close
            return np.inf
        tau = max(0.0, tau - np.sqrt(half_chord2 / v2))
        if tau > span:
            return np.inf
    nx, ny, nz, s = dx + vx * tau, dy + vy * tau, dz + vz * tau, since_kick + tau
    closing = -((vx + ax * s) * nx + (vy + ay * s) * ny + (vz + az * s) * nz)
    return tau if closing > slow * np.sqrt(nx * nx + ny * ny + nz * nz) else np.inf


@kernel
def time_of_impact_on_parabola(
    separation: Vector, velocity: Vector, acceleration: Vector, damping: float, R: float, span: float
) -> float:
    """Return the time (s) until two bodies touch and close; infinite if they do not within a span (s).

    The bodies have a relative separation (m), velocity (m/s) and acceleration without drag (m/s²). Drag slows the
    bodies down at the rate ``damping`` in 1/s. R is the sum of both radii in m.
    """
    (dx, dy, dz), (wx, wy, wz), (bx, by, bz) = separation, velocity, acceleration
    ax, ay, az = bx - damping * wx, by - damping * wy, bz - damping * wz
    b = np.sqrt(ax * ax + ay * ay + az * az)
    decay, phi1, phi2 = 1.0, 1.0, 0.5
    if damping > 0.0:
        decay, phi1, phi2 = exponentials(damping * span)
    ux, uy, uz = phi1 * wx + phi2 * span * bx, phi1 * wy + phi2 * span * by, phi1 * wz + phi2 * span * bz  # mean
    near = R + 0.125 * b * span * span  # distance from the chord of the path
    t = 0.0
    if dx * dx + dy * dy + dz * dz > near * near:
        t = time_of_impact(separation, (ux, uy, uz), (0.0, 0.0, 0.0), near, span, 0.0, -np.inf)
    for _ in range(MOST_PASSES):
        if not t <= span:
            return np.inf
        if damping > 0.0:
            decay, phi1, phi2 = exponentials(damping * t)
        px, py = dx + t * (phi1 * wx + phi2 * t * bx), dy + t * (phi1 * wy + phi2 * t * by)
        pz = dz + t * (phi1 * wz + phi2 * t * bz)
        distance = np.sqrt(px * px + py * py + pz * pz)
        vx, vy, vz = decay * wx + phi1 * t * bx, decay * wy + phi1 * t * by, decay * wz + phi1 * t * bz
        closing = -(vx * px + vy * py + vz * pz) / distance
        gap = distance - R
        if gap <= GAP_TOLERANCE * R and closing > 0.0:
            return t
        further = open_for(gap, closing, decay * b)
        if not t + further > t:
            return t if closing > 0.0 else np.inf
        t += further
    return np.inf  # a grazing pass


@kernel
def time_to_plane_in_medium(gap: float, rate: float, bend: float, damping: float, R: float, span: float) -> float:
    """Return the time (s) until a body of radius R (m) touches a plane and closes; infinite if not within a span (s).

    ``gap`` (m) and ``rate`` (m/s) are the present gap and its rate of change, ``bend`` (m/s²) is the acceleration
    without drag. Drag slows the body down at the rate ``damping`` in 1/s.
    """
    falls = max(0.0, damping * rate - bend)
    t = 0.0
    for _ in range(MOST_PASSES):
        if not t <= span:
            return np.inf
        decay, phi1, phi2 = exponentials(damping * t)
        remaining = gap + t * (phi1 * rate + phi2 * t * bend)
        closing = -(decay * rate + phi1 * t * bend)
        if remaining <= GAP_TOLERANCE * R and closing > 0.0:
            return t
        if falls == 0.0 and not closing > 0.0:
            return np.inf
        further = open_for(remaining, closing, decay * falls)
        if not t + further > t:
            return t if closing > 0.0 else np.inf
        t += further
    return np.inf


@inline
def open_for(gap: float, closing: float, b: float) -> float:
    """Return a lower bound (s) of the time until a gap closes, if its closing speed grows by at most b (m/s²)."""
    gap = max(0.0, gap)
    root = np.sqrt(closing * closing + 2.0 * b * gap)
    return float(2.0 * gap / (closing + root) if closing > 0.0 else (root - closing) / b)


@kernel
def time_of_impact_in_box(
    d: Vector, v: Vector, a: Vector, R: float, span: float, since_kick: float, slow: float, box: Vector
) -> float:
    """Return `time_of_impact` in a periodic box, given its size in m, for any number of passes through the box.

    The path is cut into legs of at most half a box. On a leg, a body can meet the nearest image of another body or,
    along each axis, the approaching image.
    """
    (dx, dy, dz), (vx, vy, vz), (Lx, Ly, Lz) = d, v, box
    passed = 0.0
    while True:
        dx, dy, dz = nearest_image(dx, dy, dz, box)
        leg = span - passed
        leg = min(leg, 0.5 * Lx / abs(vx)) if vx != 0.0 else leg
        leg = min(leg, 0.5 * Ly / abs(vy)) if vy != 0.0 else leg
        leg = min(leg, 0.5 * Lz / abs(vz)) if vz != 0.0 else leg
        sx, sy, sz = _next_image(dx, vx, Lx, R, leg), _next_image(dy, vy, Ly, R, leg), _next_image(dz, vz, Lz, R, leg)
        first = np.inf
        for kx in range(2 if sx != 0.0 else 1):
            for ky in range(2 if sy != 0.0 else 1):
                for kz in range(2 if sz != 0.0 else 1):
                    x, y, z = dx + kx * sx, dy + ky * sy, dz + kz * sz
                    tau = time_of_impact((x, y, z), v, a, R, leg, since_kick + passed, slow)
                    first = min(first, tau)
        if first < np.inf:
            return passed + first
        if not passed < passed + leg < span:
            return np.inf
        dx, dy, dz, passed = dx + vx * leg, dy + vy * leg, dz + vz * leg, passed + leg


def _each_on_its_line(
    d: Vector, v: Vector, a: Vector, R: float, slow: float, times: tuple[float, float, float], box: Any
) -> float:
    """Test the images that come within R along the gradient; along the other axes, the box is simply periodic."""
    span, since_kick, clock = times
    B = box[0]
    (dx, dy, dz), (vx, vy, vz) = d, v
    start = along_gradient(dx, dy, dz, B.gradient)
    end = start + along_gradient(vx, vy, vz, B.gradient) * span
    k, last = np.ceil((min(start, end) - R) / B.depth), np.floor((max(start, end) + R) / B.depth)
    first = np.inf
    while k <= last:
        sx, sy, sz = in_axes(B, k * (B.shift + B.speed * clock), k * B.depth)
        ux, uy, uz = in_axes(B, k * B.speed, 0.0)
        separation, velocity = (dx - sx, dy - sy, dz - sz), (vx - ux, vy - uy, vz - uz)
        across = B.period_x, B.period_y, B.period_z
        first = min(first, time_of_impact_in_box(separation, velocity, a, R, span, since_kick, slow, across))
        k += 1.0
    return float(first)


@with_field("shift", _each_on_its_line, place=6)
def first_of_images(
    d: Vector, v: Vector, a: Vector, R: float, slow: float, times: tuple[float, float, float], box: Any
) -> float:
    """Return `time_of_impact` in a sheared box; infinity in other boxes.

    ``times`` are the span and the time since the kick, as for `time_of_impact`, and the time since the step began.
    """
    return np.inf


@kernel
def _next_image(d: float, v: float, L: float, R: float, leg: float) -> float:
    """Return the offset of the approaching image from the nearest image; 0 if it stays too far away."""
    if v > 0.0:
        return -L if L - d - v * leg <= R else 0.0
    if v < 0.0:
        return L if L + d + v * leg <= R else 0.0
    return 0.0


@kernel
def step_by_impacts(
    x: FloatArray,
    v: FloatArray,
    a: FloatArray,
    radius: FloatArray,
    surface: FloatArray,
    offset: FloatArray,
    pairs: IntArray,
    span: float,
) -> float:
    """Return the longest step (s) that the next impact allows; infinite if there is none within a span (s).

    ``pairs``, (m, 2), sorted, are the contacts of the last step. Contacts that touch are held and are not impacts: they
    close at speeds within the tolerance of the solver.

    A held contact acts on its bodies with one impulse for the whole step. At an impact in the middle of the step, the
    velocities lack part of this impulse; bodies that separate in the middle of the step keep too much of it. Both are
    errors of first order in the step. Each step therefore covers nine tenths of the time to the impact, until a very
    short step passes it. The prediction ignores held contacts, an error of second order.
    """
    first, n, k = np.inf, len(radius), 0
    for i in range(n):
        for j in range(i + 1, n):
            (dx, dy, dz), R = between(x, i, j), radius[i] + radius[j]
            if k < len(pairs) and pairs[k, 0] == i and pairs[k, 1] == j:
                k += 1
                if dx * dx + dy * dy + dz * dz <= (R * (1.0 + TOUCHING)) ** 2:
                    continue
            first = min(first, _time_to_impact((dx, dy, dz), between(v, i, j), between(a, i, j), R, span))
        for p in range(len(offset)):
            nx, ny, nz = vector(surface, p)
            h = nx * x[i, 0] + ny * x[i, 1] + nz * x[i, 2] - offset[p]
            if k < len(pairs) and pairs[k, 0] == i and pairs[k, 1] == n + p:
                k += 1
                if h <= radius[i] * (1.0 + TOUCHING):
                    continue
            u = nx * v[i, 0] + ny * v[i, 1] + nz * v[i, 2]
            g = nx * a[i, 0] + ny * a[i, 1] + nz * a[i, 2]
            first = min(first, _time_to_impact((h, 0.0, 0.0), (u, 0.0, 0.0), (g, 0.0, 0.0), radius[i], span))
    return APPROACH * first if first > SHORT * span else first + SHORT * span


@inline
def _time_to_impact(d: Vector, v: Vector, a: Vector, R: float, span: float) -> float:
    """Return the time (s) until two bodies meet in an impact, on parabolas without held contacts."""
    (vx, vy, vz), (ax, ay, az) = v, a
    tau = span
    for _ in range(PASSES):
        h = 0.5 * tau
        slow = SLOW_CONTACT * span * np.sqrt(ax * ax + ay * ay + az * az) + ROUNDING * R / span
        tau = time_of_impact(d, (vx + ax * h, vy + ay * h, vz + az * h), a, R, span, -h, slow)
        if tau == np.inf:
            break
    return tau
