"""Spheres at random places without overlaps.

Candidates are generated, 1.2 a body, and filtered: a broad phase by grids or k-d trees, then the exact test. Those that
collide are replaced by new ones until each body has one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.errors import SceneError
from carom.physics.placement.neighbours import QUERY_MARGIN, overlapping_pairs, size_classes, squared_distance
from carom.physics.placement.occupancy import Occupancy
from carom.physics.placement.region import bounds, drawn_centres, volume
from carom.physics.placement.surroundings import Surroundings
from carom.scene.schema import Region

FloatArray = NDArray[np.float64]

CANDIDATES_PER_BODY = 1.2
MOST_ROUNDS = 400  # of generating and filtering, for one size class
MOST_DRAWN = 50_000_000  # candidates, for one size class


def positions(
    index: int,
    region: Region,
    radius: FloatArray,
    around: Surroundings,
    rng: np.random.Generator,
    dense: bool = False,
) -> FloatArray:
    """Place spheres of given radii, the largest size class first, so that small ones fill the gaps.

    ``dense`` says that they will grow, so that a message does not propose it.
    """
    packing = float(np.sum((4.0 / 3.0) * math.pi * radius * radius * radius)) / volume(region)
    position = np.empty((len(radius), 3))
    for members in reversed(size_classes(radius)):
        position[members] = _place_class(index, region, radius[members], around, rng, packing, dense)
        around = around.beside(position[members], radius[members])
    return position


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

    The pool keeps the order of arrival, and of two candidates that collide the newer one is removed. An accepted
    candidate therefore stays, and no round loses one. Each round tops the pool up to 1.2 n. ``owner`` is the body whose
    radius a candidate has; only the first accepted candidate of each body is kept.
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
            f"group.{index}.region: no room for the bodies outside {names}; move the region or enlarge it",
            ("group", index, "region"),
        )
    denser = "" if region.shape == "plummer" else f', or set group.{index}.arrangement = "compressed"'
    if dense:
        denser = "; groups with the same region are compressed together" if around.spheres else ""
    raise SceneError(
        f"group.{index}: {len(missing)} of {n} bodies found no room within {MOST_ROUNDS} rounds of "
        f"placement (packing fraction {packing:.3g}); enlarge the region, lower count or radius{denser}",
        ("group", index),
    )


def _is_inside(corners: tuple[FloatArray, FloatArray], box: FloatArray) -> bool:
    """Tell whether a region is inside a periodic box: spheres in it then touch none of each other's images."""
    low, high = corners
    return bool((low >= -0.5 * box).all() and (high <= 0.5 * box).all())


def _clean(
    pool: FloatArray, candidates: FloatArray, accepted: FloatArray, radius: FloatArray, box: FloatArray | None
) -> NDArray[np.int64]:
    """Return the candidates that touch no accepted sphere and no older candidate.

    Parameters
    ----------
    pool, accepted
        Centres and radii of the accepted spheres, (k, 3) and (k,) m.
    candidates, radius
        Centres and radii of the candidates, the oldest first.
    """
    everyone = np.concatenate((pool, candidates))
    if len(everyone) == 0:
        return np.empty(0, dtype=np.int64)
    pairs = overlapping_pairs(everyone, np.concatenate((accepted, radius)), box)
    clean = np.ones(len(everyone), dtype=np.bool_)
    clean[pairs[:, 1]] = False
    return np.flatnonzero(clean[len(pool) :])


def _clean_beside(occupied: Occupancy, candidates: FloatArray, radius: FloatArray) -> NDArray[np.int64]:
    """Return the same as `_clean` in open space."""
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
