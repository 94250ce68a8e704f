"""The event loop: impacts within a drift at their exact times, in the order of time.

Each body stores its next impact. The earliest impact is resolved with the velocities at its time. The next impacts of
both bodies are predicted along their new paths, and the loop continues. If the partner of a body has had another impact
in the meantime, the body's impact is predicted again.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.contact.events.collision import collide
from carom.physics.contact.events.event_queue import put
from carom.physics.contact.events.held_group import hold_group
from carom.physics.contact.events.nearest_velocities import MOST_CONTACTS, Group
from carom.physics.contact.events.time_of_impact import (
    first_of_images,
    stay_apart,
    time_of_impact,
    time_of_impact_in_box,
    time_of_impact_on_parabola,
    time_to_plane_in_medium,
)
from carom.physics.contact.events.trajectories import (
    MOST_HOLDS,
    Neighbours,
    Trajectories,
    advance,
    elapsed,
    lag,
    leaves_search_radius,
    rest_speed,
    slowing,
    straighten_path,
)
from carom.physics.contact.events.wall_impacts import predict_with_walls
from carom.physics.contact.geometry import normal_and_distance
from carom.physics.contact.guided_walls import impacts_of_wall
from carom.physics.contact.impact_log import MANY_IMPACTS, MAX_IN_COLLAPSE, ROUNDING
from carom.physics.contact.law import (
    dissipates,
    material_index,
)
from carom.physics.contact.records import ImpactRecord
from carom.physics.exponential import exponentials
from carom.physics.jit.decorators import inline, inner, long_kernel, with_field
from carom.physics.jit.instructions import from_front
from carom.physics.sheared_box import is_sheared, periods
from carom.physics.vector import Vector, along, between, is_periodic, nearest_image, vector

# Fraction of the rest speed above which a contact is resolved where it touches. Rebounds begin at the rest speed.
# With 1, dropped stacks of 500 balls overlap by 0.18 r instead of 0.06 r, and marbles-in-a-box by 5 mm instead of 1 mm.
# Rejected: for held bodies, comparing the velocity with which they move in the drift with the rest speed. With a
# fraction of 0.05, stack-dropped gains 5 % of its energy instead of 8 %, and overlaps are a third as deep, but
# marbles-in-a-box and drum take 1.5 times as long, and hopper twice as long. With 0.01, the gain is 1 %, and
# marbles-in-a-box takes six times as long.
SLOW = 0.25
# Fraction of the rest speed above which a contact is resolved where it touches, in scenes without fixed bodies. With
# 0.25, rubble-collision has 2.7 times as many impacts and takes 1.3 times as long; the deepest overlap is 5 × 10⁻⁴ r
# instead of 1.4 × 10⁻³ r.
SLOW_IN_SPACE = 1.0
# Fraction of a periodic box that a relative motion may cover in a drift if only the nearest image is tested. This is
# half the way to the next image, which is at least half a box farther away.
IMAGE_SHARE = 0.25

# Number of impacts of a body in a drift after which its contacts are held (`MAX_IN_COLLAPSE` with e < 1, where no force
# presses). A collapse has infinitely many impacts in a finite time. Where a force presses, a light ball can stop a ball
# of 300 times its mass within this number of impacts. Without dissipation, the number is always finite: about π √(M/m)
# if a heavy ball presses a light ball against a wall (Galperin 2003), which is 10⁵ for a mass ratio of 10⁹. The records
# of so many impacts take 20 MB.
MAX_IMPACTS = 1000
MAX_ELASTIC = 100_000


@long_kernel
def predict(lo: int, hi: int, neighbours: Neighbours, T: Trajectories) -> None:
    """Predict the first impact of each body in [lo, hi) with planes and its neighbours."""
    _predict_with_solids(lo, hi, T, T.surface)
    _predict(lo, hi, neighbours, T)


@long_kernel
def resolve(neighbours: Neighbours, T: Trajectories, log: RecordArray[ImpactRecord], group: Group | None) -> int:
    """Resolve impacts until none is left or the log, (k,) `IMPACT`, is full; return their number.

    ``group`` is workspace for held contacts. With None, the loop ends where a body is exhausted. Without `hold_group`,
    the kernel compiles in half the time. Few scenes hold contacts in a drift.
    """
    n, row = len(T.x), 0
    while row + MOST_CONTACTS <= len(log):
        known = _go_to_next(neighbours, T)
        if known < 0:
            return row
        partner = T.body[known].partner
        i, j = min(known, partner), max(known, partner)
        lossy = dissipates(T.materials[material_index(i, j, n, T.places)])
        if T.body[i].exhausted or (j < n and T.body[j].exhausted):
            if group is None:
                return row
            count, row = hold_group(i, j, neighbours, T, log, row, group)
            for k in range(count):
                _count_impact(group.changed[k], lossy, T)
            for k in range(count):
                _predict_again(group.changed[k], neighbours, T)
            continue
        collide(i, j, log, row, T)
        row += 1
        _count_impact(known, lossy, T)
        _count_impact(partner, lossy, T)
        if T.inverse_mass[known] > 0.0:
            _predict_again(known, neighbours, T)
        if partner < n and T.inverse_mass[partner] > 0.0:
            _predict_again(partner, neighbours, T)
    return row


@inner
def _go_to_next(neighbours: Neighbours, T: Trajectories) -> int:
    """Move two bodies to the next impact; return the body that had predicted it, or -1 if no impact follows.

    A prediction is stale if the partner has had another impact since. In the case of a guided wall, the impact then
    comes later (`guided_walls`).
    """
    n, drift = len(T.x), T.drift[0]
    while drift.queued > 0:
        i = int(T.queue[0])
        body = T.body[i]
        j = body.partner
        drift.clock = body.impact_time
        if body.partner_impacts == (T.body[j].impacts if j < n else impacts_of_wall(T.surface, j - n)):
            advance(i, T)
            if j < n:
                advance(j, T)
            return i
        _predict_again(i, neighbours, T)
    return -1


@inner
def _count_impact(i: int, lossy: bool, T: Trajectories) -> None:
    """Count an impact of a body; record whether it is now exhausted, and whether its path leaves its search radius."""
    if i >= len(T.x) or T.inverse_mass[i] == 0.0:
        return
    body, drift = T.body[i], T.drift[0]
    body.is_free = False
    vx, vy, vz = vector(T.v, i)
    body.negligible_speed = max(body.negligible_speed, ROUNDING * (abs(vx) + abs(vy) + abs(vz)))
    body.impacts += 1
    collapses = lossy and T.load_speed[i] == 0.0
    most = MAX_IN_COLLAPSE if collapses else (MAX_IMPACTS if lossy else MAX_ELASTIC)
    body.rattles = body.rattles or (lossy and body.impacts >= MANY_IMPACTS)
    if body.impacts - body.released >= most and not body.exhausted:
        straighten_path(i, T)
        body.exhausted = True
        body.later_x = body.later_y = body.later_z = 0.0
        drift.exhausted += 0 if collapses else 1
    if not body.strays and leaves_search_radius(i, T):
        body.strays = True
        T.strays.bodies[drift.strays] = i
        drift.strays += 1
        T.strays.last[:] = drift.strays


@inner
def _predict_again(i: int, neighbours: Neighbours, T: Trajectories) -> None:
    """Predict a body's next impact on its remaining path, and update the event queue."""
    body, drift = T.body[i], T.drift[0]
    body.impact_time = np.inf
    _predict_with_solids(i, i + 1, T, T.surface)
    if body.strays:
        _predict(i, i + 1, T.everyone, T)
    else:
        _predict(i, i + 1, neighbours, T)
        if drift.strays > 0:
            _predict(i, i + 1, T.strays, T)
    drift.queued = put(i, drift.queued, T.queue, T.body)


