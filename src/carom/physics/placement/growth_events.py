"""Spheres that fly, bounce and grow: the events of a Lubachevsky–Stillinger compression.

With the sum of radii D (1 + k s), the time s of impact of two spheres follows from that of spheres of constant size,

    |x + v s| = D (1 + k s)   ⟺   |x + (v - k x) σ| = D,   s = σ / (1 - k σ)

A sphere with room E - g s for its centre, inside of a ball or a cylinder about the origin, meets its wall at

    |x + v s| = E - g s   ⟺   (v² - g²) s² + 2 (x·v + g E) s + x² - E² = 0

Surfaces rebound at the speed at which they closed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.continuous.event_queue import put
from carom.physics.contact.continuous.time_of_impact import time_of_impact
from carom.physics.parallel.jit import inner, long_kernel
from carom.physics.periodic_box import nearest_image

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

SPHERE = np.dtype(
    [
        ("x", np.float64),  # m, at the time `now`
        ("y", np.float64),
        ("z", np.float64),
        ("vx", np.float64),  # m/s
        ("vy", np.float64),
        ("vz", np.float64),
        ("radius", np.float64),  # m, at the beginning of the flight
        ("growth", np.float64),  # m/s; 0 of fixed spheres
        ("inverse_mass", np.float64),  # of any unit; 0 of fixed spheres
        ("skin", np.float64),  # m that it may move until neighbours are searched again
        ("start_x", np.float64),  # m, at the beginning of the flight
        ("start_y", np.float64),
        ("start_z", np.float64),
        ("now", np.float64),  # s from the beginning of the flight
        ("impacts", np.int64),  # so far in this flight
        ("impact_time", np.float64),  # s, of its next impact; infinite if there is none
        ("partner", np.int64),  # the other end of that impact: sphere j, or the number of spheres + k for border k
        ("partner_impacts", np.int64),  # those of the partner when that impact was predicted
        ("queue_place", np.int64),  # see `event_queue`
    ],
    align=True,
)

BORDER = np.dtype(
    [
        ("flat", np.bool_),  # a plane: spheres are where `normal · x > offset`
        ("nx", np.float64),
        ("ny", np.float64),
        ("nz", np.float64),
        ("offset", np.float64),  # m
        ("radius", np.float64),  # m, of a round one about the origin
        ("around", np.bool_),  # whether spheres are inside of it, else outside
        ("upright", np.bool_),  # a cylinder along z, else a ball
    ],
    align=True,
)


@long_kernel
def fly(
    sphere: Records,
    movers: int,
    border: Records,
    queue: IntArray,
    ends: IntArray,
    others: IntArray,
    box: FloatArray,
    images: int,
    span: float,
    most: int,
) -> tuple[float, int]:
    """Fly until a sphere has left its skin, for a span in s or so many impacts at most.

    Parameters
    ----------
    sphere
        (n,) `SPHERE`; those from ``movers`` on are fixed.
    border
        (b,) `BORDER`.
    queue
        (movers,) room for the event queue.
    ends, others
        The neighbours of sphere i are ``others[ends[i]:ends[i + 1]]``.
    box
        (3,) m; zeros in open space.
    images
        Number of images on either side of the nearest one that can be met, too, in a box of a few radii.

    Returns
    -------
    time
        s that it took.
    impacts
        Their number.
    """
    size, impacts = 0, 0
    for i in range(len(sphere)):
        a = sphere[i]
        a.start_x, a.start_y, a.start_z = a.x, a.y, a.z
        a.now, a.impacts, a.impact_time, a.queue_place = 0.0, 0, np.inf, -1
        if i < movers:
            span = min(span, _time_in_skin(a))
    for i in range(movers):
        _predict(i, 0.0, span, sphere, border, ends, others, box, images)
        size = put(i, size, queue, sphere)
    while size > 0 and sphere[queue[0]].impact_time < span:
        i = queue[0]
        j, now = sphere[i].partner, sphere[i].impact_time
        if j >= len(sphere):
            _advance(sphere[i], now)
            _bounce_off(sphere[i], border[j - len(sphere)])
            span = min(span, now + _time_in_skin(sphere[i]))
            impacts += 1
        elif sphere[j].impacts == sphere[i].partner_impacts:
            _advance(sphere[i], now)
            _advance(sphere[j], now)
            _bounce(sphere[i], sphere[j], box)
            span = min(span, now + _time_in_skin(sphere[i]))
            impacts += 1
            if j < movers:
                span = min(span, now + _time_in_skin(sphere[j]))
                _predict(j, now, span, sphere, border, ends, others, box, images)
                size = put(j, size, queue, sphere)
        _predict(i, now, span, sphere, border, ends, others, box, images)
        size = put(i, size, queue, sphere)
        if impacts == most:
            span = now
    for i in range(movers):
        _advance(sphere[i], span)
    return span, impacts


@inner
def _advance(a: Any, now: float) -> None:
    """Move a sphere to a time."""
    s = now - a.now
    a.x, a.y, a.z, a.now = a.x + a.vx * s, a.y + a.vy * s, a.z + a.vz * s, now


@inner
def _time_in_skin(a: Any) -> float:
    """Return in how many s a sphere leaves its skin."""
    ox, oy, oz = a.x - a.start_x, a.y - a.start_y, a.z - a.start_z
    v2 = a.vx * a.vx + a.vy * a.vy + a.vz * a.vz
    ov = ox * a.vx + oy * a.vy + oz * a.vz
    room = max(0.0, a.skin * a.skin - (ox * ox + oy * oy + oz * oz))
    return float((np.sqrt(ov * ov + v2 * room) - ov) / v2) if v2 > 0.0 else np.inf


@inner
def _bounce(a: Any, b: Any, box: FloatArray) -> None:
    """Let two spheres rebound; a fixed one has no inverse mass."""
    nx, ny, nz = b.x - a.x, b.y - a.y, b.z - a.z
    if box[0] > 0.0:
        nx, ny, nz = nearest_image(nx, ny, nz, box[0], box[1], box[2])
    d2 = nx * nx + ny * ny + nz * nz
    closing = (a.growth + b.growth) * np.sqrt(d2) - ((b.vx - a.vx) * nx + (b.vy - a.vy) * ny + (b.vz - a.vz) * nz)
    J = 2.0 * closing / (d2 * (a.inverse_mass + b.inverse_mass))
    p, q = J * a.inverse_mass, J * b.inverse_mass
    a.vx, a.vy, a.vz = a.vx - p * nx, a.vy - p * ny, a.vz - p * nz
    b.vx, b.vy, b.vz = b.vx + q * nx, b.vy + q * ny, b.vz + q * nz
    a.impacts += 1
    b.impacts += 1


@inner
def _bounce_off(a: Any, wall: Any) -> None:
    """Let a sphere rebound from a border."""
    nx, ny, nz = wall.nx, wall.ny, wall.nz
    if not wall.flat:
        nx, ny, nz = a.x, a.y, 0.0 if wall.upright else a.z
        d = np.sqrt(nx * nx + ny * ny + nz * nz)
        d = -d if wall.around else d
        nx, ny, nz = nx / d, ny / d, nz / d
    change = 2.0 * (a.growth - (a.vx * nx + a.vy * ny + a.vz * nz))
    a.vx, a.vy, a.vz = a.vx + change * nx, a.vy + change * ny, a.vz + change * nz
    a.impacts += 1


@inner
def _predict(
    i: int,
    now: float,
    span: float,
    sphere: Records,
    border: Records,
    ends: IntArray,
    others: IntArray,
    box: FloatArray,
    images: int,
) -> None:
    """Predict the next impact of a sphere."""
    a, left = sphere[i], span - now
    s = now - a.now
    x, y, z, r = a.x + a.vx * s, a.y + a.vy * s, a.z + a.vz * s, a.radius + a.growth * now
    first = np.inf
    for k in range(len(border)):
        when = now + _time_to_border(x, y, z, r, a, border[k], left)
        if when < first:
            first, a.partner = when, len(sphere) + k
    for m in range(ends[i], ends[i + 1]):
        b = sphere[others[m]]
        t = now - b.now
        dx, dy, dz = (b.x + b.vx * t) - x, (b.y + b.vy * t) - y, (b.z + b.vz * t) - z
        if box[0] > 0.0:
            dx, dy, dz = nearest_image(dx, dy, dz, box[0], box[1], box[2])
        D, growth = r + b.radius + b.growth * now, a.growth + b.growth
        vx, vy, vz = b.vx - a.vx, b.vy - a.vy, b.vz - a.vz
        for ix in range(-images, images + 1):
            for iy in range(-images, images + 1):
                for iz in range(-images, images + 1):
                    px, py, pz = dx + ix * box[0], dy + iy * box[1], dz + iz * box[2]
                    when = now + _time_to_sphere(px, py, pz, vx, vy, vz, D, growth, left)
                    if when < first:
                        first, a.partner, a.partner_impacts = when, others[m], b.impacts
    a.impact_time = first


@inner
def _time_to_sphere(
    dx: float,
    dy: float,
    dz: float,
    vx: float,
    vy: float,
    vz: float,
    D: float,
    growth: float,
    left: float,
) -> float:
    """Return in how many s two spheres meet; infinite if not within the time left."""
    k = growth / D
    wx, wy, wz = vx - k * dx, vy - k * dy, vz - k * dz
    sigma = time_of_impact(dx, dy, dz, wx, wy, wz, 0.0, 0.0, 0.0, D, left / (1.0 + k * left), 0.0, 0.0)
    return float(sigma / (1.0 - k * sigma)) if sigma < np.inf else np.inf


@inner
def _time_to_border(x: float, y: float, z: float, r: float, a: Any, wall: Any, left: float) -> float:
    """Return in how many s a sphere of radius r at (x, y, z) meets a border; infinite if never."""
    g = a.growth
    if wall.flat:
        closing = g - (a.vx * wall.nx + a.vy * wall.ny + a.vz * wall.nz)
        gap = x * wall.nx + y * wall.ny + z * wall.nz - wall.offset - r
        return float(max(0.0, gap) / closing) if closing > 0.0 else np.inf
    vz = a.vz
    if wall.upright:
        z, vz = 0.0, 0.0
    if not wall.around:
        return _time_to_sphere(x, y, z, a.vx, a.vy, vz, wall.radius + r, g, left)
    room = max(0.0, wall.radius - r)
    A = a.vx * a.vx + a.vy * a.vy + vz * vz - g * g
    B = x * a.vx + y * a.vy + z * vz + g * room
    C = min(0.0, x * x + y * y + z * z - room * room)
    root2 = B * B - A * C
    if root2 < 0.0 or (B <= 0.0 and not A > 0.0):
        return np.inf
    root = np.sqrt(root2)
    return float(-C / (B + root) if B > 0.0 else (root - B) / A)
