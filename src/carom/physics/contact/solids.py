"""The solids of a scene in kernels: planes, and walls of any shape.

Kernels refer to a solid by its number and use its tangent plane at the point nearest to a body. In scenes with planes
alone, ``surface`` contains their normals and ``offset`` their distances from the origin. With walls, ``surface``
contains a record for each solid. The type of the records names the functions of all shapes (`WallShape`), and Numba
selects the functions by that type when it compiles a kernel. Kernels of scenes without walls therefore do not contain
these functions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.facets import TREE, consists_of_facets, farthest_nearby, first_facet, next_facet
from carom.physics.contact.records import ContactStateRecord
from carom.physics.contact.translating_walls import (
    in_frame_of_wall,
    shift_of,
)
from carom.physics.jit.decorators import chosen_by_type, identity_of, inline, inner, kernel, long_kernel, with_field
from carom.physics.jit.instructions import from_front
from carom.physics.vector import Vector, add, vector
from carom.scene.wall_shapes import function_of, shape_called

_MARK = "walls_"  # prefix of the first field's name in the records
_nearest: dict[str, Callable[..., Any]] = {}  # nearest-point functions, by the name of the marking field
_touches: dict[str, Callable[..., Any]] = {}  # functions `touches`, by the name of the marking field
ARC_PASSES = 3  # passes of Newton's method; each doubles the number of correct digits
LARGEST_ARC = 0.5  # fraction of the focal distance by which a body may move along a wall in a step


def mark_of(shapes: list[str], translates: bool) -> str:
    """Prepare the functions of shapes for kernels; return the name of the field that identifies these shapes."""
    functions = [function_of(shape_called(name).nearest) for name in shapes]
    facets = [(kind, shape_called(name).touches) for kind, name in enumerate(shapes, start=1)]
    touching = {kind: function_of(touches) for kind, touches in facets if touches is not None}
    mark = f"{_MARK}{'moving_' if translates else ''}{'_'.join(shapes)}_{identity_of(*functions, *touching.values())}"
    if mark not in _nearest:
        chosen: Callable[..., Any] = inline(_of_plane)
        for kind, function in enumerate(functions, start=1):
            chosen = _either(kind, inline(function), chosen)
        _nearest[mark] = in_frame_of_wall(chosen) if translates else chosen
        chosen = inline(_always)
        for kind, function in touching.items():
            chosen = _either_facet(kind, inline(function), chosen)
        _touches[mark] = chosen
    return mark


def _always(surface: Any, solid: int, x: float, y: float, z: float) -> bool:
    return True


def _either_facet(kind: int, one: Callable[..., Any], other: Callable[..., Any]) -> Callable[..., Any]:
    """Return `touches_here` of a solid: ``one`` for the given kind of solid, and ``other`` for the kinds before it."""

    def chosen(surface: Any, solid: int, x: float, y: float, z: float) -> Any:
        if surface[solid].kind == kind:
            return one(surface, solid, x, y, z)
        return other(surface, solid, x, y, z)

    return inline(chosen)


def _of_plane(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the values of `WallShape.nearest` for a plane."""
    distance = -p.plane_offset + p.plane_x * x + p.plane_y * y + p.plane_z * z
    return p.plane_x, p.plane_y, p.plane_z, distance, np.inf