@inner
def _predict(lo: int, hi: int, neighbours: Neighbours, T: Trajectories) -> None:
    """Predict the next impact of each body in [lo, hi) with neighbours; store it if it precedes the stored impact."""
    box, drift = periods(T.box), T.drift[0]
    clock = drift.clock
    span, since_kick = drift.dt - clock, clock - drift.kick
    far = not is_periodic(box)  # in a periodic box, other images may be near
    height = np.inf  # m, largest distance between a parabola and its straight line
    if drift.damping == 0.0:
        gx, gy, gz = drift.field_x, drift.field_y, drift.field_z
        height = 0.125 * drift.dt * drift.dt * np.sqrt(gx * gx + gy * gy + gz * gz)
    for i in range(lo, hi):
        one = T.body[i]
        xi, yi, zi = along(T.x, T.v, i, clock - one.now)
        for m in range(neighbours.first[i], neighbours.last[i]):
            j = from_front(neighbours.bodies[m])
            other = T.body[j]
            xj, yj, zj = along(T.x, T.v, j, clock - other.now)
            d, v = (xj - xi, yj - yi, zj - zi), between(T.v, i, j)
            R = T.radius[i] + T.radius[j]
            if far and stay_apart(d, v, R if one.is_straight == other.is_straight else R + height, span):
                continue
            if j == i or T.inverse_mass[i] + T.inverse_mass[j] == 0.0:
                continue
            if one.holds >= MOST_HOLDS and other.holds >= MOST_HOLDS:
                continue
            a = _acceleration(i, j, v, T)
            slow = one.negligible_speed + other.negligible_speed
            if not (one.is_free and other.is_free) and T.load_speed[i] + T.load_speed[j] > 0.0:
                slow += drift.slow * rest_speed(i, j, _direction(d, box), T)
            # on a parabola only the nearest image is tested, so a body must not come halfway to another image
            if is_sheared(T.box):
                tau = first_of_images(d, v, a, R, slow, (span, since_kick, clock), T.box)
            elif one.is_straight != other.is_straight and not (is_periodic(box) and _passes_images(v, span, box)):
                tau = _time_on_parabola(i, j, nearest_image(d[0], d[1], d[2], box), v, slow, T)
            elif is_periodic(box):
                tau = time_of_impact_in_box(d, v, a, R, span, since_kick, slow, box)
            else:
                tau = time_of_impact(d, v, a, R, span, since_kick, slow)
            when = clock + tau
            if when < one.impact_time or (when == one.impact_time < np.inf and j < one.partner):
                one.impact_time, one.partner, one.partner_impacts = when, j, other.impacts


