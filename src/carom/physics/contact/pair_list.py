"""The searches for touching pairs, and a list of pairs.

A list of pairs avoids most searches (Verlet 1967). The list contains all pairs no farther apart than the search
distance plus a margin, and is rebuilt only when bodies have moved far enough. Two bodies that have each moved by at
most d since the list was made have come closer by at most 2d. As long as 2d is within the margin, the list holds all
pairs within the search distance. The listed pairs pass the same exact test, in the same order, so the result equals the
result of a search. If the distance of a later search is shorter, the difference adds to the margin. A step whose drift
has searched within a larger distance therefore finds its contacts in the same list, however fast bodies are.

The margin is chosen by the speed of the bodies so that a list lasts for `CALLS` calls, within limits. A wider list
costs more to test but is rebuilt less often. For 10⁴ spheres that fill 0.3 of a box and move by up to 0.05 of their
radius a step, a step takes 0.45 of the time of a step that searches; with lists for 4 and 12 calls, it takes 0.54 and
0.43.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, Records, dtype_of
from carom.physics.contact.broad_phase.grid import ALL_PAIRS_UP_TO, HierarchicalGrid
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.geometry import SearchedSpheres, are_near
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.instructions import from_front
from carom.physics.jit.team import SOLO, Team
from carom.physics.placement.neighbours import overlapping_pairs
from carom.physics.vector import between, is_periodic, minimum_image, sizes

LEAST_MARGIN, MOST_MARGIN = 0.2, 1.0  # margins in smallest radii; in a heap they give 1.3 and 3 times as many pairs
CALLS = 10  # number of calls that a list should last
# searches that a list must save at the present speed, since making a list costs as much as two searches
LEAST_SEARCHES = 4
LIST_ROUNDING = 1e-14  # error relative to the largest coordinate and distance; the test of a pair errs by about 1e-16
OF_HALF_A_BOX = 0.9  # largest search distance and margin, in half box sizes; beyond it, another image may be nearer
BODIES_PER_BLOCK = 2048  # bodies whose displacements are measured at a time: 48 KiB of positions
PAIRS_PER_BLOCK = 4096  # pairs of the list that are tested at a time: 64 KiB
MIN_BLOCKS_PER_TASK = 2


class BlockRecord(Protocol):
    """The listed pairs of a block."""

    begin: int  # the first pair
    count: int  # number of pairs


class FarthestRecord(Protocol):
    """The largest values of the bodies of a block."""

    move: float  # m², largest squared displacement
    size: float  # m, largest coordinate


BLOCK = dtype_of(BlockRecord)
FARTHEST = dtype_of(FarthestRecord)


class Search(Protocol):
    """A search for the pairs of spheres that touch."""

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""


class KdTree:
    """The reference engine's broad phase: 2 to 8 times slower than `HierarchicalGrid` (benchmarks/contacts.py)."""

    def __init__(self, radius: FloatArray, box: FloatArray) -> None:
        self._radius = radius
        self._box = box if box[0] > 0.0 else None

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        return overlapping_pairs(position, self._radius * scale + 0.5 * skin, self._box)


