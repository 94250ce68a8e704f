"""The fields of the triangles of a mesh: corners, normals, and the kinds of their edges and corners.

This module must work without the compiler, which commands that only read a scene do not load.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray

CORNERS = tuple(f"corner_{k}{axis}" for k in range(3) for axis in "xyz")
NORMAL = ("normal_x", "normal_y", "normal_z")
# unit vector in the plane, from edge k into the triangle
INWARD = tuple(f"inward_{k}{axis}" for k in range(3) for axis in "xyz")
# the same vector of the neighbour at edge k; 0 if there is no neighbour
ACROSS = tuple(f"across_{k}{axis}" for k in range(3) for axis in "xyz")
# kind of edge k, from corner k to the next corner: `FREE`, `OWN`, `OTHER`, `FLAT_OWN` or `FLAT_OTHER`
EDGES = tuple(f"edge_{k}" for k in range(3))
# number of the next triangle with corner k, minus the number of this triangle
TURNS = tuple(f"turn_{k}" for k in range(3))
SPOTS = tuple(f"spot_{k}" for k in range(3))  # which corner of the next triangle this corner is
# kind of corner k: `OWN`, `OTHER`, or `FLAT_OWN` if all edges there are flat
TIPS = tuple(f"tip_{k}" for k in range(3))
FIELDS = (*CORNERS, *NORMAL, *INWARD, *ACROSS, *EDGES, *TURNS, *SPOTS, *TIPS)
# kinds of edges and corners; flat edges and corners touch nothing
FREE, OWN, OTHER, FLAT_OWN, FLAT_OTHER = 0.0, 1.0, 2.0, 3.0, 4.0
# rad, largest angle between coplanar neighbours; coordinates of seven digits turn a triangle by 1e-6 if it is not small
FLAT = 1e-5


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
    """Return the places of pairs of edges with the same ends, (m,) each."""
    ends = np.sort(np.stack((triangles, np.roll(triangles, -1, axis=1)), axis=2), axis=2).reshape(-1, 2)
    order = np.lexsort((ends[:, 1], ends[:, 0]))  # the sort is stable, so that the first triangle comes first
    same = (ends[order[1:]] == ends[order[:-1]]).all(axis=1)
    return order[:-1][same], order[1:][same]


def _rings(triangles: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the next place 3 f + k of each corner, (f, 3), in a ring, and whether a place is the corner's first."""
    flat = triangles.reshape(-1)
    order = np.argsort(flat, kind="stable")
    begins = np.append(True, flat[order[1:]] != flat[order[:-1]])
    starts = np.flatnonzero(begins)
    following = np.append(order[1:], 0)
    following[np.append(starts[1:], len(order)) - 1] = order[starts]
    ring, first = np.empty_like(flat), np.zeros(len(flat), dtype=np.bool_)
    ring[order], first[order[starts]] = following, True
    return ring.reshape(-1, 3), first.reshape(-1, 3)