def _either(kind: int, one: Callable[..., Any], other: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of a solid: ``one`` for the given kind of solid, and ``other`` for the kinds before it."""

    def chosen(p: Any, x: float, y: float, z: float) -> Any:
        if p.kind == kind:
            return one(p, x, y, z)
        return other(p, x, y, z)

    return inline(chosen)


def nearest_point(
    surface: FloatArray, solid: int, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Return, for a solid in a scene with walls, the values that `WallShape.nearest` defines."""
    raise NotImplementedError("only kernels call it")


@chosen_by_type(nearest_point)
def _nearest_point(surface: Any, solid: Any, x: Any, y: Any, z: Any) -> Any:
    of_one: Any = _nearest[next(iter(surface.dtype.fields))]
    return lambda surface, solid, x, y, z: of_one(surface[solid], x, y, z)


def _facet_touches(surface: FloatArray, solid: int, x: float, y: float, z: float) -> bool:
    raise NotImplementedError("only kernels call it")


@chosen_by_type(_facet_touches)
def _touches_facet(surface: Any, solid: Any, x: Any, y: Any, z: Any) -> Any:
    of_solid: Any = _touches[next(iter(surface.dtype.fields))]

    def of_facet(surface: Any, solid: int, x: float, y: float, z: float) -> Any:
        return of_solid(surface, solid, x, y, z)

    return of_facet


def _touches_in_frame(surface: FloatArray, solid: int, x: float, y: float, z: float) -> bool:
    dx, dy, dz = shift_of(surface, solid)
    return _facet_touches(surface, solid, x - dx, y - dy, z - dz)


@with_field(TREE[0], _touches_in_frame)
def touches_here(surface: FloatArray, solid: int, x: float, y: float, z: float) -> bool:
    """Return whether a body with its centre at (x, y, z) m may touch this facet; True if no wall has facets.

    The answer is False if the nearest point belongs to a neighbouring facet.
    """
    return True


def _tangent_of_wall(
    surface: FloatArray, offset: FloatArray, solid: int, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    nx, ny, nz, distance, _ = nearest_point(surface, solid, x, y, z)
    return nx, ny, nz, nx * x + ny * y + nz * z - distance


@with_field("kind", _tangent_of_wall)
def tangent_plane(
    surface: FloatArray, offset: FloatArray, solid: int, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Return the normal of the plane that touches a solid at the point nearest to (x, y, z) m, and its offset in m."""
    return surface[solid, 0], surface[solid, 1], surface[solid, 2], offset[solid]


def _bias_on_curve(
    surface: FloatArray,
    solid: int,
    bias: float,
    radius: float,
    place: Vector,
    normal: Vector,
    tangential: Vector,
    drift: float,
) -> tuple[float, Vector]:
    """Find `bias_along_wall` by Newton's method, from the condition that the body touches the wall after the drift.

    As at a plane, an overlap is kept: the position correction removes it without a velocity.
    """
    (x, y, z), (nx, ny, nz), (tx, ty, tz) = place, normal, tangential
    _, _, _, distance, focal = nearest_point(surface, solid, x, y, z)
    touching = min(radius, distance)
    c, path = bias, drift * np.sqrt(tx * tx + ty * ty + tz * tz)
    if not 0.0 < path < LARGEST_ARC * focal:
        return bias, normal
    qx, qy, qz = -nx, -ny, -nz
    for _ in range(ARC_PASSES):
        px, py, pz = x + drift * (tx + c * nx), y + drift * (ty + c * ny), z + drift * (tz + c * nz)
        qx, qy, qz, distance, _ = nearest_point(surface, solid, px, py, pz)
        slope = -(qx * nx + qy * ny + qz * nz)
        if not slope > LARGEST_ARC:  # the body leaves an edge, or the wall is not a curve
            return bias, normal
        c += (distance - touching) / (slope * drift)
    return c, (-qx, -qy, -qz)


@with_field("kind", _bias_on_curve)
def bias_along_wall(
    surface: FloatArray,
    solid: int,
    bias: float,
    radius: float,
    place: Vector,
    normal: Vector,
    tangential: Vector,
    drift: float,
) -> tuple[float, Vector]:
    """Return the closing speed at which a body just touches a wall after a drift (s), and the normal there.

    A body that overlaps the wall keeps its overlap. ``bias`` is the speed at which the body would just touch a plane,
    ``place`` is its centre in m, and ``tangential`` is its velocity along the wall; the normal points to the wall.
    Speeds are in m/s.
    """
    return bias, normal


@kernel
def write_heights(position: FloatArray, surface: FloatArray, first: int, heights: FloatArray) -> None:
    """Write the distances of points from some solids, (n, k) m, given the number of the first solid."""
    for i in range(len(position)):
        x, y, z = vector(position, i)
        for k in range(heights.shape[1]):
            if consists_of_facets(surface, first + k):
                heights[i, k] = _distance_of_facets(surface, first + k, (x, y, z))
            else:
                heights[i, k] = nearest_point(surface, first + k, x, y, z)[3]


@inner
def _distance_of_facets(surface: FloatArray, solid: int, point: Vector) -> float:
    """Return the distance of a point from the nearest facet of a wall, in m."""
    (x, y, z), (dx, dy, dz), least = point, shift_of(surface, solid), np.inf
    place = x - dx, y - dy, z - dz
    reach = farthest_nearby(surface, solid, place)
    facet, walk = next_facet(surface, solid, first_facet(surface, solid), place, reach)
    while facet >= 0:
        if touches_here(surface, facet, x, y, z):
            least = min(least, nearest_point(surface, facet, x, y, z)[3])
        facet, walk = next_facet(surface, solid, walk, place, min(reach, least))
    return least


@long_kernel
def add_arc_speeds(
    lo: int,
    hi: int,
    pairs: IntArray,
    moving: tuple[FloatArray, FloatArray, FloatArray, float],
    load_speed: FloatArray,
    states: RecordArray[ContactStateRecord],
) -> None:
    """Add the closing speeds of bodies that roll along walls to the speeds of the contacts [lo, hi).

    After a straight drift of dt s along a wall with the radius of curvature f, a body closes faster by v_t² dt/f than
    on a plane. ``moving`` holds positions (m), velocities (m/s), the walls, and dt.
    """
    x, v, surface, dt = moving
    n = len(x)
    for c in range(from_front(lo), hi):
        i, j = ends_of(pairs, c)
        if j >= n and load_speed[c] > 0.0:
            (px, py, pz), (vx, vy, vz) = vector(x, i), vector(v, i)
            nx, ny, nz, _, focal = nearest_point(surface, j - n, px, py, pz)
            if focal > 0.0:
                vn = vx * nx + vy * ny + vz * nz
                along = vx * vx + vy * vy + vz * vz - vn * vn
                turning = max(0.0, along) * dt / focal
                states[c].rest_speed += turning
                load_speed[c] += turning


@kernel
def add_load_of_walls(
    pairs: IntArray, x: FloatArray, v: FloatArray, surface: FloatArray, lift: float, presses: FloatArray
) -> float:
    """Add the accelerations that press bodies onto near walls, v_t²/f and ``lift``; return the largest v_t/f in 1/s.

    ``lift`` is the largest acceleration of a wall, and ``presses``, (n + p, 3), the accelerations that press contacts
    together, both in m/s².
    """
    n, fastest = len(x), 0.0
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        if j >= n:
            (px, py, pz), (vx, vy, vz) = vector(x, i), vector(v, i)
            nx, ny, nz, _, focal = nearest_point(surface, j - n, px, py, pz)
            vn, turning = vx * nx + vy * ny + vz * nz, 0.0
            along = np.sqrt(max(0.0, vx * vx + vy * vy + vz * vz - vn * vn))
            if focal > 0.0:
                turning = along / focal
            add(presses, i, -(lift + along * turning), nx, ny, nz)
            fastest = max(fastest, turning)
    return fastest