def search_by(method: str, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> Search:
    """Return the search of a scene's ``contact.search``; ``team`` has the threads that search grids.

    Few bodies are tested pair by pair, which is as fast as a list.
    """
    if method == "k-d-tree":
        return KdTree(radius, box)
    grid = HierarchicalGrid(radius, box, team)
    return grid if len(radius) <= ALL_PAIRS_UP_TO else PairList(grid, radius, box, team)


class PairList:
    """Finds the touching pairs of n spheres in a list that a grid makes; see `Search`."""

    def __init__(self, grid: HierarchicalGrid, radius: FloatArray, box: FloatArray, team: Team = SOLO) -> None:
        self._grid, self._radius, self._box, self._team = grid, radius, box, team
        self._smallest, self._largest = float(radius.min()), float(radius.max())
        self._widest = 0.5 * float(box.min()) if box[0] > 0.0 else np.inf  # m; beyond this, another image may be nearer
        self._listed = np.empty((0, 2), dtype=np.int64)
        self._start = np.full((len(radius), 3), np.inf)  # m, positions when the list was made, or at the last call
        self._moves = np.zeros(-(-len(radius) // BODIES_PER_BLOCK), FARTHEST)
        self._scale, self._skin = 0.0, -np.inf  # scale and skin of the distance within which the list holds all pairs
        self._least = -np.inf  # m, the distance without the margin
        self._calls = self._searches = 1  # calls since the list was made, and calls that needed its margin
        self._within_reach(self._start, 1.0, 0.0)  # loads the kernels
        self._farthest_move(self._start)

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        """Return the pairs no farther apart than ``(r_i + r_j) scale + skin``, (m, 2), sorted by (i, j)."""
        moved, size = self._farthest_move(position)
        wider = 2.0 * (self._largest if scale > self._scale else self._smallest) * (scale - self._scale) + skin
        closer = 2.0 * moved + LIST_ROUNDING * (size + 2.0 * self._largest * scale + skin)
        if not wider + closer <= self._skin:
            margin = self._margin(2.0 * moved, scale, skin)
            np.copyto(self._start, position)
            self._calls = self._searches = 1
            self._scale, self._least, self._skin = scale, skin, skin + margin
            self._listed = self._grid.pairs(position, self._scale, self._skin)
            if margin == 0.0:
                return self._listed
        else:
            self._searches += wider + closer > self._least
        self._calls += 1
        return self._within_reach(position, scale, skin)

    def _margin(self, closer: float, scale: float, skin: float) -> float:
        """Return a list's margin in m, given how much closer bodies came since the last list; 0 means no margin."""
        most = min(MOST_MARGIN * self._smallest, OF_HALF_A_BOX * self._widest - 2.0 * self._largest * scale - skin)
        if not closer / self._searches * LEAST_SEARCHES <= most:
            return 0.0
        return min(most, max(LEAST_MARGIN * self._smallest, closer / self._calls * CALLS))

    def _farthest_move(self, position: FloatArray) -> tuple[float, float]:
        """Return the largest displacement of a body from its start, and the largest absolute coordinate, in m."""
        moves = self._moves
        self._team.divide(len(moves), MIN_BLOCKS_PER_TASK, _measure_moves, position, self._start, self._box, moves)
        return math.sqrt(moves["move"].max()), float(moves["size"].max())

    def _within_reach(self, position: FloatArray, scale: float, skin: float) -> IntArray:
        """Return the listed pairs within the search distance."""
        listed, team = self._listed, self._team
        blocks, near = np.empty(-(-len(listed) // PAIRS_PER_BLOCK), BLOCK), np.empty_like(listed)
        spheres = position, self._radius, self._box, scale, skin
        team.divide(len(blocks), MIN_BLOCKS_PER_TASK, _test, listed, spheres, near, blocks)
        return close_up(near, blocks, team)


@long_kernel
def _measure_moves(
    lo: int, hi: int, position: FloatArray, start: FloatArray, box: FloatArray, moves: RecordArray[FarthestRecord]
) -> None:
    """Find the largest displacement and the largest coordinate in the blocks [lo, hi) of bodies."""
    periodic = is_periodic(box)
    for block in range(lo, hi):
        farthest, size = 0.0, 0.0
        for i in range(block * BODIES_PER_BLOCK, min(len(position), (block + 1) * BODIES_PER_BLOCK)):
            d2 = 0.0
            for k in range(3):
                d = position[i, k] - start[i, k]
                if periodic:
                    d = minimum_image(d, box[k])
                d2 += d * d
                size = max(size, abs(position[i, k]))
            farthest = max(farthest, d2)
        moves[block].move, moves[block].size = farthest, size


@long_kernel
def _test(
    lo: int, hi: int, listed: IntArray, spheres: SearchedSpheres, near: IntArray, blocks: RecordArray[BlockRecord]
) -> None:
    """Copy the pairs of the blocks [lo, hi) that are within the search distance.

    Counting references to arrays at each pair would make a step of 10⁴ spheres 1.8 times as long on one thread, 2.7
    times on two.
    """
    position, radius, box, scale, skin = spheres
    size = sizes(box)
    for block in range(lo, hi):
        m = begin = from_front(block * PAIRS_PER_BLOCK)
        for c in range(begin, min(len(listed), begin + PAIRS_PER_BLOCK)):
            i, j = ends_of(listed, c)
            dx, dy, dz = between(position, i, j)
            # the pair is written without a branch, because a branch would often be mispredicted
            near[m, 0], near[m, 1] = i, j
            m += are_near(dx, dy, dz, radius[i] + radius[j], size, scale, skin)
        blocks[block].begin, blocks[block].count = begin, m - begin


def close_up(pairs: IntArray, blocks: Records, team: Team) -> IntArray:
    """Return a copy of the pairs of all blocks, (m, 2), without the gaps between them; blocks are (k,) `BLOCK`."""
    if len(blocks) == 1:
        begin, count = blocks[0].item()
        return pairs[begin : begin + count].copy()
    ends = np.cumsum(blocks["count"])
    together = np.empty((ends[-1] if len(ends) else 0, 2), dtype=np.int64)
    team.divide(len(blocks), MIN_BLOCKS_PER_TASK, _close_up, pairs, blocks, ends, together)
    return together


@long_kernel
def _close_up(
    lo: int, hi: int, pairs: IntArray, blocks: RecordArray[BlockRecord], ends: IntArray, together: IntArray
) -> None:
    """Copy the pairs of the blocks [lo, hi) to their final places."""
    for block in range(lo, hi):
        begin, count = blocks[block].begin, blocks[block].count
        for k in range(count):
            m = ends[block] - count + k
            together[m, 0], together[m, 1] = pairs[begin + k, 0], pairs[begin + k, 1]
