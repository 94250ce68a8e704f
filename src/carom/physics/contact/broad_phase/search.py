"""The protocol of searches for touching pairs, and the choice by `contact.search`."""

from __future__ import annotations

from typing import Protocol

from carom.arrays import FloatArray, IntArray
from carom.physics.contact.broad_phase.hierarchical_grid import ALL_PAIRS_UP_TO, HierarchicalGrid
from carom.physics.contact.broad_phase.pair_list import PairList
from carom.physics.jit.thread_team import SOLO, Team
from carom.physics.placement.neighbours import overlapping_pairs


class Search(Protocol):
    """A search for the pairs of spheres that touch."""

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        ...


class KdTree:
    """The reference engine's broad phase: 2 to 8 times slower than `HierarchicalGrid` (benchmarks/contacts.py)."""

    def __init__(self, radius: FloatArray, box: FloatArray) -> None:
        self._radius = radius
        self._box = box if box[0] > 0.0 else None

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        return overlapping_pairs(position, self._radius * scale + 0.5 * skin, self._box)


def search_by(method: str, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> Search:
    """Return the search of a scene's ``contact.search``; a team searches the grids.

    Few bodies are tested pair by pair, which takes no longer than a list.
    """
    if method == "k-d-tree":
        return KdTree(radius, box)
    grid = HierarchicalGrid(radius, box, team)
    return grid if len(radius) <= ALL_PAIRS_UP_TO else PairList(grid, radius, box, team)
