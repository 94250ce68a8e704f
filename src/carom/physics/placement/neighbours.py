"""Overlapping spheres, and the surroundings of a group: a broad phase with k-d trees, then the vectorised exact test.

A k-d tree queried at twice the largest radius returns n² candidates as soon as one body is huge. Bodies are
therefore sorted into size classes, each spanning a factor of two in radius, with a tree for each class; a pair of
classes is queried at the sum of its two largest radii.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import SceneError
from carom.scene.portable_math import ENDLESS
from carom.scene.start import HalfSpaces

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


ALL_PAIRS_UP_TO = 64  # number of bodies up to which importing SciPy takes longer than testing all pairs
MOST_CANDIDATES = 5_000_000  # largest number of candidate pairs; each takes about 100 bytes, with copies
CANDIDATES_PER_BODY = 30  # spheres of radii r to 2 r that fill 0.74 of space have at most 24 neighbours within 4 r
# the tree compares rounded distances, so it is queried slightly farther, and the exact test follows
QUERY_MARGIN = 1.0 + 1e-9


def overlapping_pairs(position: FloatArray, radius: FloatArray, box: FloatArray | None = None) -> IntArray:
    """Return all pairs of spheres that touch or overlap, (m, 2) indices with i < j, sorted by (i, j).

    ``box`` is the size of a periodic domain about the origin, (3,) m, or None for open space. Raises SceneError if
    there are more than `MOST_CANDIDATES` pairs to test, and more than `CANDIDATES_PER_BODY` for each body.
    """
    candidates = np.concatenate([_EMPTY, *_candidates(position, radius, box)])
    candidates.sort(axis=1)
    i, j = candidates[:, 0], candidates[:, 1]
    with np.errstate(over="ignore"):  # the squared distance of very distant bodies may be infinite
        touching = squared_distance(position[i], position[j], box) <= (radius[i] + radius[j]) ** 2
    pairs = candidates[touching]
    return np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def squared_distance(a: FloatArray, b: FloatArray, box: FloatArray | None) -> FloatArray:
    """Return the squared distances between rows of (m, 3) arrays, to the nearest images in a periodic box."""
    separation = b - a
    if box is not None:
        separation -= box * np.round(separation / box)
    x, y, z = separation.T
    return np.asarray(x * x + y * y + z * z)


def wrapped(position: FloatArray, box: FloatArray | None) -> FloatArray:
    """Return positions in [0, box) along the axes that repeat, as a periodic k-d tree needs them."""
    if box is None:
        return position
    inside = np.where(box < ENDLESS, np.mod(position, box), position)
    return np.where(inside >= box, 0.0, inside)  # np.mod rounds a tiny negative number up to the box itself


def periods(box: FloatArray | None) -> FloatArray | None:
    """Return a periodic domain as `boxsize` of a k-d tree, where 0 stands for an axis that does not repeat."""
    return None if box is None else np.where(box < ENDLESS, box, 0.0)


def size_classes(radius: FloatArray) -> list[NDArray[np.intp]]:
    """Group indices by radius, each class spanning less than a factor of two, smallest radii first."""
    octave = np.floor(np.log2(radius / radius.min())).astype(np.int64)
    return [np.flatnonzero(octave == value) for value in np.unique(octave)]


_EMPTY = np.empty((0, 2), dtype=np.int64)


def _candidates(position: FloatArray, radius: FloatArray, box: FloatArray | None) -> list[IntArray]:
    """Return pairs that may overlap, from every pair of size classes."""
    if len(radius) <= ALL_PAIRS_UP_TO:
        return [np.column_stack(np.triu_indices(len(radius), 1))]
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

    inside = wrapped(position, box)
    classes = size_classes(radius)
    trees = [cKDTree(inside[members], boxsize=periods(box)) for members in classes]
    reach = [radius[members].max() for members in classes]
    if len(radius) * (len(radius) - 1) // 2 > MOST_CANDIDATES:
        _refuse_crowds(trees, reach)
    found = []
    for k, members in enumerate(classes):
        pairs = trees[k].query_pairs(2 * reach[k] * QUERY_MARGIN, output_type="ndarray")
        found.append(members[pairs])
    for k, other in itertools.combinations(range(len(classes)), 2):
        near = trees[k].sparse_distance_matrix(
            trees[other], (reach[k] + reach[other]) * QUERY_MARGIN, output_type="ndarray"
        )
        found.append(np.column_stack((classes[k][near["i"]], classes[other][near["j"]])))
    return found


def _refuse_crowds(trees: list[cKDTree], reach: list[float]) -> None:
    """Refuse too many candidates, which are counted without listing them."""
    count = 0
    for k, other in itertools.combinations_with_replacement(range(len(trees)), 2):
        near = int(trees[k].count_neighbors(trees[other], (reach[k] + reach[other]) * QUERY_MARGIN))
        count += (near - trees[k].n) // 2 if k == other else near
    if count > max(MOST_CANDIDATES, CANDIDATES_PER_BODY * sum(int(tree.n) for tree in trees)):
        raise SceneError(
            f"{count:.3g} pairs of bodies overlap or nearly overlap at the start; place them farther apart"
        )


@dataclass(frozen=True)
class Surroundings:
    """Planes, walls and spheres, in open space or in a periodic box."""

    spheres: tuple[tuple[FloatArray, FloatArray], ...]  # centres (n, 3) and radii (n,), in m
    solids: HalfSpaces
    box: FloatArray | None  # (3,) m

    def beside(self, centres: FloatArray, radii: FloatArray) -> Surroundings:
        """Return these surroundings with more spheres."""
        return replace(self, spheres=(*self.spheres, (centres, radii)))

    def is_clear(self, position: FloatArray, radius: FloatArray) -> BoolArray:
        """Return a mask (k,) of the spheres that touch nothing in these surroundings."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

        clear: BoolArray = np.all(self.solids.depth(position, radius) < 0.0, axis=1)
        if not self._trees or len(position) == 0:  # a wide lattice may have no point in a region
            return clear
        own = cKDTree(wrapped(position, self.box), boxsize=periods(self.box))
        for tree, centres, radii in self._trees:
            reach = (radius.max() + radii.max()) * QUERY_MARGIN
            near = own.sparse_distance_matrix(tree, reach, output_type="ndarray")
            i, j = near["i"], near["j"]
            hit = squared_distance(position[i], centres[j], self.box) <= (radius[i] + radii[j]) ** 2
            clear[i[hit]] = False
        return clear

    @cached_property
    def _trees(self) -> list[tuple[cKDTree, FloatArray, FloatArray]]:
        """A tree for each size class of spheres, with their centres and radii."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

        return [
            (cKDTree(wrapped(centres[same], self.box), boxsize=periods(self.box)), centres[same], radii[same])
            for centres, radii in self.spheres
            for same in size_classes(radii)
        ]