@inline
def _direction(d: Vector, box: Vector) -> Vector:
    """Return the direction of a separation, to the nearest image."""
    dx, dy, dz = nearest_image(d[0], d[1], d[2], box)
    nx, ny, nz, _ = normal_and_distance(dx, dy, dz)
    return nx, ny, nz


@inline
def _passes_images(v: Vector, span: float, box: Vector) -> bool:
    """Return whether a body moves by `IMAGE_SHARE` of the periodic box along an axis."""
    (vx, vy, vz), (Lx, Ly, Lz) = v, box
    along_x, along_y, along_z = abs(vx) * span, abs(vy) * span, abs(vz) * span
    return bool(along_x > IMAGE_SHARE * Lx or along_y > IMAGE_SHARE * Ly or along_z > IMAGE_SHARE * Lz)


@inner
def _acceleration(i: int, j: int, v: Vector, T: Trajectories) -> Vector:
    """Return the acceleration of j relative to i, with drag, in m/s²; ``v`` is their relative velocity in the drift."""
    (vx, vy, vz), (ax, ay, az) = v, between(T.a, i, j)
    damping = T.drift[0].damping
    return ax - damping * vx, ay - damping * vy, az - damping * vz


@inner
def _time_on_parabola(i: int, j: int, d: Vector, v: Vector, slow: float, T: Trajectories) -> float:
    """Return the time (s) until two bodies meet, if the field bends one path; infinite if they miss each other.

    ``d`` (m) and ``v`` (m/s) are the separation and the velocity of j relative to i on their straight lines, and
    ``slow`` (m/s) is the largest closing speed that is not an impact.
    """
    drift = T.drift[0]
    sign, behind, since_kick = -1.0 if T.body[j].is_straight else 1.0, lag(T), drift.clock - drift.kick
    (dx, dy, dz), (vx, vy, vz) = d, v
    bx, by, bz = sign * drift.field_x, sign * drift.field_y, sign * drift.field_z
    dx, dy, dz = dx - behind * bx, dy - behind * by, dz - behind * bz
    f = slowing(T)
    wx, wy, wz = f * vx + since_kick * bx, f * vy + since_kick * by, f * vz + since_kick * bz
    R, span = T.radius[i] + T.radius[j], drift.dt - elapsed(T)
    t = time_of_impact_on_parabola((dx, dy, dz), (wx, wy, wz), (bx, by, bz), drift.damping, R, span)
    if t == np.inf:
        return t
    phi1, phi2 = 1.0, 0.5
    if drift.damping > 0.0:
        _, phi1, phi2 = exponentials(drift.damping * t)
    nx, ny = dx + t * (phi1 * wx + phi2 * t * bx), dy + t * (phi1 * wy + phi2 * t * by)
    nz = dz + t * (phi1 * wz + phi2 * t * bz)
    ax, ay, az = _acceleration(i, j, v, T)
    tau = min(drift.dt - drift.clock, f * phi1 * t)
    s = since_kick + tau
    closing = -((vx + ax * s) * nx + (vy + ay * s) * ny + (vz + az * s) * nz)
    return tau if closing > slow * np.sqrt(nx * nx + ny * ny + nz * nz) else np.inf


