"""Dense random packings: spheres start small, fly, bounce and grow to their full size.

Random addition jams at a packing fraction of 0.38. Here spheres start at random positions, small enough for a packing
fraction of 0.2. They then grow at one relative rate while they fly straight and bounce elastically off each other, the
border of the region, planes, and bodies that were placed earlier (Lubachevsky & Stillinger 1990, J. Stat. Phys. 60,
561). The more often they bounce, the more slowly they grow: with 1 radius/s throughout, they would jam below 0.6. Equal
spheres never reach random close packing, 0.64.

If the sum of radii is D (1 + k s), the time s of impact of two spheres follows from the formula for constant radii:

    |x + v s| = D (1 + k s)   ⟺   |x + (v - k x) σ| = D,   s = σ / (1 - k σ)

A sphere inside a ball or a cylinder about the origin, whose centre can move up to E - g s away from the origin or the
axis, meets the wall when

    |x + v s| = E - g s   ⟺   (v² - g²) s² + 2 (x·v + g E) s + x² - E² = 0

Surfaces rebound at their closing speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, Records, dtype_of
from carom.errors import SceneError
from carom.physics.contact.broad_phase.grid import HierarchicalGrid
from carom.physics.contact.events.event_queue import put
from carom.physics.contact.events.time_of_impact import time_of_impact
from carom.physics.contact.events.trajectories import both_ways
from carom.physics.jit.decorators import inner, long_kernel
from carom.physics.placement.neighbours import Surroundings
from carom.physics.placement.random_placement import positions
from carom.physics.placement.region import Arrangement, half_extent, packing_fraction, refuse_too_large
from carom.physics.vector import Vector, minimum_images, nearest_image
from carom.scene.portable_math import cube_root
from carom.scene.schema import BodyGroup, Region
from carom.scene.units.system import UnitSystem

DENSEST = 0.62  # largest packing fraction: equal spheres jam at 0.634 to 0.64, and growth takes very long just below
BY_SPREAD, BY_SKEWNESS = 0.0658, 0.0857  # coefficients, see `densest`
LOOSE = 0.2  # packing fraction of the random start
INFLATED = 1e-6  # excess growth, in radii, so that rounding causes no overlap
SKIN = 0.3  # distance, in radii, that a sphere may move until neighbours are searched again
PASS = 0.1  # s, longest time until speeds are reset to 1 radius/s per axis
FASTEST, SLOWEST = 1.0, 1e-3  # 1/s, rates of growth
EASE = 10.0  # 1/s², rate of growth times the number of impacts per second and sphere
MOST_IMPACTS = 5000  # mean number of impacts per sphere above which spheres have jammed
MOST_AT_ONCE = 30  # mean number of impacts per sphere in a pass


def densest(radius: FloatArray) -> float:
    """Return the largest packing fraction to which spheres of these radii, (n,), can be compressed.

    In simulations, the random close packing of spheres of several sizes is

        0.634 + 0.0658 δ + 0.0857 S δ²

    where δ is the standard deviation of the radii divided by their mean, and S is their skewness (Desmond & Weeks 2014,
    Phys. Rev. E 90, 022204). For equal spheres, `DENSEST` is used instead of 0.634.
    """
    mean = float(radius.mean())
    apart = radius / mean - 1.0
    spread = math.sqrt(float(np.mean(apart * apart)))
    third = float(np.mean(apart * apart * apart))  # S δ³
    return DENSEST + max(0.0, BY_SPREAD * spread + (BY_SKEWNESS * third / spread if spread > 0.0 else 0.0))


def _arrange(
    mixture: Mapping[int, BodyGroup],
    region: Region,
    radius: FloatArray,
    around: Surroundings,
    rng: np.random.Generator,
    units: UnitSystem,
) -> FloatArray:
    """Implement `Arrange`; SceneError if the spheres jam before they reach their full size."""
    index = next(iter(mixture))
    refuse_too_large(index, region, radius, units)
    size = min(1.0, float(cube_root(np.array(LOOSE / sum(map(packing_fraction, mixture.values()))))))
    position = positions(mixture, region, radius * size, around, rng, units, dense=True)
    n, centre = len(radius), np.array(region.centre)
    box = np.zeros(3) if around.box is None else around.box
    # the spheres near the region that are already placed
    centres = np.concatenate([np.empty((0, 3)), *(centres for centres, _ in around.spheres)])
    radii = np.concatenate([np.empty(0), *(radii for _, radii in around.spheres)])
    apart = minimum_images(centres - centre, box)
    near = (np.abs(apart) <= half_extent(region) + radii[:, None]).all(axis=1)
    fixed, fixed_radius = centres[near], radii[near]
    sphere = np.zeros(n + len(fixed), SPHERE)
    for k, axis in enumerate("xyz"):
        sphere[axis] = np.concatenate((position[:, k], fixed[:, k])) - centre[k]
        sphere[f"v{axis}"][:n] = radius * (2.0 * rng.random(n) - 1.0)
    sphere["radius"][n:] = fixed_radius
    sphere["skin"][:n] = SKIN * radius
    sphere["inverse_mass"][:n] = radius * radius  # speeds in radii per second are then equal
    border, queue = _borders(region, around), np.empty(n, dtype=np.int64)
    full, widest = 1.0 + INFLATED, float(max(radius.max(), fixed_radius.max(initial=0.0)))
    images = 1 if around.box is not None and box.min() < 4.0 * widest + 8.0 * SKIN * radius.max() else 0
    impacts, rate = 0, FASTEST
    while size < full:
        left = (full - size) / rate
        span = min(PASS, left)
        own = sphere[:n]
        own["radius"], own["growth"] = size * radius, rate * radius
        # scale velocities to a root mean square of 1 radius/s per axis
        square = sum((own[f"v{axis}"] / radius) ** 2 for axis in "xyz")
        scale = math.sqrt(3.0 * n / float(np.sum(square)))
        for axis in "xyz":
            own[f"v{axis}"] *= scale
        # list the neighbours of each sphere; sphere i has ``others[ends[i]:ends[i + 1]]``
        reach = sphere["radius"] + span * sphere["growth"] + sphere["skin"]
        pairs = HierarchicalGrid(reach, box).pairs(np.stack([sphere[axis] for axis in "xyz"], axis=1))
        pairs = pairs[pairs[:, 0] < n]
        ends, others = np.zeros(len(sphere) + 1, dtype=np.int64), np.empty(2 * len(pairs), dtype=np.int64)
        both_ways(pairs, ends, others)
        flown, count = fly(sphere, n, queue, FlightSpace(border, ends, others, box, images), span, MOST_AT_ONCE * n)
        size = full if flown == left else size + rate * flown
        impacts += count
        rate = min(FASTEST, max(SLOWEST, EASE * n * flown / max(1, 2 * count)))
        if 2 * impacts > MOST_IMPACTS * n:
            raise SceneError(
                f"group.{index}: spheres jam at {size:.3g} of their radius; "
                "enlarge the region or lower count or radius",
                ("group", index, "region"),
            )
    return np.asarray(np.stack([sphere[axis][:n] for axis in "xyz"], axis=1) + centre)


COMPRESSED = Arrangement(_arrange, densest, "these radii can be compressed to")


def _borders(region: Region, around: Surroundings) -> Records:
    """Return the borders of a region and the planes, relative to its centre."""
    half, (cx, cy, cz) = half_extent(region), region.centre
    flat = [
        (True, nx, ny, nz, o - (nx * cx + ny * cy + nz * cz), 0.0, False, False)
        for (nx, ny, nz), o in zip(around.solids.normal, around.solids.offset, strict=True)
    ]
    round_ = []
    if region.shape in ("box", "cylinder"):
        is_whole = around.box is not None and region.shape == "box" and bool(np.all(2.0 * half >= around.box))
        for k in () if is_whole else range(3) if region.shape == "box" else (2,):
            for side in (-1.0, 1.0):
                flat.append((True, *(side * (axis == k) for axis in range(3)), -half[k], 0.0, False, False))
    if region.shape != "box":
        round_.append((False, 0.0, 0.0, 0.0, 0.0, half[0], True, region.shape == "cylinder"))
    if region.inner_radius is not None:
        round_.append((False, 0.0, 0.0, 0.0, 0.0, region.inner_radius, False, False))
    return np.array(flat + round_, BORDER)


class GrowingSphereRecord(Protocol):
    """A sphere in a flight."""

    x: float  # m, position at the time `now`
    y: float
    z: float
    vx: float  # m/s
    vy: float
    vz: float
    radius: float  # m, radius at the beginning of the flight
    growth: float  # m/s, growth of the radius; 0 for fixed spheres
    inverse_mass: float  # inverse mass in any unit; 0 for fixed spheres
    skin: float  # m, distance that the sphere may move until neighbours are searched again
    start_x: float  # m, position at the beginning of the flight
    start_y: float
    start_z: float
    now: float  # s, time of the position since the beginning of the flight
    impacts: int  # impacts of the sphere so far in this flight
    impact_time: float  # s, time of the next impact; infinite if there is none
    partner: int  # other end of the next impact: sphere j, or the number of spheres + k for border k
    partner_impacts: int  # number of the partner's impacts when the next impact was predicted
    queue_place: int  # see `put`


SPHERE = dtype_of(GrowingSphereRecord)


class BorderRecord(Protocol):
    """A border of the region."""

    flat: bool  # whether the border is a plane; spheres have `normal · x > offset`
    nx: float
    ny: float
    nz: float
    offset: float  # m
    radius: float  # m, radius of a round border about the origin
    around: bool  # whether spheres are inside the border; otherwise they are outside
    upright: bool  # whether the border is a cylinder along z; otherwise a ball


BORDER = dtype_of(BorderRecord)


class FlightSpace(NamedTuple):
    """All objects that spheres can meet in a flight."""

    border: RecordArray[BorderRecord]  # (b,)
    ends: IntArray  # (n + 1,) the neighbours of sphere i are ``others[ends[i]:ends[i + 1]]``
    others: IntArray
    box: FloatArray  # (3,) m, size of the periodic box; zeros in open space
    images: int  # number of further images on either side that a body can meet, in a box of a few radii


@long_kernel
def fly(
    sphere: RecordArray[GrowingSphereRecord], movers: int, queue: IntArray, space: FlightSpace, span: float, most: int
) -> tuple[float, int]:
    """Fly until a sphere has left its skin, for at most a time span (s) or number of impacts; return time and impacts.

    Spheres from ``movers`` on are fixed; ``queue`` is a buffer, (movers,).
    """
    size, impacts, border, box = 0, 0, space.border, space.box
    for i in range(len(sphere)):
        a = sphere[i]
        a.start_x, a.start_y, a.start_z = a.x, a.y, a.z
        a.now, a.impacts, a.impact_time, a.queue_place = 0.0, 0, np.inf, -1
        if i < movers:
            span = min(span, _time_in_skin(a))
    for i in range(movers):
        _predict(i, 0.0, span, sphere, space)
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
                _predict(j, now, span, sphere, space)
                size = put(j, size, queue, sphere)
        _predict(i, now, span, sphere, space)
        size = put(i, size, queue, sphere)
        if impacts == most:
            span = now
    for i in range(movers):
        _advance(sphere[i], span)
    return span, impacts


@inner
def _advance(a: GrowingSphereRecord, now: float) -> None:
    s = now - a.now
    a.x, a.y, a.z, a.now = a.x + a.vx * s, a.y + a.vy * s, a.z + a.vz * s, now


@inner
def _time_in_skin(a: GrowingSphereRecord) -> float:
    """Return the time (s) after which a sphere leaves its skin."""
    ox, oy, oz = a.x - a.start_x, a.y - a.start_y, a.z - a.start_z
    v2 = a.vx * a.vx + a.vy * a.vy + a.vz * a.vz
    ov = ox * a.vx + oy * a.vy + oz * a.vz
    left = max(0.0, a.skin * a.skin - (ox * ox + oy * oy + oz * oz))
    return float((np.sqrt(ov * ov + v2 * left) - ov) / v2) if v2 > 0.0 else np.inf


@inner
def _bounce(a: GrowingSphereRecord, b: GrowingSphereRecord, box: FloatArray) -> None:
    """Let two spheres rebound; a fixed sphere has inverse mass 0."""
    nx, ny, nz = b.x - a.x, b.y - a.y, b.z - a.z
    nx, ny, nz = nearest_image(nx, ny, nz, box)
    d2 = nx * nx + ny * ny + nz * nz
    closing = (a.growth + b.growth) * np.sqrt(d2) - ((b.vx - a.vx) * nx + (b.vy - a.vy) * ny + (b.vz - a.vz) * nz)
    J = 2.0 * closing / (d2 * (a.inverse_mass + b.inverse_mass))
    p, q = J * a.inverse_mass, J * b.inverse_mass
    a.vx, a.vy, a.vz = a.vx - p * nx, a.vy - p * ny, a.vz - p * nz
    b.vx, b.vy, b.vz = b.vx + q * nx, b.vy + q * ny, b.vz + q * nz
    a.impacts += 1
    b.impacts += 1


@inner
def _bounce_off(a: GrowingSphereRecord, wall: BorderRecord) -> None:
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
def _predict(i: int, now: float, span: float, sphere: RecordArray[GrowingSphereRecord], space: FlightSpace) -> None:
    border, ends, others, box, images = space
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
        dx, dy, dz = nearest_image(dx, dy, dz, box)
        D, growth = r + b.radius + b.growth * now, a.growth + b.growth
        v = b.vx - a.vx, b.vy - a.vy, b.vz - a.vz
        for ix in range(-images, images + 1):
            for iy in range(-images, images + 1):
                for iz in range(-images, images + 1):
                    d = dx + ix * box[0], dy + iy * box[1], dz + iz * box[2]
                    when = now + _time_to_sphere(d, v, D, growth, left)
                    if when < first:
                        first, a.partner, a.partner_impacts = when, others[m], b.impacts
    a.impact_time = first


@inner
def _time_to_sphere(d: Vector, v: Vector, D: float, growth: float, left: float) -> float:
    """Return the time (s) after which two spheres meet; infinite if it is longer than the time left."""
    (dx, dy, dz), (vx, vy, vz) = d, v
    k = growth / D
    w = vx - k * dx, vy - k * dy, vz - k * dz
    sigma = time_of_impact(d, w, (0.0, 0.0, 0.0), D, left / (1.0 + k * left), 0.0, 0.0)
    return float(sigma / (1.0 - k * sigma)) if sigma < np.inf else np.inf


@inner
def _time_to_border(
    x: float, y: float, z: float, r: float, a: GrowingSphereRecord, wall: BorderRecord, left: float
) -> float:
    """Return the time (s) after which a sphere of radius r at (x, y, z) meets a border; infinite if it never does."""
    g = a.growth
    if wall.flat:
        closing = g - (a.vx * wall.nx + a.vy * wall.ny + a.vz * wall.nz)
        gap = x * wall.nx + y * wall.ny + z * wall.nz - wall.offset - r
        return float(max(0.0, gap) / closing) if closing > 0.0 else np.inf
    vz = a.vz
    if wall.upright:
        z, vz = 0.0, 0.0
    if not wall.around:
        return _time_to_sphere((x, y, z), (a.vx, a.vy, vz), wall.radius + r, g, left)
    space = max(0.0, wall.radius - r)
    A = a.vx * a.vx + a.vy * a.vy + vz * vz - g * g
    B = x * a.vx + y * a.vy + z * vz + g * space
    C = min(0.0, x * x + y * y + z * z - space * space)
    root2 = B * B - A * C
    if root2 < 0.0 or (B <= 0.0 and not A > 0.0):
        return np.inf
    root = np.sqrt(root2)
    return float(-C / (B + root) if B > 0.0 else (root - B) / A)
