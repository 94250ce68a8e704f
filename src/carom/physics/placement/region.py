"""The region of a group: its volume, its packing, and random centres inside it; the interface of arrangements."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from carom import registry
from carom.arrays import BoolArray, FloatArray
from carom.errors import SceneError
from carom.scene.matter import mean_volume
from carom.scene.portable_math import cube_root
from carom.scene.schema import LARGEST, BodyGroup, Region
from carom.scene.units.dimension import LENGTH
from carom.scene.units.system import UnitSystem

if TYPE_CHECKING:
    from carom.physics.placement.neighbours import Surroundings

DEFAULT_PACKING = 0.1  # packing fraction of a group without a region
LEAST_SIZE = 1.01  # smallest default region, in radii of the largest body, so that this body can be placed
FARTHEST = 10.0  # default radius of a plummer region, in its scale; the region contains 98.5 % of the mass
ROUNDING = 1e-12  # rounding relative to the size of a region


class Arrange(Protocol):
    """Finds centres at which the spheres of groups overlap nothing."""

    def __call__(
        self,
        mixture: Mapping[int, BodyGroup],
        region: Region,
        radius: FloatArray,
        around: Surroundings,
        rng: np.random.Generator,
        units: UnitSystem,
    ) -> FloatArray:
        """Return the centres, (n, 3) m, for the radii of all groups, (n,) m.

        Raises
        ------
        SceneError
            If the spheres do not fit.
        """


class Arrangement(NamedTuple):
    """An arrangement of groups, listed in `carom.registry` under its name in scenes."""

    arrange: Arrange
    fullest: Callable[[FloatArray], float]  # largest packing fraction for given radii (n,); inf if unknown
    limit: str = ""  # beginning of the message that states the largest packing fraction


class PlummerModel(NamedTuple):
    """Functions of Plummer's model of a star cluster; see `carom.physics.placement.plummer`."""

    mass_within: Callable[[float, float], float]
    drawn_distances: Callable[[float, float, int, np.random.Generator], FloatArray]
    drawn_velocities: Callable[[FloatArray, float, float, float, np.random.Generator], FloatArray]


def arrangement_called(name: str) -> Arrangement:
    """Return an arrangement by its name; SceneError if it has been removed."""
    found: Arrangement = registry.load("placements", name)
    return found


def plummer() -> PlummerModel:
    """Return Plummer's model; SceneError if it has been removed."""
    found: PlummerModel = registry.load("placements", "plummer")
    return found


def packing_fraction(group: BodyGroup) -> float:
    """Return the expected volume of a group's spheres, divided by the volume of its region."""
    if group.region is None:
        return DEFAULT_PACKING
    return mean_volume(group) * group.count / volume(group.region)


def volume(region: Region) -> float:
    """Return the volume of a region in m³; for Plummer's model, its mass divided by its central density."""
    radius = 0.0 if region.radius is None else region.radius
    match region.shape:
        case "box":
            return math.prod(region.size or ())
        case "cylinder":
            return math.pi * radius * radius * (region.height or 0.0)
        case "shell":
            return 4.0 / 3.0 * math.pi * (_cube(radius) - _cube(region.inner_radius or 0.0))
        case "plummer":
            scale, cut = plummer_lengths(region)
            return 4.0 / 3.0 * math.pi * _cube(scale) * plummer().mass_within(cut, scale)
    return 4.0 / 3.0 * math.pi * _cube(radius)


def _cube(x: float) -> float:
    return x * x * x


def plummer_lengths(region: Region) -> tuple[float, float]:
    """Return the scale of a plummer region and the largest distance of a centre, in m."""
    scale = region.scale or 0.0
    return scale, FARTHEST * scale if region.radius is None else region.radius


