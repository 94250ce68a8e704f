"""The ways to find pairs that touch, and the one that a scene asks for."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.broad_phase.hierarchical_grid import HierarchicalGrid
from carom.physics.contact.broad_phase.kd_tree import KdTree
from carom.physics.parallel.thread_team import SOLO, Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Search(Protocol):
    """A way to find the pairs of spheres that touch."""

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        ...


def search_by(method: str, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> Search:
    """Return the search that a scene names in ``contact.search``; the grids are searched by a team."""
    return KdTree(radius, box) if method == "k-d-tree" else HierarchicalGrid(radius, box, team)
