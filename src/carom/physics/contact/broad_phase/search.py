"""The protocol of searches for touching pairs, and the choice by `contact.search`."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.broad_phase.hierarchical_grid import ALL_PAIRS_UP_TO, HierarchicalGrid
from carom.physics.contact.broad_phase.kd_tree import KdTree
from carom.physics.contact.broad_phase.pair_list import PairList
from carom.physics.parallel.thread_team import SOLO, Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Search(Protocol):
    """A search for the pairs of spheres that touch."""

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        ...


def search_by(method: str, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> Search:
    """Return the search of a scene's ``contact.search``; a team searches the grids.

    Few bodies are tested pair by pair, which takes no longer than a list.
    """
    if method == "k-d-tree":
        return KdTree(radius, box)
    grid = HierarchicalGrid(radius, box, team)
    return grid if len(radius) <= ALL_PAIRS_UP_TO else PairList(grid, radius, box, team)