def bounds(region: Region) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper corner of the box around a region, (3,) m each."""
    half = half_extent(region)
    return np.array(region.centre) - half, np.array(region.centre) + half


def half_extent(region: Region) -> FloatArray:
    """Return half of the size of the box around a region, (3,) m."""
    match region.shape:
        case "box":
            return 0.5 * np.array(region.size)
        case "cylinder":
            radius = region.radius or 0.0
            return np.array([radius, radius, 0.5 * (region.height or 0.0)])
        case "plummer":
            return np.full(3, plummer_lengths(region)[1])
    return np.full(3, region.radius)


def contains(region: Region, position: FloatArray, radius: float) -> BoolArray:
    """Return a mask (k,) of the spheres of one radius inside a region, up to rounding."""
    outside = confined(region, position, np.full(len(position), radius)) - position
    return np.asarray((np.abs(outside) <= ROUNDING * half_extent(region)).all(axis=1))


def confined(region: Region, position: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the nearest centres at which spheres are inside a region, (n, 3) m."""
    offset = position - np.array(region.centre)
    if region.shape == "box":
        most = half_extent(region) - radius[:, None]
        return np.asarray(np.array(region.centre) + np.clip(offset, -most, most))
    radial = 2 if region.shape == "cylinder" else 3
    distance = np.sqrt((offset[:, :radial] * offset[:, :radial]).sum(axis=1))
    farthest = np.maximum(0.0, half_extent(region)[0] - radius)
    nearest = (region.inner_radius + radius) if region.inner_radius is not None else np.zeros(len(radius))
    right = np.minimum(np.maximum(distance, nearest), farthest)
    offset[:, :radial] *= (right / np.where(distance > 0.0, distance, 1.0))[:, None]
    if region.shape == "cylinder":
        most = half_extent(region)[2] - radius
        offset[:, 2] = np.clip(offset[:, 2], -most, most)
    return np.asarray(np.array(region.centre) + offset)


def default_region(index: int, radius: FloatArray, units: UnitSystem) -> Region:
    """Return a ball with the packing fraction `DEFAULT_PACKING`."""
    with np.errstate(over="ignore"):
        volume = np.asarray(np.sum(radius * radius * radius) / DEFAULT_PACKING)
        size = float(max(cube_root(volume), LEAST_SIZE * radius.max()))
    if size > LARGEST:
        most = units.text(LARGEST, LENGTH, "g")
        raise SceneError(
            f"group.{index}: bodies of this size need a region larger than {most}; lower the radius", ("group", index)
        )
    return Region(radius=size)


def refuse_too_large(index: int, region: Region, radius: FloatArray, units: UnitSystem) -> None:
    """Refuse bodies larger than their region."""
    largest = float(half_extent(region).min())
    if region.inner_radius is not None:
        largest = 0.5 * (largest - region.inner_radius)
    if radius.max() > largest:
        size = units.text(float(radius.max()), LENGTH, "g")
        raise SceneError(
            f"group.{index}: a body of radius {size} does not fit into its region; enlarge the region",
            ("group", index, "region"),
        )


def drawn_centres(region: Region, radius: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw centres uniformly so that every sphere lies inside the region."""
    n = len(radius)
    match region.shape:
        case "box":
            offset = (rng.random((n, 3)) - 0.5) * (np.array(region.size) - 2 * radius[:, None])
        case "cylinder":
            across = rng.standard_normal((n, 2))
            across /= np.sqrt((across * across).sum(axis=1))[:, None]
            farthest, height = half_extent(region)[0] - radius, (region.height or 0.0) - 2 * radius
            offset = np.empty((n, 3))
            offset[:, :2] = across * (farthest * np.sqrt(rng.random(n)))[:, None]
            offset[:, 2] = (rng.random(n) - 0.5) * height
        case "shell":
            inner, outer = (region.inner_radius or 0.0) + radius, half_extent(region)[0] - radius
            inner, outer = inner * inner * inner, outer * outer * outer
            offset = _directions(n, rng) * cube_root(inner + (outer - inner) * rng.random(n))[:, None]
        case "plummer":
            offset = _directions(n, rng) * plummer().drawn_distances(*plummer_lengths(region), n, rng)[:, None]
        case _:
            offset = _directions(n, rng) * ((half_extent(region)[0] - radius) * cube_root(rng.random(n)))[:, None]
    return np.array(region.centre) + offset


def _directions(count: int, rng: np.random.Generator) -> FloatArray:
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction
