"""Spheres at random places without overlaps.

Candidates are generated, 1.2 per body, and filtered: first by a broad phase with grids or k-d trees, then by the exact
test. New candidates replace colliding ones until each body has a candidate.

Two grids cover the region of accepted spheres (`Occupancy`). A coarse cell holds at most one centre, since accepted
spheres do not overlap. A fine cell is marked if every centre in it would overlap an accepted sphere; this rejects most
candidates. The others are tested exactly against the centres in nearby cells, so the result is the same as with a
search through all spheres, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import SceneError
from carom.physics.placement.neighbours import (
    QUERY_MARGIN,
    Surroundings,
    overlapping_pairs,
    size_classes,
    squared_distance,
)
from carom.physics.placement.region import Arrangement, bounds, drawn_centres, refuse_too_large, volume
from carom.scene.schema import BodyGroup, Region
from carom.scene.units.system import UnitSystem

FULLEST = 0.38  # random sequential addition of equal spheres jams at 0.384 (Torquato & Stillinger, RMP 82, 2633)
FINE_CELL = 0.34  # edge of a fine cell, in smallest radii
MOST_CELLS = 100_000_000  # largest number of cells of the fine grid, one byte each
# with more cells, the region is nearly empty: few candidates collide, and a plain search is fast
MOST_CELLS_PER_BODY = 4000
MARGIN = 1.0 + 1e-9  # allowance for the rounding of the positions of cells
AT_ONCE = 4096  # number of spheres that are accepted together, for about 10 MB of cells
CELLS_AT_ONCE = 16  # number of cells examined at a time; most candidates touch something in the first of these


class _Grid:
    """Cells of one edge length that cover a region, with a margin for all offsets."""

    def __init__(self, low: FloatArray, high: FloatArray, cell: float, reach: float) -> None:
        self.cell = cell
        margin = math.ceil(reach / cell) + 1
        self._low = low - margin * cell
        self.shape = np.ceil((high - low) / cell).astype(np.int64) + 2 * margin + 1

    @property
    def size(self) -> int:
        """The number of cells."""
        return math.prod(self.shape.tolist())

    def cells(self, position: FloatArray) -> IntArray:
        """Return the cell of each position, (k,)."""
        at = ((position - self._low) / self.cell).astype(np.int64)
        return np.asarray((at[:, 0] * self.shape[1] + at[:, 1]) * self.shape[2] + at[:, 2])

    def offsets(self, nearest: float, farthest: float) -> IntArray:
        """Return the offsets from a cell to the cells within a range, the nearest first.

        A point of one cell may be as close as ``nearest`` (m) to a point of the other, and no two such points are
        farther apart than ``farthest`` (m).
        """
        steps = math.ceil(nearest / self.cell) + 1
        line = np.arange(-steps, steps + 1)
        x, y, z = (axis.ravel() for axis in np.meshgrid(line, line, line, indexing="ij"))
        apart = [np.maximum(np.abs(axis) - 1, 0) * self.cell for axis in (x, y, z)]
        across = [(np.abs(axis) + 1) * self.cell for axis in (x, y, z)]
        chosen = sum(axis * axis for axis in apart) <= (nearest * MARGIN) ** 2
        chosen &= sum(axis * axis for axis in across) * MARGIN**2 <= farthest**2
        order = np.argsort((x * x + y * y + z * z)[chosen], kind="stable")
        return np.asarray(((x * self.shape[1] + y) * self.shape[2] + z)[chosen][order])


class Occupancy:
    """The accepted spheres of one size class, whose radii differ by less than a factor of two.

    ``low`` and ``high``, (3,) m, are corners of the region, and ``radius``, (n,) m, has the radii of the whole class.
    """

    def __init__(self, low: FloatArray, high: FloatArray, radius: FloatArray) -> None:
        self._smallest, reach = float(radius.min()), 2.0 * float(radius.max())
        self._coarse = _Grid(low, high, 2.0 * self._smallest / (math.sqrt(3.0) * MARGIN), reach)
        self._fine = _Grid(low, high, FINE_CELL * self._smallest, reach)
        self._around = self._coarse.offsets(reach, math.inf)
        self._covered = self._fine.offsets(reach, 2.0 * self._smallest)
        self._owner = np.full(self._coarse.size, -1, dtype=np.int32)
        self._taken = np.zeros(self._fine.size, dtype=np.bool_)
        self._position = np.empty((0, 3))
        self._radius = np.empty(0)

    @staticmethod
    def pays(low: FloatArray, high: FloatArray, radius: FloatArray) -> bool:
        """Return whether the grids are small enough for the memory, and worthwhile for the number of spheres."""
        cells = math.prod(((high - low) / (FINE_CELL * radius.min()) + 12.0).tolist())
        return bool(cells < min(MOST_CELLS, MOST_CELLS_PER_BODY * len(radius)))

    def add(self, position: FloatArray, radius: FloatArray) -> None:
        """Accept spheres, none of which touches an accepted sphere."""
        first = len(self._position)
        self._owner[self._coarse.cells(position)] = np.arange(first, first + len(position))
        cells = self._fine.cells(position)
        for lo in range(0, len(cells), AT_ONCE):
            self._taken[cells[lo : lo + AT_ONCE, None] + self._covered] = True
        self._position = np.concatenate((self._position, position))
        self._radius = np.concatenate((self._radius, radius))

    def touches(self, position: FloatArray, radius: FloatArray) -> BoolArray:
        """Return a mask (k,) of the candidates that touch or overlap an accepted sphere."""
        touching = self._taken[self._fine.cells(position)]
        left = np.flatnonzero(~touching)
        cells = self._coarse.cells(position[left])
        for first in range(0, len(self._around), CELLS_AT_ONCE):
            owner = self._owner[cells[:, None] + self._around[first : first + CELLS_AT_ONCE]]
            row, column = np.nonzero(owner >= 0)
            i, j = left[row], owner[row, column]
            hit = squared_distance(position[i], self._position[j], None) <= (radius[i] + self._radius[j]) ** 2
            touching[i[hit]] = True
            still = ~touching[left]
            left, cells = left[still], cells[still]
        return touching


CANDIDATES_PER_BODY = 1.2
MOST_ROUNDS = 400  # largest number of rounds of generating and filtering for one size class
MOST_DRAWN = 50_000_000  # largest number of candidates for one size class


def positions(
    mixture: Mapping[int, BodyGroup],
    region: Region,
    radius: FloatArray,
    around: Surroundings,
    rng: np.random.Generator,
    units: UnitSystem,
    dense: bool = False,
) -> FloatArray:
    """Implement `Arrange`: place the largest size class first, so that small spheres fill the gaps.

    If ``dense``, the spheres will grow, and messages do not suggest dense packing.
    """
    index = next(iter(mixture))
    refuse_too_large(index, region, radius, units)
    packing = float(np.sum((4.0 / 3.0) * math.pi * radius * radius * radius)) / volume(region)
    position = np.empty((len(radius), 3))
    for members in reversed(size_classes(radius)):
        position[members] = _place_class(index, region, radius[members], around, rng, packing, dense)
        around = around.beside(position[members], radius[members])
    return position


def scattered(
    mixture: Mapping[int, BodyGroup],
    region: Region,
    radius: FloatArray,
    around: Surroundings,
    rng: np.random.Generator,
    units: UnitSystem,
) -> FloatArray:
    """Implement `Arrange` for spheres that exist one after another, and may overlap each other."""
    index = next(iter(mixture))
    refuse_too_large(index, region, radius, units)
    position, missing = np.empty((len(radius), 3)), np.arange(len(radius))
    for _ in range(MOST_ROUNDS):
        position[missing] = drawn_centres(region, radius[missing], rng)
        missing = missing[~around.is_clear(position[missing], radius[missing])]
        if not len(missing):
            return position
    raise SceneError(
        f"group.{index}.region: no space for {len(missing)} of {len(radius)} bodies outside the planes and walls; move "
        "or enlarge the region",
        ("group", index, "region"),
    )


def _place_class(
    index: int,
    region: Region,
    radius: FloatArray,
    around: Surroundings,
    rng: np.random.Generator,
    packing: float,
    dense: bool,
) -> FloatArray:
    """Generate and filter one size class.

    The pool keeps the order of arrival; of two colliding candidates, the newer one is removed. No round therefore loses
    an accepted candidate. Each round tops the pool up to 1.2 n. A candidate has the radius of its body, ``owner``; only
    the first accepted candidate of each body is kept.
    """
    n = len(radius)
    pool, owner, missing = np.empty((0, 3)), np.empty(0, dtype=np.int64), np.arange(n)
    corners = bounds(region)
    box = None if around.box is None or _is_inside(corners, around.box) else around.box
    occupied = Occupancy(*corners, radius) if box is None and Occupancy.pays(*corners, radius) else None
    drawn = 0
    for _ in range(MOST_ROUNDS):
        if drawn > MOST_DRAWN:
            break
        drawn += math.ceil(CANDIDATES_PER_BODY * n) - len(owner)
        fresh_owner = np.resize(missing, math.ceil(CANDIDATES_PER_BODY * n) - len(owner))
        fresh = drawn_centres(region, radius[fresh_owner], rng)
        clear = around.is_clear(fresh, radius[fresh_owner])
        candidates, candidate_owner = fresh[clear], fresh_owner[clear]
        if occupied is None or len(pool) == 0:
            clean = _clean(pool, candidates, radius[owner], radius[candidate_owner], box)
        else:
            clean = _clean_beside(occupied, candidates, radius[candidate_owner])
        _, first = np.unique(candidate_owner[clean], return_index=True)
        kept = clean[np.sort(first)]
        if occupied is not None:
            occupied.add(candidates[kept], radius[candidate_owner[kept]])
        pool = np.concatenate((pool, candidates[kept]))
        owner = np.concatenate((owner, candidate_owner[kept]))
        placed = np.zeros(n, dtype=np.bool_)
        placed[owner] = True
        missing = np.flatnonzero(~placed)
        if len(missing) == 0:
            return pool[np.argsort(owner)]
    in_the_way = np.flatnonzero(np.all(around.solids.depth(fresh, radius[fresh_owner]) >= 0.0, axis=0))
    if len(in_the_way):
        names = " and ".join(around.solids.name[plane] for plane in in_the_way)
        raise SceneError(
            f"group.{index}.region: no space for the bodies outside {names}; move or enlarge the region",
            ("group", index, "region"),
        )
    denser = "" if region.shape == "plummer" else f', or set group.{index}.arrangement = "compressed"'
    if dense:
        denser = "; groups with the same region are compressed together" if around.spheres else ""
    remedy = f"enlarge the region, lower count or radius{denser}"
    if box is not None:
        remedy = f"the region extends beyond the periodic domain; set group.{index}.region within domain.size"
    raise SceneError(
        f"group.{index}: {len(missing)} of {n} bodies could not be placed within {MOST_ROUNDS} rounds (packing "
        f"fraction {packing:.3g}); {remedy}",
        ("group", index),
    )


def _is_inside(corners: tuple[FloatArray, FloatArray], box: FloatArray) -> bool:
    """Return whether a region is inside a periodic box, so that its spheres touch no images of each other."""
    low, high = corners
    return bool((low >= -0.5 * box).all() and (high <= 0.5 * box).all())


def _clean(
    pool: FloatArray, candidates: FloatArray, accepted: FloatArray, radius: FloatArray, box: FloatArray | None
) -> IntArray:
    """Return the candidates that touch no accepted sphere and no older candidate; the oldest candidates come first.

    ``pool``, (k, 3) m, and ``accepted``, (k,) m, are the centres and radii of the accepted spheres.
    """
    everyone = np.concatenate((pool, candidates))
    if len(everyone) == 0:
        return np.empty(0, dtype=np.int64)
    pairs = overlapping_pairs(everyone, np.concatenate((accepted, radius)), box)
    clean = np.ones(len(everyone), dtype=np.bool_)
    clean[pairs[:, 1]] = False
    return np.flatnonzero(clean[len(pool) :])


def _clean_beside(occupied: Occupancy, candidates: FloatArray, radius: FloatArray) -> IntArray:
    """Return the result of `_clean`, for open space, from the grids."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

    free = np.flatnonzero(~occupied.touches(candidates, radius))
    if len(free) == 0:
        return free
    reach = 2.0 * radius.max() * QUERY_MARGIN
    near = cKDTree(candidates[free]).sparse_distance_matrix(cKDTree(candidates), reach, output_type="ndarray")
    i, j = free[near["i"]], near["j"]
    i, j = i[j < i], j[j < i]
    hit = squared_distance(candidates[j], candidates[i], None) <= (radius[j] + radius[i]) ** 2
    clean = np.zeros(len(candidates), dtype=np.bool_)
    clean[free] = True
    clean[i[hit]] = False
    return np.flatnonzero(clean)


RANDOM = Arrangement(positions, lambda radius: FULLEST, "random placement jams at")
