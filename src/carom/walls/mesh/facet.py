"""A triangle of a mesh: its point nearest to a body, and whether a neighbour has a nearer point.

A body touches the mesh where the distance has a local minimum: inside a triangle, on an edge, or at a corner. Space
near a mesh is divided among triangles, edges and corners (Voronoi regions): a point belongs to a triangle if it lies
above or below the triangle, to an edge if it lies beyond the edge for both triangles of the edge, and to a corner if it
lies beyond the corner for all edges of the corner. An edge or a corner that several triangles share belongs to the
first of these triangles. No other triangle touches a body there, so a body that rolls over the edge between coplanar
neighbours, or hits such an edge, meets one plane.

If neighbours are coplanar, a triangle continues as a plane beyond their common edge, and beyond a corner where all
edges are flat: a body that rolls on it in a step may leave it, and the neighbour takes over as the next step begins.
"""

from __future__ import annotations

import math
from typing import Any

from carom.extend import kernel
from carom.walls.mesh.facet_fields import FLAT_OTHER, FLAT_OWN, FREE, OWN

SLACK = 1e-10  # fraction of the distance from a corner by which regions overlap; times of impact err by less


@kernel
def _beyond(x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    return x * dx + y * dy + z * dz


@kernel
def _corner(p: Any, k: int) -> tuple[float, float, float]:
    if k == 0:
        return p.corner_0x, p.corner_0y, p.corner_0z
    if k == 1:
        return p.corner_1x, p.corner_1y, p.corner_1z
    return p.corner_2x, p.corner_2y, p.corner_2z


@kernel
def _insides(p: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the distance from each edge in the plane of a triangle, in m; negative beyond the edge."""
    one = _beyond(x - p.corner_0x, y - p.corner_0y, z - p.corner_0z, p.inward_0x, p.inward_0y, p.inward_0z)
    two = _beyond(x - p.corner_1x, y - p.corner_1y, z - p.corner_1z, p.inward_1x, p.inward_1y, p.inward_1z)
    three = _beyond(x - p.corner_2x, y - p.corner_2y, z - p.corner_2z, p.inward_2x, p.inward_2y, p.inward_2z)
    return one, two, three


@kernel
def _on_border(p: Any, x: float, y: float, z: float) -> tuple[int, float, float, float, float]:
    """Return the edge nearest to a point, the position along it from 0 to 1, and the vector to the point in m."""
    edge, place, fx, fy, fz, least = 0, 0.0, 0.0, 0.0, 0.0, math.inf
    for k in range(3):
        ax, ay, az = _corner(p, k)
        bx, by, bz = _corner(p, (k + 1) % 3)
        ex, ey, ez = bx - ax, by - ay, bz - az
        dx, dy, dz = x - ax, y - ay, z - az
        t = (dx * ex + dy * ey + dz * ez) / (ex * ex + ey * ey + ez * ez)
        t = max(0.0, min(1.0, t))
        if t == 1.0:  # the vector begins exactly at the corner
            dx, dy, dz = x - bx, y - by, z - bz
        else:
            dx, dy, dz = dx - t * ex, dy - t * ey, dz - t * ez
        square = dx * dx + dy * dy + dz * dz
        if square < least:
            edge, place, fx, fy, fz, least = k, t, dx, dy, dz, square
    return edge, place, fx, fy, fz


@kernel
def _kind_of_edge(p: Any, k: int) -> Any:
    if k == 0:
        return p.edge_0
    return p.edge_1 if k == 1 else p.edge_2


@kernel
def _kind_of_corner(p: Any, k: int) -> Any:
    if k == 0:
        return p.tip_0
    return p.tip_1 if k == 1 else p.tip_2


def nearest(p: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the normal and the distance from a triangle, its edges or corners; no level surface is concave."""
    one, two, three = _insides(p, x, y, z)
    if not (one >= 0.0 and two >= 0.0 and three >= 0.0):
        edge, place, fx, fy, fz = _on_border(p, x, y, z)
        kind = _kind_of_edge(p, edge)
        if place in (0.0, 1.0):
            kind = _kind_of_corner(p, (edge + 1) % 3 if place == 1.0 else edge)
        distance = math.sqrt(fx * fx + fy * fy + fz * fz)
        if kind < FLAT_OWN and distance > 0.0:
            return fx / distance, fy / distance, fz / distance, distance, math.inf
    h = _beyond(x - p.corner_0x, y - p.corner_0y, z - p.corner_0z, p.normal_x, p.normal_y, p.normal_z)
    side = 1.0 if h >= 0.0 else -1.0
    return side * p.normal_x, side * p.normal_y, side * p.normal_z, side * h, math.inf


@kernel
def _is_within(inside: float, kind: float, slack: float) -> bool:
    """Return whether a point is on this side of an edge; coplanar neighbours share no point."""
    return inside > slack if kind == FLAT_OTHER else inside >= -slack


def touches(surface: Any, facet: int, x: float, y: float, z: float) -> bool:
    """Return whether the nearest point of a triangle belongs to it, as described above."""
    p = surface[facet]
    rx, ry, rz = abs(x - p.corner_0x), abs(y - p.corner_0y), abs(z - p.corner_0z)
    slack = SLACK * (rx + ry + rz)
    one, two, three = _insides(p, x, y, z)
    if _is_within(one, p.edge_0, slack) and _is_within(two, p.edge_1, slack) and _is_within(three, p.edge_2, slack):
        return True
    # the point is above the edge of a coplanar neighbour, which touches in place of this triangle
    if one >= 0.0 and two >= 0.0 and three >= 0.0:
        return False
    edge, place, fx, fy, fz = _on_border(p, x, y, z)
    if 0.0 < place < 1.0:
        at_end = place < SLACK or place > 1.0 - SLACK
        if at_end and _is_at_corner(surface, facet, (edge + 1) % 3 if place > SLACK else edge, x, y, z):
            return True
        kind, mx, my, mz = _kind_of_edge(p, edge), p.across_0x, p.across_0y, p.across_0z
        if edge == 1:
            mx, my, mz = p.across_1x, p.across_1y, p.across_1z
        if edge == 2:
            mx, my, mz = p.across_2x, p.across_2y, p.across_2z
        is_own: bool = kind == FREE or (kind == OWN and _beyond(fx, fy, fz, mx, my, mz) <= slack)
        return is_own
    return _is_at_corner(surface, facet, (edge + 1) % 3 if place == 1.0 else edge, x, y, z)


@kernel
def _is_at_corner(surface: Any, facet: int, k: int, x: float, y: float, z: float) -> bool:
    """Return whether a point belongs to a corner of a triangle, and this triangle is the first with the corner."""
    p = surface[facet]
    if _kind_of_corner(p, k) != OWN:
        return False
    cx, cy, cz = _corner(p, k)
    x, y, z = x - cx, y - cy, z - cz
    slack = SLACK * (abs(x) + abs(y) + abs(z))
    other, spot = facet, k
    while True:
        p = surface[other]
        for step in range(1, 3):
            ex, ey, ez = _corner(p, (spot + step) % 3)
            ex, ey, ez = ex - cx, ey - cy, ez - cz
            if _beyond(x, y, z, ex, ey, ez) > slack * math.sqrt(ex * ex + ey * ey + ez * ez):
                return False
        turn, spot = int((p.turn_0, p.turn_1, p.turn_2)[spot]), int((p.spot_0, p.spot_1, p.spot_2)[spot])
        other += turn
        if other == facet:  # a corner occurs only once in a triangle
            return True
