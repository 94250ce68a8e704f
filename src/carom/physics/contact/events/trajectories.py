"""Trajectories of the bodies through a drift: straight lines whose directions change at impacts.

Under a uniform acceleration g, the true path is a parabola. At the time s of a drift of length dt, the parabola lags
behind the straight line by ½ g s (dt - s), whatever impacts happened before. Stored positions are on the straight
lines. Where bodies meet, `lag` corrects their positions, so the times of impacts in a uniform field are exact. Contacts
at rest hold their bodies with one impulse for the whole drift, so the path of a held body is straight.

Under linear drag with the relaxation time τ, paths are straight in a time σ that slows down with the bodies
(`carom.physics.forces.drag`): σ = τ (1 - e^{-s/τ})/φ₁. At both ends of the drift, σ = s. All times here are σ;
`elapsed` returns s. With the mean velocity w of the drift and the length k of the kick before it,

    dσ/ds = f = 1 - (σ - k)/τ,    v = f w + (σ - k) a,    lag = σ (k φ₁ - φ₁² σ M(φ₁ σ/τ)),    φ₁ = 1/(1 + k/τ)

An impulse J changes w by J/(m f). Without drag, 1/τ is 0, and σ = s.

As long as a body moves by less than its search radius, it can meet only the bodies in its list of neighbours.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.contact.events.event_queue import QueuedRecord
from carom.physics.contact.geometry import normal_and_distance
from carom.physics.contact.guided_walls import straighten_guided
from carom.physics.contact.impact_log import ROUNDING
from carom.physics.contact.loads import pressing
from carom.physics.contact.records import ContactRecord, LoadRecord
from carom.physics.contact.solids import tangent_plane, touches_here
from carom.physics.contact.translating_walls import (
    displacement_in_drift,
    shift_of,
    velocity_in_drift,
    walls_translate,
)
from carom.physics.diagnostics.momentum import centre_velocity
from carom.physics.exponential import log_remainder
from carom.physics.jit.decorators import inline, inner, kernel, long_kernel
from carom.physics.jit.instructions import from_front
from carom.physics.sheared_box import flow_in_drift, is_sheared, nearest_in_drift, velocity_of_image
from carom.physics.vector import Vector, add, along, between, vector
from carom.scene.rest_speed import PER_STEP
from carom.scene.schema import Coefficients

FIRST_STANDOFF = 1e-9  # standoff, in radii, of a body that is exhausted for the first time
# largest number of holds of an exhausted body in a drift; then its standoff exceeds every gap, and it meets no walls
MOST_HOLDS = 100
MAX_SEARCH_RADIUS = 1e150  # m; finite when squared


class TrajectoryRecord(QueuedRecord, Protocol):
    """The path of a body in a drift."""

    now: float  # time of the body's position, in s from the beginning of the drift
    impacts: int  # impacts of the body so far in this drift
    # number of impacts of the next partner when the next impact was predicted; 0 for a solid at rest
    partner_impacts: int
    negligible_speed: float  # m/s; a slower approach is rounding, not an impact
    search_radius: float  # m, displacement, relative to the bulk, within which the body meets only its neighbours
    start_x: float  # m, position at the beginning of the drift, or at the middle of the path; see `narrow`
    start_y: float
    start_z: float
    standoff: float  # m, gap up to which the contacts of an exhausted body are held; see `held_group`
    holds: int  # how often the body's contacts were held in this drift, or since its last release
    released: int  # number of the body's impacts at its last release; 0 before the first release
    releases: int  # how often the body was released in this drift
    later_x: float  # m/s, velocity that the body regains at the end of the drift; meaningful only for an exhausted body
    later_y: float
    later_z: float
    rattles: bool  # whether the body has had so many impacts in this drift that slow impacts no longer rebound
    strays: bool  # whether the path leaves the search radius
    is_straight: bool  # whether the path does not bend with the field, because the body is held or fixed
    is_free: bool  # whether the body has touched nothing since the last step, so that it bounces at any speed
    exhausted: bool  # whether the body has had as many impacts as a drift allows
    is_supported: bool  # whether contacts hold the body, and all of them are with something fixed; see `supports`
    is_lifted: bool  # whether an impact in this drift has lifted the body off its support
    has_landed: bool  # whether the body stays on what it has hit last in this drift, since a field presses it there


TRAJECTORY = dtype_of(TrajectoryRecord)


class SupportRecord(Protocol):
    """What the contacts of a supported body give it in a step; see `supports`."""

    press_x: float  # m/s², acceleration p by their normal impulses in the kick before the drift
    press_y: float
    press_z: float
    rub_x: float  # m/s², acceleration by their friction: f before the first impact, f' afterwards
    rub_y: float
    rub_z: float
    turn_x: float  # rad/s², angular acceleration by their torques: α before the first impact, α' afterwards
    turn_y: float
    turn_z: float
    end: int  # the fixed end of the only contact; -1 if there are several
    arm: float  # m, lever arm of that contact
    rise: float  # s, time in which the contacts could stop the rise of the body by the impacts so far
    is_hit: bool  # whether the body has had an impact in this drift; the fields below have a meaning only then
    cut: float  # s, time from the kick to the first impact, which ends f and α
    lifted: float  # s, time from the kick to the impact that lifted the body off its support; 0 if none did
    slid_x: float  # m/s, change of velocity by f' beyond the kick after the drift
    slid_y: float
    slid_z: float


SUPPORT = dtype_of(SupportRecord)


class DriftRecord(Protocol):
    """The drift of a step."""

    dt: float  # s, length of the drift
    kick: float  # s, length of the kick before the drift: velocities belong to this time in the drift
    damping: float  # 1/s, rate at which drag slows bodies down; 0 without drag
    clock: float  # s, the present time
    slow: float  # fraction of the rest speed below which contacts are left to the end of the step
    bends: bool  # whether the paths of bodies that nothing holds bend with the field
    loading: float  # s, length of the step times `NearPairs.loading`
    field_x: float  # m/s², the uniform field that bends paths; zeros where no path bends
    field_y: float
    field_z: float
    bulk_x: float  # m/s, velocity to which search radii are relative
    bulk_y: float
    bulk_z: float
    queued: int  # number of bodies in the event queue
    strays: int  # number of bodies that left their search radius
    exhausted: int  # number of bodies that had as many impacts as a drift allows
    hit: int  # number of supported bodies that were hit
    restitution: float  # J, losses beyond those of kicks and impacts, by supports of bodies that were hit (`supports`)
    friction: float


DRIFT = dtype_of(DriftRecord)


class Neighbours(NamedTuple):
    """The possible partners of each body; body i has the partners ``bodies[first[i]:last[i]]``."""

    first: IntArray  # (n,)
    last: IntArray  # (n,)
    bodies: IntArray


class Trajectories(NamedTuple):
    """n bodies and p planes in a drift."""

    body: RecordArray[TrajectoryRecord]  # (n,) paths of the bodies
    drift: RecordArray[DriftRecord]  # (1,) state of the drift
    x: FloatArray  # (n, 3) m, position of each body at its time `now`
    v: FloatArray  # (n + p, 3) m/s, velocities along the straight paths
    a: FloatArray  # (n + p, 3) m/s², accelerations without drag
    q: FloatArray  # (n, 4) xyzw, orientations at the end of the drift; (0, 4) where nothing spins
    omega: FloatArray  # (n + p, 3) rad/s, spins; (0, 3) without friction
    inverse_mass: FloatArray  # (n + p,) 1/kg
    inverse_inertia: FloatArray  # (n + p,) 1/(kg m²), inverse moments of inertia
    radius: FloatArray  # (n + p,) m
    load_speed: FloatArray  # (n + p,) m/s, largest acceleration in the body's island times the step
    loads: RecordArray[LoadRecord]  # (n + p,) loads of the held contacts
    support: RecordArray[SupportRecord]  # (n,) meaningful for supported bodies
    box: FloatArray  # (3,) m, size of the periodic box, zeros in open space; or the record of a sheared box
    surface: FloatArray  # (p, 3) normals, or records of solids; see `solids`
    offset: FloatArray  # (p,) m
    materials: RecordArray[Coefficients]  # (k,) `MATERIAL`, by `law.material_index`
    places: IntArray  # (n + p, 2) places for `law.material_index`; empty where all bodies have one material
    queue: IntArray  # (n,) the event queue
    everyone: Neighbours  # all bodies
    strays: Neighbours  # neighbours of the bodies that left their search radius


@kernel
def write_search_radii(
    v: FloatArray,
    mass: FloatArray,
    radius: FloatArray,
    anchored: bool,
    dt: float,
    body: RecordArray[TrajectoryRecord],
    drift: RecordArray[DriftRecord],
) -> float:
    """Write each body's search radius for dt, and the bulk velocity; return the largest search radius, in body radii.

    A search radius is the distance that a body covers at its own speed plus the mean speed of all bodies, relative to
    the centre of mass or to fixed objects. Such a radius suffices after most impacts, and a fast body does not widen
    the radii of other bodies.
    """
    ux, uy, uz = (0.0, 0.0, 0.0) if anchored else centre_velocity(v, mass)
    drift[0].bulk_x, drift[0].bulk_y, drift[0].bulk_z = ux, uy, uz
    mean, largest = 0.0, 0.0
    for i in range(len(body)):
        vx, vy, vz = vector(v, i)
        wx, wy, wz = vx - ux, vy - uy, vz - uz
        speed = np.sqrt(wx * wx + wy * wy + wz * wz)
        body[i].search_radius = speed
        mean += speed / len(body)
    for i in range(len(body)):
        search_radius = min(MAX_SEARCH_RADIUS, dt * (body[i].search_radius + mean))
        body[i].search_radius = search_radius
        largest = max(largest, search_radius / radius[i])
    return largest


@kernel
def begin(T: Trajectories, dt: float, kick: float, damping: float, bends: bool, pressed: BoolArray) -> None:
    """Begin a drift of dt after a kick, both in s; if ``bends``, the field bends the paths of moving bodies.

    ``pressed``, (n + p,), says whether contacts have pressed each body since the last step.
    """
    drift = T.drift[0]
    drift.dt, drift.kick, drift.clock, drift.damping = dt, kick, 0.0, damping
    drift.queued = drift.strays = drift.exhausted = 0
    drift.bends, drift.hit, drift.restitution, drift.friction = bends, 0, 0.0, 0.0
    for i in range(len(T.body)):
        body = T.body[i]
        vx, vy, vz = vector(T.v, i)
        body.start_x, body.start_y, body.start_z = vector(T.x, i)
        body.impact_time, body.impacts, body.queue_place = np.inf, 0, -1
        body.is_straight, body.is_free = not bends or T.inverse_mass[i] == 0.0, not pressed[i]
        body.is_supported = body.is_lifted = body.has_landed = False
        body.negligible_speed = ROUNDING * (abs(vx) + abs(vy) + abs(vz) + T.radius[i] / dt)
        arrive(i, T)


@long_kernel
def narrow(pairs: IntArray, scale: float, skin: float, T: Trajectories, near: IntArray) -> int:
    """Centre search radii on the middle of the paths; copy pairs that may meet to ``near``, and return their number.

    A search radius around the start of a path is up to twice as large as around the middle of the path, and the search
    for neighbours finds all pairs within the largest search radius. In a falling heap, two fifths of the pairs remain.
    Space must not be periodic, and paths must bend with the uniform field alone. ``scale`` and ``skin`` (m) define the
    distance of the search.
    """
    drift, rows = T.drift[0], 0
    half = 0.5 * drift.dt
    for i in range(len(T.body)):
        body = T.body[i]
        vx, vy, vz = vector(T.v, i)
        wx, wy, wz = vx - drift.bulk_x, vy - drift.bulk_y, vz - drift.bulk_z
        body.start_x += half * wx
        body.start_y += half * wy
        body.start_z += half * wz
        body.search_radius -= half * np.sqrt(wx * wx + wy * wy + wz * wz)
    gx, gy, gz = drift.field_x, drift.field_y, drift.field_z
    bends = 2.0 * skin + 0.25 * drift.dt * drift.dt * np.sqrt(gx * gx + gy * gy + gz * gz)  # sagittas of both paths
    for c in range(len(pairs)):
        i, j = from_front(pairs[c, 0]), from_front(pairs[c, 1])
        one, other = T.body[i], T.body[j]
        dx, dy, dz = other.start_x - one.start_x, other.start_y - one.start_y, other.start_z - one.start_z
        limit = (T.radius[i] + T.radius[j] + one.search_radius + other.search_radius) * scale + bends
        if dx * dx + dy * dy + dz * dz <= limit * limit:
            near[rows, 0], near[rows, 1] = i, j
            rows += 1
    return rows


@inner
def arrive(i: int, T: Trajectories) -> None:
    """Begin the path of a body at the present time, without impacts so far."""
    body = T.body[i]
    body.now, body.strays, body.exhausted = T.drift[0].clock, False, False
    body.standoff, body.holds = FIRST_STANDOFF * T.radius[i], 0 if T.inverse_mass[i] > 0.0 else MOST_HOLDS
    body.released, body.releases, body.rattles = 0, 0, False


@inner
def release(i: int, T: Trajectories) -> None:
    """Allow an exhausted body as many further single impacts as before."""
    body = T.body[i]
    body.exhausted, body.released, body.releases = False, body.impacts, body.releases + 1
    body.standoff, body.holds = FIRST_STANDOFF * T.radius[i], 0


@kernel
def straighten(pairs: IntArray, place: IntArray, contacts: RecordArray[ContactRecord], T: Trajectories) -> None:
    """Make straight the paths of bodies held by an impulse in ``contacts[place]``, and mark the bodies as not free."""
    body = T.body
    for c in range(len(place)):
        if contacts[place[c]].normal_impulse > 0.0:
            for end in range(2):
                if pairs[c, end] < len(body):
                    body[pairs[c, end]].is_straight, body[pairs[c, end]].is_free = True, False
                else:
                    straighten_guided(T.surface, pairs[c, end] - len(body))


@inner
def advance(i: int, T: Trajectories) -> None:
    """Move a body along its path to the present time."""
    clock = T.drift[0].clock
    s = clock - T.body[i].now
    vx, vy, vz = vector(T.v, i)
    add(T.x, i, s, vx, vy, vz)
    T.body[i].now = clock


@inner
def elapsed(T: Trajectories) -> float:
    """Return the time in s since the beginning of the drift."""
    drift = T.drift[0]
    if drift.damping == 0.0:
        return float(drift.clock)
    y = drift.damping * drift.clock / (1.0 + drift.damping * drift.kick)
    return float(min(drift.dt, (y + y * y * log_remainder(y)) / drift.damping))


@inner
def slowing(T: Trajectories) -> float:
    """Return the ratio of the present velocities to the velocities of the straight path; 1 without drag."""
    drift = T.drift[0]
    return float(1.0 - drift.damping * (drift.clock - drift.kick))


@inner
def velocity(i: int, T: Trajectories) -> Vector:
    """Return the velocity of a body at the present time, in m/s."""
    f, s = slowing(T), T.drift[0].clock - T.drift[0].kick
    (vx, vy, vz), (ax, ay, az) = vector(T.v, i), vector(T.a, i)
    return f * vx + s * ax, f * vy + s * ay, f * vz + s * az


@inline
def relative_velocity(i: int, j: int, T: Trajectories) -> Vector:
    """Return the velocity of j relative to i at the present time, in m/s; j may be a solid."""
    f, s = slowing(T), T.drift[0].clock - T.drift[0].kick
    (vx, vy, vz), (ax, ay, az) = between(T.v, i, j), between(T.a, i, j)
    vx, vy, vz = f * vx + ax * s, f * vy + ay * s, f * vz + az * s
    if is_sheared(T.box):
        wx, wy, wz = velocity_of_partner(i, j, T)
        return vx + wx, vy + wy, vz + wz
    if walls_translate(T.surface) and j >= len(T.x):  # ``v`` has 0 for walls that translate
        wx, wy, wz = velocity_in_drift(T.surface, j - len(T.x), elapsed(T))
        return vx + wx, vy + wy, vz + wz
    return vx, vy, vz


@inline
def velocity_of_partner(i: int, j: int, T: Trajectories) -> Vector:
    """Return the velocity (m/s), relative to j, of the image of j nearest to i; 0 unless the box is sheared.

    Both bodies must be at their positions at the present time.
    """
    dx, dy, dz = between(T.x, i, j)
    return velocity_of_image(dx, dy, dz, T.box)


@inline
def mean_velocity_of_wall(j: int, T: Trajectories) -> Vector:
    """Return the mean velocity of a solid from the present time to the end of the drift, in m/s."""
    drift, solid = T.drift[0], j - len(T.x)
    remaining = drift.dt - drift.clock
    if not (walls_translate(T.surface) and remaining > 0.0):
        return 0.0, 0.0, 0.0
    x, y, z = displacement_in_drift(T.surface, solid, drift.clock)
    ex, ey, ez = displacement_in_drift(T.surface, solid, drift.dt)
    return (ex - x) / remaining, (ey - y) / remaining, (ez - z) / remaining


@inner
def lag(T: Trajectories) -> float:
    """Return the lag of a path behind its straight line at the present time, per unit of the field, in s²."""
    drift = T.drift[0]
    if drift.damping == 0.0:
        return float(0.5 * drift.clock * (drift.dt - drift.clock))
    phi1 = 1.0 / (1.0 + drift.damping * drift.kick)
    done = phi1 * drift.clock
    return float(drift.clock * phi1 * (drift.kick - done * log_remainder(drift.damping * done)))


@inner
def centre(i: int, T: Trajectories) -> Vector:
    """Return the position (m) of a body on its parabola at the present time."""
    x, y, z = vector(T.x, i)
    if T.body[i].is_straight:
        return x, y, z
    drift, behind = T.drift[0], lag(T)
    return x - behind * drift.field_x, y - behind * drift.field_y, z - behind * drift.field_z


@inner
def shift_to_parabola(i: int, sign: float, T: Trajectories) -> None:
    """Let a body at its present place continue on a parabola in place of a straight line; with -1, the reverse.

    The straight line is displaced, and with it the end of the path. What the body loses there in the field is booked
    as a loss by restitution.
    """
    drift, (ax, ay, az) = T.drift[0], vector(T.a, i)
    below = sign * lag(T)
    add(T.x, i, below, drift.field_x, drift.field_y, drift.field_z)
    drift.restitution += below * (ax * drift.field_x + ay * drift.field_y + az * drift.field_z) / T.inverse_mass[i]


@inner
def straighten_path(i: int, T: Trajectories) -> None:
    """Make the rest of a body's path straight, as `hold_group` requires.

    Only the path of a body that an impact has lifted off its support is displaced, back to where it was. Rejected: the
    paths of all bodies. A column of balls then gains a height of up to g dt²/8 whenever it is held, and needs three
    times as many impacts to come to rest.
    """
    body = T.body[i]
    if body.is_lifted and not body.is_straight:
        shift_to_parabola(i, -1.0, T)
    body.is_straight = True


@inner
def rest_speed(i: int, j: int, normal: Vector, T: Trajectories) -> float:
    """Return the largest closing speed (m/s) of a contact at rest: 0 if its bodies have touched nothing."""
    most = 0.0 if T.body[i].is_free else T.load_speed[i]
    if j < len(T.x) and not T.body[j].is_free:
        most = max(most, T.load_speed[j])
    if most == 0.0 or T.body[i].rattles or (j < len(T.x) and T.body[j].rattles):
        return most
    return float(min(most, PER_STEP * T.drift[0].loading * pressing(i, j, normal, T.a, T.loads)))


@inner
def contact_geometry(i: int, j: int, T: Trajectories) -> tuple[float, float, float, float, float]:
    """Return the normal from i to j, and both lever arms in m; see `geometry.update_geometry`.

    At a plane, the arm is the height of the centre, which equals the radius when the body meets it.
    """
    n = len(T.x)
    if j >= n:
        x, y, z = centre(i, T)
        if walls_translate(T.surface):
            rx, ry, rz = displacement_in_drift(T.surface, j - n, elapsed(T))
            x, y, z = x - rx, y - ry, z - rz
        nx, ny, nz, offset = tangent_plane(T.surface, T.offset, j - n, x, y, z)
        return -nx, -ny, -nz, max(0.0, -offset + nx * x + ny * y + nz * z), 0.0
    dx, dy, dz = between(T.x, i, j)
    if T.body[i].is_straight != T.body[j].is_straight:
        drift = T.drift[0]
        behind = lag(T) if T.body[i].is_straight else -lag(T)
        dx, dy, dz = dx - behind * drift.field_x, dy - behind * drift.field_y, dz - behind * drift.field_z
    dx, dy, dz = nearest_in_drift(dx, dy, dz, T.box, T.drift[0].clock)
    nx, ny, nz, d = normal_and_distance(dx, dy, dz)
    ratio = d / (T.radius[i] + T.radius[j])
    return nx, ny, nz, ratio * T.radius[i], ratio * T.radius[j]


@inner
def place_at_wall(i: int, solid: int, T: Trajectories) -> Vector:
    """Return the centre (m) of a body in the frame in which a moving wall stays where the scene puts it."""
    x, y, z = centre(i, T)
    if walls_translate(T.surface):
        rx, ry, rz = displacement_in_drift(T.surface, solid, elapsed(T))
        sx, sy, sz = shift_of(T.surface, solid)
        x, y, z = x - rx - sx, y - ry - sy, z - rz - sz
    return x, y, z


@inner
def touches_in_drift(i: int, facet: int, T: Trajectories) -> bool:
    """Return `touches_here` of a body at the present time of a drift."""
    x, y, z = centre(i, T)
    if walls_translate(T.surface):
        rx, ry, rz = displacement_in_drift(T.surface, facet, elapsed(T))
        x, y, z = x - rx, y - ry, z - rz
    return touches_here(T.surface, facet, x, y, z)


@inner
def leaves_search_radius(i: int, T: Trajectories) -> bool:
    """Return whether a body leaves its search radius before the end of the drift."""
    body, drift = T.body[i], T.drift[0]
    x, y, z = along(T.x, T.v, i, drift.dt - body.now)
    x = x - drift.bulk_x * drift.dt - body.start_x
    y = y - drift.bulk_y * drift.dt - body.start_y
    z = z - drift.bulk_z * drift.dt - body.start_z
    if is_sheared(T.box):  # search radii are relative to the local flow
        ux, uy, uz = flow_in_drift(T.box, body.start_x, body.start_y, body.start_z, drift.dt)
        x, y, z = x - ux, y - uy, z - uz
    return bool(x * x + y * y + z * z > body.search_radius * body.search_radius)


@long_kernel
def finish(lo: int, hi: int, T: Trajectories) -> None:
    """Move bodies [lo, hi) to the end of the drift, where exhausted bodies regain velocities that `hold_group` kept."""
    dt = T.drift[0].dt
    for i in range(lo, hi):
        body = T.body[i]
        vx, vy, vz = vector(T.v, i)
        add(T.x, i, dt - body.now, vx, vy, vz)
        if body.exhausted:
            add(T.v, i, 1.0, body.later_x, body.later_y, body.later_z)


@kernel
def both_ways(pairs: IntArray, ends: IntArray, others: IntArray) -> None:
    """List the neighbours of each body; body i has the neighbours ``others[ends[i]:ends[i + 1]]``."""
    for c in range(len(pairs)):
        ends[pairs[c, 0]] += 1
        ends[pairs[c, 1]] += 1
    for i in range(1, len(ends)):
        ends[i] += ends[i - 1]
    for c in range(len(pairs)):
        for end in range(2):
            i = pairs[c, end]
            ends[i] -= 1
            others[ends[i]] = pairs[c, 1 - end]
