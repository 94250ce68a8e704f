"""The region of a group: its volume, how full it is, and random centres inside it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.scene.error import SceneError
from carom.scene.placement.matter import mean_volume
from carom.scene.portable_math import cube_root
from carom.scene.schema import LARGEST, Group, Region

FloatArray = NDArray[np.float64]

DEFAULT_PACKING = 0.1  # of a group without a region


def packing_fraction(group: Group) -> float:
    """Return the expected volume of a group's spheres over the volume of its region."""
    if group.region is None:
        return DEFAULT_PACKING
    return mean_volume(group) * group.count / volume(group.region)


def volume(region: Region) -> float:
    """Return the volume of a region in m³."""
    if region.radius is not None:
        return 4.0 / 3.0 * math.pi * region.radius**3
    return math.prod(region.size or ())


def bounds(region: Region) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper corner of the box around a region, (3,) m each."""
    half = np.full(3, region.radius) if region.radius is not None else 0.5 * np.array(region.size)
    return np.array(region.centre) - half, np.array(region.centre) + half


def default_region(index: int, radius: FloatArray) -> Region:
    """Return a ball that is `DEFAULT_PACKING` full."""
    with np.errstate(over="ignore"):
        volume = np.asarray(np.sum(radius * radius * radius) / DEFAULT_PACKING)
        room = float(max(cube_root(volume), 1.01 * radius.max()))
    if room > LARGEST:
        raise SceneError(f"group.{index}: bodies so large need a region of more than {LARGEST:g} m; lower the radius")
    return Region(radius=room)


def refuse_too_large(index: int, region: Region, radius: FloatArray) -> None:
    """Refuse bodies larger than their region."""
    room = region.radius if region.radius is not None else min(region.size or ()) / 2
    if radius.max() > room:
        raise SceneError(
            f"group.{index}: a body of radius {radius.max():g} m does not fit into its region; enlarge the region"
        )


def drawn_centres(region: Region, radius: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw centres uniformly so that every sphere lies inside the region."""
    n = len(radius)
    if region.radius is not None:
        direction = rng.standard_normal((n, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        offset = direction * ((region.radius - radius) * cube_root(rng.random(n)))[:, None]
    else:
        offset = (rng.random((n, 3)) - 0.5) * (np.array(region.size) - 2 * radius[:, None])
    return np.array(region.centre) + offset
