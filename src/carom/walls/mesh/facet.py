"""A triangle of a mesh: the point of it nearest to a body, and whether a neighbour has a nearer one.

A body touches the mesh where the distance has a local minimum: inside of a triangle, on an edge, or at a corner. Space
near a mesh is divided among these (Voronoi regions): a point belongs to a triangle if it is above or below it, to an
edge if it is beyond the edge for both triangles there, and to a corner if it is beyond the corner for all edges there.
An edge or a corner that several triangles share belongs to the first of them. No other triangle touches a body there,
so a body that rolls over an edge of flat neighbours, or hits one, meets one plane.

Where neighbours are flat, a triangle continues beyond their common edge as a plane, and so it does beyond a corner
where all edges are flat: a body that rolls on it in a step may leave it, and the neighbour takes over as the next step
begins.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.extend import kernel

CORNERS = tuple(f"corner_{k}{axis}" for k in range(3) for axis in "xyz")
NORMAL = ("normal_x", "normal_y", "normal_z")
INWARD = tuple(f"inward_{k}{axis}" for k in range(3) for axis in "xyz")  # in the plane, from edge k into the triangle
ACROSS = tuple(f"across_{k}{axis}" for k in range(3) for axis in "xyz")  # the same of the neighbour; 0 without one
EDGES = tuple(f"edge_{k}" for k in range(3))  # edge k, from corner k to the next: `FREE`, `OWN`, `OTHER` or `FLAT`
TURNS = tuple(f"turn_{k}" for k in range(3))  # to the next triangle with corner k: difference of their numbers
SPOTS = tuple(f"spot_{k}" for k in range(3))  # which of its corners it is
TIPS = tuple(f"tip_{k}" for k in range(3))  # corner k: `OWN`, `OTHER`, or `FLAT_OWN` if all edges there are flat
FIELDS = (*CORNERS, *NORMAL, *INWARD, *ACROSS, *EDGES, *TURNS, *SPOTS, *TIPS)
FREE, OWN, OTHER, FLAT_OWN, FLAT_OTHER = 0.0, 1.0, 2.0, 3.0, 4.0  # kinds; flat ones touch nothing
FLAT = 1e-5  # rad between neighbours; coordinates of seven digits turn a triangle by 1e-6, if it is not small
SLACK = 1e-10  # of the distance from a corner, by which regions overlap; times of impact err by less


def fields_of(corners: FloatArray, triangles: IntArray) -> dict[str, FloatArray]:
    """Return the fields of all triangles, (f,) each.

    ``corners`` are (k, 3) m, and ``triangles``, (f, 3), refer to them. An edge has at most two triangles.
    """
    count = len(triangles)
    points = corners[triangles]  # (f, 3, 3)
    along = np.roll(points, -1, axis=1) - points
    along /= _length(along)[..., None]
    normal = np.cross(along[:, 0], along[:, 1])
    normal /= _length(normal)[:, None]
    inward = np.cross(normal[:, None], along)
    kinds, across = np.full((count, 3), FREE), np.zeros((count, 3, 3))
    one, other = _neighbours(triangles)  # places 3 f + k of edges that lie on each other, the first triangle first
    flat = _length(inward.reshape(-1, 3)[one] + inward.reshape(-1, 3)[other]) <= FLAT
    across.reshape(-1, 3)[one], across.reshape(-1, 3)[other] = inward.reshape(-1, 3)[other], inward.reshape(-1, 3)[one]
    kinds.reshape(-1)[one] = np.where(flat, FLAT_OWN, OWN)
    kinds.reshape(-1)[other] = np.where(flat, FLAT_OTHER, OTHER)
    following, first = _rings(triangles)
    turns = following // 3 - np.arange(count)[:, None]
    sharp = np.zeros(len(corners), dtype=np.bool_)
    sharp[triangles[kinds < FLAT_OWN]] = sharp[np.roll(triangles, -1, axis=1)[kinds < FLAT_OWN]] = True
    tips = np.where(sharp[triangles], np.where(first, OWN, OTHER), FLAT_OWN)
    columns = [points.reshape(count, 9), normal, inward.reshape(count, 9), across.reshape(count, 9), kinds]
    table = np.concatenate([*columns, turns, following % 3, tips], axis=1)
    return dict(zip(FIELDS, np.ascontiguousarray(table.T), strict=True))


def _length(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


def _neighbours(triangles: IntArray) -> tuple[IntArray, IntArray]:
    """Return the places of pairs of edges with the same ends, (m,) and (m,)."""
    ends = np.sort(np.stack((triangles, np.roll(triangles, -1, axis=1)), axis=2), axis=2).reshape(-1, 2)
    order = np.lexsort((ends[:, 1], ends[:, 0]))  # stable, so that the first triangle comes first
    same = (ends[order[1:]] == ends[order[:-1]]).all(axis=1)
    return order[:-1][same], order[1:][same]


def _rings(triangles: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the next place 3 f + k of the same corner, (f, 3), in a ring, and which are the first of each corner."""
    flat = triangles.reshape(-1)
    order = np.argsort(flat, kind="stable")
    begins = np.append(True, flat[order[1:]] != flat[order[:-1]])
    starts = np.flatnonzero(begins)
    following = np.append(order[1:], 0)
    following[np.append(starts[1:], len(order)) - 1] = order[starts]
    ring, first = np.empty_like(flat), np.zeros(len(flat), dtype=np.bool_)
    ring[order], first[order[starts]] = following, True
    return ring.reshape(-1, 3), first.reshape(-1, 3)


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
    """Return the distance from each edge in the plane of a triangle, in m; negative beyond it."""
    one = _beyond(x - p.corner_0x, y - p.corner_0y, z - p.corner_0z, p.inward_0x, p.inward_0y, p.inward_0z)
    two = _beyond(x - p.corner_1x, y - p.corner_1y, z - p.corner_1z, p.inward_1x, p.inward_1y, p.inward_1z)
    three = _beyond(x - p.corner_2x, y - p.corner_2y, z - p.corner_2z, p.inward_2x, p.inward_2y, p.inward_2z)
    return one, two, three


@kernel
def _on_border(p: Any, x: float, y: float, z: float) -> tuple[int, float, float, float, float]:
    """Return the edge nearest to a point, the place on it from 0 to 1, and the way from there to the point in m."""
    edge, place, fx, fy, fz, least = 0, 0.0, 0.0, 0.0, 0.0, math.inf
    for k in range(3):
        ax, ay, az = _corner(p, k)
        bx, by, bz = _corner(p, (k + 1) % 3)
        ex, ey, ez = bx - ax, by - ay, bz - az
        dx, dy, dz = x - ax, y - ay, z - az
        t = (dx * ex + dy * ey + dz * ez) / (ex * ex + ey * ey + ez * ez)
        t = max(0.0, min(1.0, t))
        if t == 1.0:  # exactly from the corner
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
    """Return whether a point is on this side of an edge; flat neighbours share no point."""
    return inside > slack if kind == FLAT_OTHER else inside >= -slack


def touches(surface: Any, facet: int, x: float, y: float, z: float) -> bool:
    """Return whether the nearest point of a triangle belongs to it, as described above."""
    p = surface[facet]
    rx, ry, rz = abs(x - p.corner_0x), abs(y - p.corner_0y), abs(z - p.corner_0z)
    slack = SLACK * (rx + ry + rz)
    one, two, three = _insides(p, x, y, z)
    if _is_within(one, p.edge_0, slack) and _is_within(two, p.edge_1, slack) and _is_within(three, p.edge_2, slack):
        return True
    if one >= 0.0 and two >= 0.0 and three >= 0.0:  # above an edge of a flat neighbour, which touches instead
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
    """Return whether a point belongs to a corner of a triangle, which is the first with this corner."""
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
        if other == facet:  # a triangle has a corner once
            return True
