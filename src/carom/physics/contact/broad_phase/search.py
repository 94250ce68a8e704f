"""Finding contacts: which pairs touch."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.broad_phase.hierarchical_grid import Grid
from carom.physics.contact.graph import first_of
from carom.physics.contact.load import BLOCK
from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.thread_team import SOLO, Team
from carom.scene.halfspace import HalfSpaces
from carom.scene.neighbours import overlapping_pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SOME = 1  # block of bodies that is worth a part of their own


class Search(Protocol):
    """A way to find the pairs of spheres that touch."""

    def pairs(self, position: FloatArray, stretch: float = 1.0, slack: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) stretch + slack``, (m, 2), sorted by (i, j)."""
        ...


class KdTree:
    """The reference engine's broad phase: 2 to 8 times slower than `Grid` (benchmarks/contacts.py)."""

    def __init__(self, radius: FloatArray, box: FloatArray) -> None:
        self._radius = radius
        self._box = box if box[0] > 0.0 else None

    def pairs(self, position: FloatArray, stretch: float = 1.0, slack: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) stretch + slack``, (m, 2), sorted by (i, j)."""
        return overlapping_pairs(position, self._radius * stretch + 0.5 * slack, self._box)


def search_by(method: str, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> Search:
    """Return the search that a scene names in ``contact.search``; the grids are searched by a team."""
    return KdTree(radius, box) if method == "k-d-tree" else Grid(radius, box, team)


class PlaneSearch:
    """Adds the contacts (i, n + k) of bodies with planes k, and drops those of two fixed bodies.

    Parameters
    ----------
    radius
        (n,) m.
    inverse_mass
        (n + p,) 1/kg; what is fixed touches nothing else that is.
    planes
        The half-spaces.
    team
        Who merges.
    """

    def __init__(self, radius: FloatArray, inverse_mass: FloatArray, planes: HalfSpaces, team: Team) -> None:
        self._team = team
        self._radius = radius
        self._inverse_mass = inverse_mass
        self._planes = planes

    def merged(self, pairs: IntArray, position: FloatArray, stretch: float, slack: float) -> IntArray:
        """Return the pairs, (m, 2) sorted by (i, j), with those of bodies and planes among them, in order."""
        n, p, team = len(self._radius), len(self._planes), self._team
        blocks = np.empty((-(-n // BLOCK), 2), dtype=np.int64)  # where the pairs of so many bodies begin, how many
        merged = np.empty((len(pairs) + n * p, 2), dtype=np.int64)
        spheres, planes = (position, self._radius, self._inverse_mass), (self._planes.normal, self._planes.offset)
        team.divide(len(blocks), SOME, _merge, pairs, *spheres, *planes, stretch, slack, merged, blocks)
        ends = np.cumsum(blocks[:, 1])
        together = np.empty((ends[-1], 2), dtype=np.int64)
        team.divide(len(blocks), SOME, _close_up, merged, blocks, ends, together)
        return together


@long_kernel
def _merge(
    lo: int,
    hi: int,
    pairs: IntArray,
    position: FloatArray,
    radius: FloatArray,
    inverse_mass: FloatArray,
    normal: FloatArray,
    offset: FloatArray,
    stretch: float,
    slack: float,
    merged: IntArray,
    blocks: IntArray,
) -> None:
    """Merge the pairs of the blocks [lo, hi) of bodies, each from where it has room for all that there could be."""
    c = first_of(lo * BLOCK, pairs)
    for block in range(lo, hi):
        begin = c + block * BLOCK * len(offset)
        m = begin
        for i in range(block * BLOCK, min(len(radius), (block + 1) * BLOCK)):
            while c < len(pairs) and pairs[c, 0] == i:
                if inverse_mass[i] + inverse_mass[pairs[c, 1]] > 0.0:
                    merged[m, 0], merged[m, 1] = i, pairs[c, 1]
                    m += 1
                c += 1
            if inverse_mass[i] == 0.0:
                continue
            for k in range(len(offset)):
                height = -offset[k]
                for axis in range(3):
                    height += normal[k, axis] * position[i, axis]
                if height <= radius[i] * stretch + slack:
                    merged[m, 0], merged[m, 1] = i, len(radius) + k
                    m += 1
        blocks[block, 0], blocks[block, 1] = begin, m - begin


@long_kernel
def _close_up(lo: int, hi: int, merged: IntArray, blocks: IntArray, ends: IntArray, together: IntArray) -> None:
    for block in range(lo, hi):
        begin, count = blocks[block, 0], blocks[block, 1]
        for k in range(count):
            m = ends[block] - count + k
            together[m, 0], together[m, 1] = merged[begin + k, 0], merged[begin + k, 1]
