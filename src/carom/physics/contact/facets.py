"""Walls of many facets: which facets are near a body.

Each facet is a solid of its own, with a record and a number, so that a body can touch several facets at once. Facets
follow the planes and walls of the scene. The wall itself keeps its place among the solids, as a plane infinitely far
away. A tree of boxes finds the facets near a point. The nodes of the tree are also records, which follow the records of
all facets. Records have the fields `TREE` only in scenes with such walls; kernels know at compile time whether they do.

The nodes follow each other depth first. A walk that finds nothing in a box continues at ``tree_skip``, the node after
the box's last descendant, so it needs no stack.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.physics.jit.decorators import inner, with_field
from carom.physics.vector import Vector

PER_LEAF = 4
LEAF = tuple(f"tree_facet_{k}" for k in range(PER_LEAF))
BOX = ("tree_low_x", "tree_low_y", "tree_low_z", "tree_high_x", "tree_high_y", "tree_high_z")
TREE = ("tree_skip", "tree_first", *LEAF, *BOX)
NO_FACET = -1.0


def tree_of(triangles: FloatArray, first_facet: int, first_node: int) -> FloatArray:
    """Return the fields `TREE` of the nodes over triangles, (k, 12), given the numbers of the first facet and node.

    The triangles are (f, 3, 3) m.
    """
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    centre, nodes, skips = 0.5 * (low + high), list[list[float]](), list[int]()

    def add(members: IntArray) -> None:
        """Add a node for some triangles, and its descendants."""
        place = len(nodes)
        box = [*low[members].min(axis=0), *high[members].max(axis=0)]
        leaf = [NO_FACET] * PER_LEAF
        if len(members) <= PER_LEAF:
            leaf[: len(members)] = [float(first_facet + k) for k in members]
        nodes.append([0.0, 0.0, *leaf, *box])
        skips.append(0)
        if len(members) > PER_LEAF:
            axis = int(np.ptp(centre[members], axis=0).argmax())
            order = members[np.argsort(centre[members, axis], kind="stable")]
            half = len(order) // 2
            add(order[:half])
            add(order[half:])
        skips[place] = len(nodes)

    add(np.arange(len(triangles)))
    table = np.array(nodes)
    table[:, 0] = first_node + np.array(skips)
    return table


def _consists_of_facets(surface: Any, solid: int) -> bool:
    return bool(surface[solid].tree_first > 0.0)


@with_field(TREE[0], _consists_of_facets)
def consists_of_facets(surface: FloatArray, solid: int) -> bool:
    """Return whether a solid is a wall of many facets; a constant in scenes without such walls."""
    return False


@with_field(TREE[0], lambda surface, solid: int(surface[solid].tree_first) * PER_LEAF)
def first_facet(surface: FloatArray, solid: int) -> int:
    """Return where a walk over the facets of a wall begins; see `next_facet`."""
    return 0


def _next_facet(surface: Any, solid: int, walk: int, point: Vector, reach: float) -> tuple[int, int]:
    end, node, place = int(surface[solid].tree_skip), walk // PER_LEAF, walk % PER_LEAF
    while node < end:
        box = surface[node]
        if place == 0 and _square_outside(box, point) > reach * reach:
            node = int(box.tree_skip)
            continue
        facet = _in_leaf(box, place)
        if facet >= 0:
            return facet, node * PER_LEAF + place + 1
        node, place = node + 1, 0
    return -1, walk


@inner
def _square_outside(box: Any, point: Vector) -> float:
    """Return the squared distance of a point from a box in m²; 0 inside."""
    x, y, z = point
    dx = max(0.0, box.tree_low_x - x, x - box.tree_high_x)
    dy = max(0.0, box.tree_low_y - y, y - box.tree_high_y)
    dz = max(0.0, box.tree_low_z - z, z - box.tree_high_z)
    return float(dx * dx + dy * dy + dz * dz)


@inner
def _in_leaf(box: Any, place: int) -> int:
    if place == 0:
        return int(box.tree_facet_0)
    if place == 1:
        return int(box.tree_facet_1)
    if place == 2:
        return int(box.tree_facet_2)
    return int(box.tree_facet_3)


@with_field(TREE[0], _next_facet)
def next_facet(surface: FloatArray, solid: int, walk: int, point: Vector, reach: float) -> tuple[int, int]:
    """Return the number of the next facet whose leaf is within ``reach`` of a point, and the state of the walk.

    ``point`` is relative to the wall; ``point`` and ``reach`` are in m. At the end of the walk, the number is -1.
    """
    return -1, walk


def _farthest_nearby(surface: Any, solid: int, point: Vector) -> float:
    node, (x, y, z) = int(surface[solid].tree_first), point
    while surface[node].tree_facet_0 < 0.0:
        one, other = node + 1, int(surface[node + 1].tree_skip)
        node = one if _square_outside(surface[one], point) <= _square_outside(surface[other], point) else other
    box = surface[node]
    dx = max(x - box.tree_low_x, box.tree_high_x - x)
    dy = max(y - box.tree_low_y, box.tree_high_y - y)
    dz = max(z - box.tree_low_z, box.tree_high_z - z)
    return float(np.sqrt(dx * dx + dy * dy + dz * dz))


@with_field(TREE[0], _farthest_nearby)
def farthest_nearby(surface: FloatArray, solid: int, point: Vector) -> float:
    """Return a distance (m) within which a point has a facet: to the farthest point of a leaf that is probably near.

    A search for the nearest facet begins with this limit; without a limit, it would visit most facets.
    """
    return np.inf
