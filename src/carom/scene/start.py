"""The initial bodies and the static half-spaces of a scene, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.scene.load import Scene
from carom.scene.wall_shapes import shape_called, unit_vector
from carom.scene.wording import joined


@dataclass(frozen=True)
class InitialBodies:
    """The initial bodies in SI units: explicit bodies first, then bodies from data, then groups."""

    name: Sequence[str]
    group: IntArray  # (n,) index of each body's group; -1 for explicit bodies; -2, -3 … for [[bodies]] tables
    position: FloatArray  # (n, 3)
    velocity: FloatArray  # (n, 3)
    angular_velocity: FloatArray  # (n, 3)
    mass: FloatArray  # (n,)
    radius: FloatArray  # (n,)
    inertia: FloatArray  # (n,)
    fixed: BoolArray  # (n,)


class EntryStates(NamedTuple):
    """The states with which bodies enter or, if they exist from the start, begin."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    angular_velocity: FloatArray  # (n, 3) rad/s


def join(parts: list[InitialBodies]) -> InitialBodies:
    """Return the bodies of all parts, in order."""
    arrays: dict[str, Any] = {
        field.name: np.ascontiguousarray(np.concatenate([getattr(part, field.name) for part in parts]))
        for field in fields(InitialBodies)
        if field.name != "name"
    }
    return InitialBodies(joined([part.name for part in parts]), **arrays)


WALLS = (
    ("wall at -x", (1.0, 0.0, 0.0)),
    ("wall at +x", (-1.0, 0.0, 0.0)),
    ("wall at -y", (0.0, 1.0, 0.0)),
    ("wall at +y", (0.0, -1.0, 0.0)),
    ("wall at -z", (0.0, 0.0, 1.0)),
    ("wall at +z", (0.0, 0.0, -1.0)),
)


@dataclass(frozen=True)
class HalfSpaces:
    """p solid half-spaces; bodies are where ``normal · x > offset``."""

    name: list[str]
    normal: FloatArray  # (p, 3) unit normals that point out of the solid
    offset: FloatArray  # (p,) m

    def __len__(self) -> int:
        return len(self.offset)

    @property
    def owner(self) -> IntArray:
        """The number of the plane or wall of each end of a contact; a facet has the number of its wall."""
        return np.arange(len(self))

    @property
    def driven(self) -> BoolArray:
        """Which ends of contacts have a prescribed motion, in the order of `owner`."""
        return np.zeros(len(self.owner), dtype=np.bool_)

    @property
    def surface(self) -> FloatArray:
        """The array from which kernels find tangent planes, together with `offset`."""
        return self.normal

    @property
    def moves(self) -> bool:
        """Whether any plane or wall moves."""
        return self.rotates or self.translates

    @property
    def has_facets(self) -> bool:
        """Whether a wall consists of facets, which are then the ends of contacts."""
        return False

    @property
    def rotates(self) -> bool:
        """Whether the surface of any plane or wall moves along itself."""
        return False

    @property
    def translates(self) -> bool:
        """Whether any plane or wall changes its place."""
        return False

    @property
    def largest_acceleration(self) -> float:
        """The largest acceleration of any plane or wall at any time, in m/s²."""
        return 0.0

    @property
    def guided(self) -> Any:
        """The planes that contacts move; None if there are none."""
        return None

    @property
    def takes_colours(self) -> bool:
        """Whether contacts move a plane or wall, so that all its contacts need colours of their own."""
        return self.guided is not None

    @property
    def spin(self) -> FloatArray:
        """The angular velocity of each plane and wall, (p, 3) rad/s."""
        return np.zeros((len(self), 3))

    @property
    def press_alone(self) -> bool:
        """Whether only the curvature or the acceleration of walls presses bodies onto them."""
        return False

    @property
    def curves(self) -> bool:
        """Whether there is a [[wall]], which may be curved."""
        return False

    def depth(self, position: FloatArray, radius: FloatArray) -> FloatArray:
        """Return the depth of spheres in each half-space, (n, p) m; the depth is negative outside."""
        return np.asarray(radius[:, None] - ((position[:, None] * self.normal).sum(axis=2) - self.offset))

    def heights(self, position: FloatArray) -> FloatArray:
        """Return the heights of points above each half-space, (n, p) m; summed here, since rounding in BLAS varies."""
        N = self.normal
        heights = -self.offset + position[:, :1] * N[:, 0]
        return np.asarray(heights + position[:, 1:2] * N[:, 1] + position[:, 2:] * N[:, 2])

    def advanced(self, start: FloatArray, crossed: BoolArray) -> FloatArray:
        """Return the starts of paths, (k, 3) m, in the present frames of the solids that the paths cross, (k, p)."""
        return start

    def heights_before(self, position: FloatArray) -> FloatArray:
        """Return the heights at the beginning of the step."""
        return self.heights(position)


def planes_of(scene: Scene) -> HalfSpaces:
    """Return the planes of a scene, in their order."""
    normals = [unit_vector(plane.normal) for plane in scene.plane]
    return HalfSpaces(
        name=[plane.name or f"plane {index}" for index, plane in enumerate(scene.plane)],
        normal=np.array(normals).reshape(-1, 3),
        offset=np.array([(n * np.array(plane.point)).sum() for n, plane in zip(normals, scene.plane, strict=True)]),
    )


def names_of_solids(scene: Scene) -> list[str]:
    """Return the names of all planes and walls of a scene, then of facets of walls, in the order of their numbers."""
    names = [*half_spaces(scene).name, *scene.wall_names]
    for name, wall in zip(scene.wall_names, scene.wall, strict=True):
        if (facets := shape_called(wall.shape).facets) is not None:
            names += [f"{name}, triangle {k}" for k in range(len(facets(wall.section).triangles))]
    return names


def half_spaces(scene: Scene) -> HalfSpaces:
    """Return all half-spaces of a scene: its planes, then the walls."""
    planes, size = planes_of(scene), scene.domain.size
    walled = scene.domain.walled
    if not walled or size is None:
        return planes
    walls = [WALLS[2 * axis + side] for axis in walled for side in (0, 1)]
    return HalfSpaces(
        name=[*planes.name, *(name for name, _ in walls)],
        normal=np.vstack((planes.normal, [inward for _, inward in walls])),
        offset=np.concatenate((planes.offset, -0.5 * np.repeat([size[axis] for axis in walled], 2))),
    )
