"""Dense random packings: spheres that are placed small fly, bounce and grow to their size.

Random addition jams at a packing of 0.38. Here spheres begin at random places, small enough for a packing of 0.2. They
then grow at one relative rate while they fly straight and bounce elastically off each other, the border of the region,
planes and the bodies placed before (Lubachevsky & Stillinger 1990, J. Stat. Phys. 60, 561). The more often they bounce,
the slower they grow: at 1 radius/s they jam below 0.6. Equal spheres of a random close packing, 0.64, never cease to.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.errors import SceneError
from carom.physics.contact.broad_phase.hierarchical_grid import HierarchicalGrid
from carom.physics.contact.continuous.trajectories import both_ways
from carom.physics.periodic_box import minimum_images
from carom.physics.placement.growth_events import BORDER, SPHERE, fly
from carom.physics.placement.region import half_extent
from carom.physics.placement.surroundings import Surroundings
from carom.scene.portable_math import cube_root
from carom.scene.schema import Region

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

DENSEST = 0.62  # equal spheres jam at 0.634 to 0.64, and just below it takes very long
BY_SPREAD, BY_SKEWNESS = 0.0658, 0.0857  # see `densest`
LOOSE = 0.2  # packing of the random start
INFLATED = 1e-6  # of the radius: spheres grow a little too large, so that rounding leaves no overlap
SKIN = 0.3  # of the radius, that a sphere may move until neighbours are searched again
PASS = 0.1  # s, at most, until speeds are reset; they are 1 radius/s per axis
FASTEST, SLOWEST = 1.0, 1e-3  # 1/s, rates of growth
EASE = 10.0  # 1/s², the rate of growth times the impacts of a sphere per second
MOST_IMPACTS = 5000  # of a sphere, on the average; more is a jam
MOST_AT_ONCE = 30  # of a sphere, on the average, in a pass


def densest(radius: FloatArray) -> float:
    """Return the packing up to which spheres of these radii, (n,), are compressed.

    The random close packing of spheres of several sizes is, by simulation,

        0.634 + 0.0658 δ + 0.0857 S δ²

    with the standard deviation δ of the radii over their mean, and their skewness S (Desmond & Weeks 2014, Phys. Rev. E
    90, 022204). It is `DENSEST` for equal spheres here.
    """
    mean = float(radius.mean())
    apart = radius / mean - 1.0
    spread = math.sqrt(float(np.mean(apart * apart)))
    third = float(np.mean(apart * apart * apart))  # S δ³
    return DENSEST + max(0.0, BY_SPREAD * spread + (BY_SKEWNESS * third / spread if spread > 0.0 else 0.0))


def shrunken(radius: FloatArray, packing: float) -> FloatArray:
    """Return radii (n,) with which spheres are placed at first, given the packing at their full size."""
    return np.asarray(radius * _first_size(packing))


def _first_size(packing: float) -> float:
    return min(1.0, float(cube_root(np.array(LOOSE / packing))))


def grown(
    index: int,
    region: Region,
    position: FloatArray,
    radius: FloatArray,
    packing: float,
    around: Surroundings,
    rng: np.random.Generator,
) -> FloatArray:
    """Return centres, (n, 3) m, at which spheres of their full size do not overlap.

    Parameters
    ----------
    position
        Centres of the `shrunken` spheres, (n, 3) m.
    radius
        Full size, (n,) m.
    packing
        At full size.

    Raises
    ------
    SceneError
        If they jam before they have their size.
    """
    n, centre = len(radius), np.array(region.centre)
    box = np.zeros(3) if around.box is None else around.box
    fixed, fixed_radius = _in_reach(region, around)
    sphere = np.zeros(n + len(fixed), SPHERE)
    for k, axis in enumerate("xyz"):
        sphere[axis] = np.concatenate((position[:, k], fixed[:, k])) - centre[k]
        sphere[f"v{axis}"][:n] = radius * (2.0 * rng.random(n) - 1.0)
    sphere["radius"][n:] = fixed_radius
    sphere["skin"][:n] = SKIN * radius
    sphere["inverse_mass"][:n] = radius * radius  # speeds are then alike in radii per second
    border, queue = _borders(region, around), np.empty(n, dtype=np.int64)
    full, widest = 1.0 + INFLATED, float(max(radius.max(), fixed_radius.max(initial=0.0)))
    images = 1 if around.box is not None and box.min() < 4.0 * widest + 8.0 * SKIN * radius.max() else 0
    size, impacts, rate = _first_size(packing), 0, FASTEST
    while size < full:
        left = (full - size) / rate
        span = min(PASS, left)
        own = sphere[:n]
        own["radius"], own["growth"] = size * radius, rate * radius
        _reset_speeds(own, radius)
        ends, others = _neighbours(sphere, n, span, box)
        flown, count = fly(sphere, n, border, queue, ends, others, box, images, span, MOST_AT_ONCE * n)
        size = full if flown == left else size + rate * flown
        impacts += count
        rate = min(FASTEST, max(SLOWEST, EASE * n * flown / max(1, 2 * count)))
        if 2 * impacts > MOST_IMPACTS * n:
            raise SceneError(
                f"group.{index}: spheres jam at {size:.3g} of their radius; "
                "enlarge the region or lower count or radius",
                ("group", index, "region"),
            )
    return np.asarray(np.stack([sphere[axis][:n] for axis in "xyz"], axis=1) + centre)


def _in_reach(region: Region, around: Surroundings) -> tuple[FloatArray, FloatArray]:
    """Return the centres and radii of the spheres placed before that are near a region."""
    centres = np.concatenate([np.empty((0, 3)), *(centres for centres, _ in around.spheres)])
    radii = np.concatenate([np.empty(0), *(radii for _, radii in around.spheres)])
    apart = centres - np.array(region.centre)
    if around.box is not None:
        apart = minimum_images(apart, around.box)
    near = (np.abs(apart) <= half_extent(region) + radii[:, None]).all(axis=1)
    return centres[near], radii[near]


def _borders(region: Region, around: Surroundings) -> Records:
    """Return the borders of a region and the planes, relative to its centre."""
    half, (cx, cy, cz) = half_extent(region), region.centre
    flat = [
        (True, nx, ny, nz, o - (nx * cx + ny * cy + nz * cz), 0.0, False, False)
        for (nx, ny, nz), o in zip(around.solids.normal, around.solids.offset, strict=True)
    ]
    round_ = []
    if region.shape in ("box", "cylinder"):
        is_whole = around.box is not None and region.shape == "box" and bool(np.all(2.0 * half >= around.box))
        for k in () if is_whole else range(3) if region.shape == "box" else (2,):
            for side in (-1.0, 1.0):
                flat.append((True, *(side * (axis == k) for axis in range(3)), -half[k], 0.0, False, False))
    if region.shape != "box":
        round_.append((False, 0.0, 0.0, 0.0, 0.0, half[0], True, region.shape == "cylinder"))
    if region.inner_radius is not None:
        round_.append((False, 0.0, 0.0, 0.0, 0.0, region.inner_radius, False, False))
    return np.array(flat + round_, BORDER)


def _reset_speeds(sphere: Records, radius: FloatArray) -> None:
    """Scale velocities to 1 radius/s per axis, in the root mean square."""
    square = sum((sphere[f"v{axis}"] / radius) ** 2 for axis in "xyz")
    scale = math.sqrt(3.0 * len(sphere) / float(np.sum(square)))
    for axis in "xyz":
        sphere[f"v{axis}"] *= scale


def _neighbours(sphere: Records, movers: int, span: float, box: FloatArray) -> tuple[IntArray, IntArray]:
    """List the neighbours of each sphere, i's at ``others[ends[i]:ends[i + 1]]``."""
    reach = sphere["radius"] + span * sphere["growth"] + sphere["skin"]
    pairs = HierarchicalGrid(reach, box).pairs(np.stack([sphere[axis] for axis in "xyz"], axis=1))
    pairs = pairs[pairs[:, 0] < movers]
    ends, others = np.zeros(len(sphere) + 1, dtype=np.int64), np.empty(2 * len(pairs), dtype=np.int64)
    both_ways(pairs, ends, others)
    return ends, others
