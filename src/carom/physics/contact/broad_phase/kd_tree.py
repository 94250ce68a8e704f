"""A k-d tree as broad phase, for comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.placement.neighbours import overlapping_pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class KdTree:
    """The reference engine's broad phase: 2 to 8 times slower than `HierarchicalGrid` (benchmarks/contacts.py)."""

    def __init__(self, radius: FloatArray, box: FloatArray) -> None:
        self._radius = radius
        self._box = box if box[0] > 0.0 else None

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        return overlapping_pairs(position, self._radius * scale + 0.5 * skin, self._box)
