"""Dense random packings: spheres that are placed small grow to their size and push each other apart.

Random addition jams at a packing of 0.38. Here spheres begin at random places, small enough for a packing of 0.2. At
their full size they then repel each other, the border of the region, planes and the bodies placed before by their
overlaps,

    E = Σ ½ δ²

until no overlap is left. The minimum is found by FIRE (Bitzek et al. 2006, PRL 97, 170201). Below random close packing,
0.64 for equal spheres, it has E = 0 (O'Hern et al. 2003, PRE 68, 011306).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.scene.error import SceneError
from carom.scene.neighbours import overlapping_pairs
from carom.scene.placement.region import confined
from carom.scene.placement.surroundings import Surroundings
from carom.scene.portable_math import cube_root
from carom.scene.schema import Region

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DENSEST = 0.62  # equal spheres jam at 0.64, and just below it takes very long
LOOSE = 0.2  # packing of the random start
INFLATED = 1e-6  # of the radius: spheres are relaxed a little too large, so that none overlaps in the end
SKIN = 0.2  # of the radius, within which neighbours are known
MOST_STEPS = 8000
FIRST_STEP, LONGEST_STEP = 0.1, 0.4  # in units of the period of a contact over 2π
LONGER, SHORTER, PATIENCE = 1.1, 0.5, 5  # FIRE: factors of the step, and downhill steps before it grows
MIXED, LESS_MIXED = 0.1, 0.99  # FIRE: part of the velocity that is turned downhill, and its decay


def shrunken(radius: FloatArray, packing: float) -> FloatArray:
    """Return radii (n,) with which spheres are placed at first, given the packing at their full size."""
    return np.asarray(radius * np.minimum(1.0, cube_root(np.array(LOOSE / packing))))


def compressed(
    index: int,
    region: Region,
    position: FloatArray,
    radius: FloatArray,
    around: Surroundings,
) -> FloatArray:
    """Return centres, (n, 3) m, at which spheres of their full size do not overlap, near given ones.

    Raises
    ------
    SceneError
        If overlaps are left in the end.
    """
    n, large = len(radius), radius * (1.0 + INFLATED)
    others = np.concatenate([np.empty((0, 3)), *(centres for centres, _ in around.spheres)])
    radii = np.concatenate((large, *(radii for _, radii in around.spheres)))
    x, v = position.copy(), np.zeros_like(position)
    pairs, listed = np.empty((0, 2), dtype=np.int64), np.full_like(position, np.inf)
    step, mixed, downhill = FIRST_STEP, MIXED, 0
    slack = SKIN * float(radius.min())
    for _ in range(MOST_STEPS):
        if _farthest(x - listed) > 0.5 * slack:
            everyone = np.concatenate((x, others))
            pairs = overlapping_pairs(everyone, radii + 0.5 * slack, around.box)
            pairs, listed = pairs[pairs[:, 0] < n], x.copy()
        force, deepest = _forces(x, large, np.concatenate((x, others)), radii, pairs, region, around)
        if deepest < 0.5 * INFLATED:
            return x
        power = float((force * v).sum())
        if power > 0.0:
            size, push = float((v * v).sum()), float((force * force).sum())
            v = (1.0 - mixed) * v + mixed * math.sqrt(size / push) * force
            downhill += 1
            if downhill > PATIENCE:
                step, mixed = min(LONGEST_STEP, LONGER * step), LESS_MIXED * mixed
        else:
            v, step, mixed, downhill = np.zeros_like(v), SHORTER * step, MIXED, 0
            step = max(step, 1e-3)
        v = v + step * force
        x = x + step * v
    raise SceneError(
        f"group.{index}: spheres still overlap by {deepest:.2g} of a radius after {MOST_STEPS} steps of compression; "
        "enlarge the region or lower count or radius"
    )


def _is_whole(region: Region, box: FloatArray | None) -> bool:
    """Tell whether a region fills a periodic box, so that it has no border."""
    return box is not None and region.shape == "box" and bool(np.all(np.array(region.size) >= box))


def _farthest(moved: FloatArray) -> float:
    return float(np.sqrt((moved * moved).sum(axis=1).max()))


def _forces(
    x: FloatArray,
    radius: FloatArray,
    everyone: FloatArray,
    radii: FloatArray,
    pairs: IntArray,
    region: Region,
    around: Surroundings,
) -> tuple[FloatArray, float]:
    """Return the push on each sphere in m, (n, 3), and the deepest overlap in radii."""
    i, j, box = pairs[:, 0], pairs[:, 1], around.box
    d = everyone[j] - everyone[i]
    if box is not None:
        d -= box * np.round(d / box)
    distance = np.sqrt((d * d).sum(axis=1))
    overlap = np.maximum(0.0, radii[i] + radii[j] - distance)
    push = d * (overlap / np.where(distance > 0.0, distance, 1.0))[:, None]
    force = np.empty_like(x)
    for axis in range(3):
        force[:, axis] = -np.bincount(i, push[:, axis], len(everyone))[: len(x)]
        force[:, axis] += np.bincount(j, push[:, axis], len(everyone))[: len(x)]
    back = np.zeros_like(x) if _is_whole(region, box) else confined(region, x, radius) - x
    force += back
    deepest = max(
        float((overlap / np.minimum(radii[i], radii[j])).max(initial=0.0)),
        float((np.sqrt((back * back).sum(axis=1)) / radius).max()),
    )
    for N, o in zip(around.solids.normal, around.solids.offset, strict=True):  # not by BLAS, whose rounding varies
        depth = np.maximum(0.0, radius - (x[:, 0] * N[0] + x[:, 1] * N[1] + x[:, 2] * N[2] - o))
        force += depth[:, None] * N
        deepest = max(deepest, float((depth / radius).max()))
    return force, deepest