@with_field("kind", predict_with_walls, place=3)
def _predict_with_solids(lo: int, hi: int, T: Trajectories, N: FloatArray) -> None:
    """Predict the next impact of each body in [lo, hi) with a solid; store it if it precedes the stored impact."""
    x, v, a, offset = T.x, T.v, T.a, T.offset
    if len(offset) == 0:
        return
    drift, behind, f = T.drift[0], lag(T), slowing(T)
    clock, dt, kick, damping = drift.clock, drift.dt, drift.kick, drift.damping
    span = dt - elapsed(T)
    for i in range(lo, hi):
        body = T.body[i]
        if body.holds >= MOST_HOLDS:
            continue
        s = clock - body.now
        for p in range(len(offset)):
            gap, rate, acceleration = -offset[p] - T.radius[i], 0.0, 0.0
            for k in range(3):
                gap += N[p, k] * (x[i, k] + v[i, k] * s)
                rate += N[p, k] * v[i, k]
                acceleration += N[p, k] * a[i, k]
            bend = 0.0
            if not body.is_straight:
                bend = N[p, 0] * drift.field_x + N[p, 1] * drift.field_y + N[p, 2] * drift.field_z
            if damping > 0.0 and bend != 0.0:
                now = f * rate + bend * (clock - kick)
                wait = time_to_plane_in_medium(gap - behind * bend, now, bend, damping, T.radius[i], span)
                if wait < np.inf:
                    wait = min(dt - clock, f * wait * exponentials(damping * wait)[1])
            else:
                wait = _time_to_plane(gap - behind * bend, rate + bend * (clock - kick), bend)
            if wait < np.inf:
                when = clock + wait
                acceleration -= damping * rate
                slow = drift.slow * rest_speed(i, len(x) + p, (-N[p, 0], -N[p, 1], -N[p, 2]), T)
                closing = -(rate + acceleration * (when - kick))
                if when <= min(dt, body.impact_time) and closing > slow + body.negligible_speed:
                    if when == body.impact_time and body.partner < len(x) + p:
                        continue
                    body.impact_time, body.partner, body.partner_impacts = when, len(x) + p, 0


@inner
def _time_to_plane(gap: float, rate: float, bend: float) -> float:
    """Return the first time (s) at which gap + rate t + ½ bend t² reaches 0 from above; 0 if closed and closing."""
    if rate < 0.0 and gap <= 0.0:
        return 0.0
    if bend == 0.0:
        return gap / -rate if rate < 0.0 else np.inf
    square = rate * rate - 2.0 * bend * gap
    if not (square >= 0.0 and (rate < 0.0 or bend < 0.0)):
        return np.inf
    root = float(np.sqrt(square))
    return 2.0 * gap / (root - rate) if rate < 0.0 else (rate + root) / -bend
