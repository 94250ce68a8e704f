"""Times of impact of bodies with walls.

The path of a body in a drift is x + v t + ½ g t², where g is the field that bends the path. At the signed distance d(x)
from a wall, the gap of a body of radius r is d - r. The time until this gap closes has two bounds. The gap cannot close
before the path is as long as the gap. The second derivative of the gap is at least -(g + u²/f), where u is the speed
and f the distance of the nearest centre of curvature. Steps by either bound lead to the first root from below; steps by
the second bound converge as fast as Newton's method, as in `time_of_impact`. If a wall translates, the path is relative
to the wall, and the wall's largest acceleration is added to g.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.contact.events.time_of_impact import GAP_TOLERANCE, MOST_PASSES, open_for
from carom.physics.contact.events.trajectories import MOST_HOLDS, Trajectories, elapsed, lag, rest_speed
from carom.physics.contact.facets import consists_of_facets, first_facet, next_facet
from carom.physics.contact.guided_walls import impacts_of_wall
from carom.physics.contact.solids import nearest_point, touches_here
from carom.physics.contact.translating_walls import (
    displacement_in_drift,
    largest_acceleration,
    rate_in_drift,
    shift_of,
    velocity_in_drift,
    walls_translate,
)
from carom.physics.jit.decorators import inner
from carom.physics.vector import Vector, along, vector

FOCAL_FRACTION = 0.5  # fraction of the focal distance by which a body may move in a pass


def predict_with_walls(lo: int, hi: int, T: Trajectories, surface: FloatArray) -> None:
    """Predict the next impact of each body in [lo, hi) with a solid, if it precedes the stored impact."""
    drift, behind = T.drift[0], lag(T)
    clock, kick = drift.clock, drift.kick
    span = drift.dt - elapsed(T)
    for i in range(lo, hi):
        body = T.body[i]
        if body.holds >= MOST_HOLDS:
            continue
        x, y, z = along(T.x, T.v, i, clock - body.now)
        vx, vy, vz = vector(T.v, i)
        gx, gy, gz = 0.0, 0.0, 0.0
        if not body.is_straight:
            gx, gy, gz = drift.field_x, drift.field_y, drift.field_z
        since_kick = clock - kick
        x, y, z = x - behind * gx, y - behind * gy, z - behind * gz
        wx, wy, wz = vx + since_kick * gx, vy + since_kick * gy, vz + since_kick * gz
        path = (x, y, z), (wx, wy, wz), (gx, gy, gz)
        bend = np.sqrt(gx * gx + gy * gy + gz * gz)
        for solid in range(len(T.offset)):
            if not consists_of_facets(surface, solid):
                _predict_with_solid(i, solid, path, bend, span, T, surface)
                continue
            point, reach = _reach(solid, path, bend, span, T, surface)
            facet, walk = next_facet(surface, solid, first_facet(surface, solid), point, reach + T.radius[i])
            while facet >= 0:
                _predict_with_solid(i, facet, path, bend, span, T, surface)
                facet, walk = next_facet(surface, solid, walk, point, reach + T.radius[i])


@inner
def _reach(
    solid: int, path: tuple[Vector, Vector, Vector], bend: float, span: float, T: Trajectories, surface: FloatArray
) -> tuple[Vector, float]:
    """Return where a path begins relative to a wall, and its greatest length within a span (s), both in m."""
    (x, y, z), (vx, vy, vz), _ = path
    if walls_translate(surface):
        clock = T.drift[0].clock
        rx, ry, rz = displacement_in_drift(surface, solid, clock)
        ux, uy, uz = rate_in_drift(surface, solid, clock)
        dx, dy, dz = shift_of(surface, solid)
        x, y, z = x - rx - dx, y - ry - dy, z - rz - dz
        vx, vy, vz = vx - ux, vy - uy, vz - uz
        bend += largest_acceleration(surface, solid)
    speed = np.sqrt(vx * vx + vy * vy + vz * vz)
    return (x, y, z), span * (speed + 0.5 * span * bend)


@inner
def _predict_with_solid(
    i: int,
    solid: int,
    path: tuple[Vector, Vector, Vector],
    bend: float,
    span: float,
    T: Trajectories,
    surface: FloatArray,
) -> None:
    """Store the next impact of a body with a solid, if it precedes the stored impact.

    ``path`` is the body's position (m), velocity (m/s) and acceleration (m/s²); ``bend`` is the magnitude of the
    acceleration.
    """
    n, drift, body = len(T.x), T.drift[0], T.body[i]
    clock, dt, kick = drift.clock, drift.dt, drift.kick
    (x, y, z), (wx, wy, wz), (gx, gy, gz) = path
    held = body.is_straight and not body.is_free  # a rolling body closes its contacts again at the end of the drift
    share = 1.0 if held else drift.slow
    wait = _time_to_wall(solid, (x, y, z), (wx, wy, wz), (gx, gy, gz), bend, T.radius[i], span, T)
    when = clock + wait
    if not when <= min(dt, body.impact_time):
        return
    half = 0.5 * wait
    px, py, pz = x + wait * (wx + half * gx), y + wait * (wy + half * gy), z + wait * (wz + half * gz)
    s = when - kick
    vx, vy, vz = vector(T.v, i)
    ax, ay, az = vector(T.a, i)
    ux, uy, uz = vx + ax * s, vy + ay * s, vz + az * s
    if walls_translate(surface):
        rx, ry, rz = displacement_in_drift(surface, solid, when)
        sx, sy, sz = velocity_in_drift(surface, solid, when)
        px, py, pz = px - rx, py - ry, pz - rz
        bx, by, bz = vector(T.a, n + solid)
        ux, uy, uz = ux - sx - bx * s, uy - sy - by * s, uz - sz - bz * s
    if not touches_here(surface, solid, px, py, pz):  # a neighbouring facet is as near, and gets the contact
        return
    nx, ny, nz, _, focal = nearest_point(surface, solid, px, py, pz)
    closing = -(ux * nx + uy * ny + uz * nz)
    turning = 0.0  # m/s, closing speed of a body that rolls along the wall, at the end of the drift
    if not body.is_free and focal > 0.0:
        turning = max(0.0, ux * ux + uy * uy + uz * uz - closing * closing) * dt / focal
    slow = share * rest_speed(i, n + solid, (-nx, -ny, -nz), T)
    if closing > slow + body.negligible_speed + turning:
        if when == body.impact_time and body.partner < n + solid:
            return
        body.impact_time, body.partner = when, n + solid
        body.partner_impacts = impacts_of_wall(surface, solid)


@inner
def _time_to_wall(
    solid: int,
    position: Vector,
    velocity: Vector,
    acceleration: Vector,
    bend: float,
    R: float,
    span: float,
    T: Trajectories,
) -> float:
    """Return the time in s until a body of radius R (m) touches a wall and closes; infinite if not within a span (s).

    Positions are in m; ``bend`` is the magnitude of the acceleration in m/s².
    """
    t, (x, y, z), (wx, wy, wz), (gx, gy, gz) = 0.0, position, velocity, acceleration
    clock = T.drift[0].clock
    if walls_translate(T.surface):
        bend += largest_acceleration(T.surface, solid)
    for _ in range(MOST_PASSES):
        if not t <= span:
            return np.inf
        px, py, pz = x + t * (wx + 0.5 * t * gx), y + t * (wy + 0.5 * t * gy), z + t * (wz + 0.5 * t * gz)
        vx, vy, vz = wx + t * gx, wy + t * gy, wz + t * gz
        if walls_translate(T.surface):
            rx, ry, rz = displacement_in_drift(T.surface, solid, clock + t)
            ux, uy, uz = rate_in_drift(T.surface, solid, clock + t)
            px, py, pz = px - rx, py - ry, pz - rz
            vx, vy, vz = vx - ux, vy - uy, vz - uz
        nx, ny, nz, distance, focal = nearest_point(T.surface, solid, px, py, pz)
        gap, closing = distance - R, -(vx * nx + vy * ny + vz * nz)
        if gap <= GAP_TOLERANCE * R and closing > 0.0:
            return t
        speed = np.sqrt(vx * vx + vy * vy + vz * vz)
        further = _until_path(gap, speed, bend)
        if focal < np.inf:
            near = _until_path(FOCAL_FRACTION * focal, speed, bend)
            fastest = speed + bend * near
            curvature = fastest * fastest / ((1.0 - FOCAL_FRACTION) * focal) if focal > 0.0 else np.inf
            if near > 0.0:
                further = max(further, min(near, open_for(gap, closing, bend + curvature)))
        elif closing > 0.0 or bend > 0.0:
            further = max(further, open_for(gap, closing, bend))
        else:
            return np.inf
        if not t + further > t:
            return t if closing > 0.0 else np.inf
        t += further
    return np.inf  # a grazing pass


@inner
def _until_path(length: float, speed: float, bend: float) -> float:
    """Return the shortest time (s) in which a body can cover a path of a given length (m)."""
    if not length > 0.0:
        return 0.0
    return float(2.0 * length / (speed + np.sqrt(speed * speed + 2.0 * bend * length)))
