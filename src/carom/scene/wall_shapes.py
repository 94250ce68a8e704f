"""Shapes of walls: surfaces that bodies cannot pass through, besides planes.

A shape is one module: its section in the scene, and the function that finds contacts with it. The name of a [[wall]]'s
section [wall.NAME] selects its shape.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from carom import registry
from carom.arrays import FloatArray, IntArray
from carom.scene.installed_forces import numbers_of
from carom.scene.units.system import UnitSystem

CONTENT = "content"  # key of a section in which carom keeps the data that a shape has read from a file
SIDES = 96  # edges around a drawn surface of revolution


NO_LINES: IntArray = np.empty((0, 2), np.int64)
_MERIDIANS, _PARALLELS = 12, 8  # drawn lines of a curved surface of revolution


class Mesh(NamedTuple):
    """The triangles that show a wall."""

    corners: FloatArray  # (k, 3) m
    triangles: IntArray  # (t, 3) into `corners`
    lines: IntArray = NO_LINES  # (l, 2) into `corners`: drawn, so that a curved surface does not look flat


class Facets(NamedTuple):
    """The flat parts of a wall; for contacts, each facet is a wall of its own."""

    triangles: FloatArray  # (f, 3, 3) m, their corners
    fields: Mapping[str, FloatArray]  # (f,) each, the fields of p by name, in SI units


def depends_on_all(section: Any, axis: int, period: float) -> Mapping[str, float] | None:
    """Return None: the distance from a wall depends on each coordinate."""
    return None


@dataclass(frozen=True, slots=True)
class WallShape:
    """A shape of a wall.

    carom compiles ``nearest`` with Numba, like the functions of a `carom.extend.BodyForce`. If a shape needs kernels of
    its own, ``nearest`` and ``touches`` are texts "module:function", so that reading a scene loads no compiler.

    The last result of ``nearest``, the focal distance, bounds the curvature. If a level surface of the distance curves
    towards the bodies, its centres of curvature are farther from the point than the focal distance. The focal distance
    is infinite if no level surface curves towards the bodies.
    """

    section: type[Any]  # section in a scene: a `carom.extend.Section` whose docstring says "[wall.NAME]: what it is"
    nearest: Callable[..., tuple[float, float, float, float, float]] | str  # (p, x, y, z) → the unit normal that points
    # from the nearest point of the wall to the bodies, (3,); the distance in m, negative behind it; the focal distance
    # in m
    mesh: Callable[[Any, FloatArray, float], Mesh]  # (section, centre, reach) → the wall within about reach of centre
    fields: tuple[str, ...]  # names of the fields of p
    parameters: Callable[[Any], Mapping[str, float]] = numbers_of  # (section) → the fields by name, in SI units
    flat: bool = False  # whether no level surface curves towards the bodies, so that the focal distance is infinite
    thin: bool = False  # whether bodies may be on both sides, so that the distance is never negative
    axis: Callable[[Any], tuple[FloatArray, FloatArray]] | None = None  # (section) → the axis of a surface of
    # revolution, about which the wall may rotate: a point in m, and the direction
    periodic: Callable[[Any, int, float], Mapping[str, float] | None] = depends_on_all  # (section, axis, period in m)
    # → the fields to change where space repeats along an axis; None if the distance then depends on that coordinate
    facets: Callable[[Any], Facets] | None = None  # (section) → the facets of a wall that consists of many; ``nearest``
    # is then the function of a single facet
    touches: Callable[..., bool] | str | None = None  # (surface, facet, x, y, z) → whether the wall's point nearest to
    # (x, y, z) belongs to this facet and to no neighbour; ``surface`` has p of each facet, and ``facet`` is its number
    read: Callable[[Path, str], str] | None = None  # (path, its name in messages) → the content of the file that the
    # section names with its key ``file``; carom keeps it in the section's key `CONTENT`
    doubts: Callable[[Any, float, UnitSystem], list[str]] | None = None  # (section, median radius of the bodies in m,
    # units of the scene) → a sentence for each probable mistake


def function_of(given: Callable[..., Any] | str) -> Callable[..., Any]:
    """Return a function of a shape, given as the function itself or as "module:function"."""
    function: Callable[..., Any] = registry.imported(given) if isinstance(given, str) else given
    return function


def shape_called(name: str) -> WallShape:
    """Return a shape of walls by its name; raises `ExtensionError` if it cannot be loaded."""
    shape: WallShape = registry.load("walls", name)
    return shape


def unit_vector(direction: tuple[float, float, float]) -> FloatArray:
    """Return a direction with length 1, (3,)."""
    # first divided by the largest component, so that nothing can overflow
    scaled = np.array(direction) / np.max(np.abs(direction))
    return np.asarray(scaled / np.sqrt((scaled * scaled).sum()))


def across(axis: FloatArray) -> FloatArray:
    """Return a unit vector at right angles to ``axis``, (3,)."""
    other = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    return np.asarray(other / np.sqrt((other * other).sum()))


def mesh_of_revolution(point: FloatArray, axis: FloatArray, profile: Sequence[tuple[float, float]]) -> Mesh:
    """Return the surface of revolution of a line of points.

    Parameters
    ----------
    point, axis
        The axis: one of its points, (3,) m, and its direction, (3,), a unit vector.
    profile
        The points of the line: the distance (m) from the axis, and the height (m) along it above ``point``.
    """
    one = across(axis)
    angles = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)[:, None]
    around = np.cos(angles) * one + np.sin(angles) * np.cross(axis, one)
    corners = np.concatenate([point + height * axis + radius * around for radius, height in profile])
    first = np.arange(SIDES)
    ring = np.stack((first, (first + 1) % SIDES, first + SIDES, (first + 1) % SIDES + SIDES), axis=1)
    corner = np.concatenate([ring + k * SIDES for k in range(len(profile) - 1)])
    rings, lines = len(profile), NO_LINES
    if rings > 2:  # otherwise, its borders show its shape
        parallels = np.arange(0, rings, max(1, rings // _PARALLELS))[1:, None] * SIDES
        meridians = np.arange(0, SIDES, SIDES // _MERIDIANS) + np.arange(rings - 1)[:, None] * SIDES
        hoops = np.stack((parallels + first, parallels + (first + 1) % SIDES), axis=2).reshape(-1, 2)
        lines = np.concatenate((hoops, np.stack((meridians, meridians + SIDES), axis=2).reshape(-1, 2)))
    return Mesh(corners, np.concatenate((corner[:, [0, 1, 2]], corner[:, [1, 3, 2]])), lines)
