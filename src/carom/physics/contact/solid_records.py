"""The solids of a scene as records: planes and walls, their motions, and the facets of walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from carom import registry
from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.physics.bodies import Ends
from carom.physics.contact.facets import TREE, tree_of
from carom.physics.contact.moving_walls import MOTION
from carom.physics.contact.solids import mark_of, write_heights
from carom.physics.contact.translating_walls import (
    TRANSLATION,
    WallTranslation,
    place,
    translation_of,
)
from carom.plan.interactions import load, pressing_wall
from carom.scene.load import Scene
from carom.scene.schema.motion import WallMotion
from carom.scene.schema.wall import Wall
from carom.scene.start import HalfSpaces, half_spaces
from carom.scene.wall_shapes import Facets, shape_called

_PLANE = ("plane_x", "plane_y", "plane_z", "plane_offset")


class GuidedPlanes(Protocol):
    """The planes that contacts move along their normals."""

    @property
    def rows(self) -> IntArray:
        """Numbers of the guided planes among the solids, (k,)."""
        ...

    @property
    def normals(self) -> FloatArray:
        """Normals of the guided planes, (k, 3)."""
        ...

    @property
    def largest_acceleration(self) -> float:
        """The largest acceleration of a guided plane along its normal in m/s², without contacts."""
        ...

    def motion(
        self, records: Records, before: Records, ends: Ends, motions: Sequence[WallMotion | None], smallest: float
    ) -> WallTranslation:
        """Return the object that moves these planes, and walls with a prescribed motion, through the phases of a step.

        ``smallest`` is the radius of the smallest body in m; for the other parameters see `WallTranslation`.
        """
        ...


@dataclass(frozen=True)
class SolidsWithWalls(HalfSpaces):
    """The half-spaces and walls of a scene with walls; ``normal`` and ``offset`` have rows of zeros for walls."""

    records: Records  # (p,), followed by the facets of walls and the nodes over them, as in `facets`
    before: Records  # (p,) records at the beginning of the step; used if walls translate
    motions: Sequence[WallMotion | None]  # (p,)
    solid_of_end: IntArray  # (p + f,) the number of each solid, and of the wall of each facet
    guided: GuidedPlanes | None = None  # the planes that contacts move, if any
    press_alone: bool = False

    @property
    def owner(self) -> IntArray:
        """The number of each solid, and of the wall of each facet."""
        return self.solid_of_end

    @property
    def driven(self) -> BoolArray:
        """Which solids and facets have a prescribed motion, in the order of `owner`."""
        return np.array([motion is not None for motion in self.motions])[self.owner]

    @property
    def has_facets(self) -> bool:
        """Whether a wall consists of facets; the records then have the fields `TREE`."""
        return TREE[0] in (self.records.dtype.names or ())

    @property
    def rotates(self) -> bool:
        """Whether the surface of a wall moves along itself; the records then have the fields `MOTION`."""
        return MOTION[0] in (self.records.dtype.names or ())

    @property
    def translates(self) -> bool:
        """Whether a wall changes its place; the records then have the fields `TRANSLATION`."""
        return TRANSLATION[0] in (self.records.dtype.names or ())

    @property
    def largest_acceleration(self) -> float:
        """The largest acceleration of a wall at any time, in m/s²."""
        return float(self.records["motion_fastest"].max()) if self.translates else 0.0

    @property
    def spin(self) -> FloatArray:
        """The angular velocity of each solid, (p, 3) rad/s."""
        ends = self.records[: len(self.owner)]
        return np.stack([ends[name] for name in MOTION[:3]], axis=1) if self.rotates else super().spin

    @property
    def surface(self) -> FloatArray:
        """The records, for kernels."""
        return self.records  # type: ignore[return-value] # kernels have another form for records

    @property
    def curves(self) -> bool:
        """True, since there is a wall."""
        return True

    def depth(self, position: FloatArray, radius: FloatArray) -> FloatArray:
        """Return the depth of spheres in each solid, (n, p) m; negative outside."""
        return np.asarray(radius[:, None] - self.heights(position))

    def heights(self, position: FloatArray) -> FloatArray:
        """Return the distances of points from each solid, (n, p) m; negative behind it."""
        return self._heights(position, self.records, 0, len(self))

    def height(self, position: FloatArray, solid: int) -> FloatArray:
        """Return the distances of points from one solid, (n,) m."""
        return self._heights(position, self.records, solid, 1)[:, 0]

    def heights_before(self, position: FloatArray) -> FloatArray:
        """Return `heights` at the beginning of the step."""
        return self._heights(position, self.before, 0, len(self))

    def _heights(self, position: FloatArray, records: Any, first: int, count: int) -> FloatArray:
        heights = np.empty((len(position), count))
        write_heights(np.ascontiguousarray(position), records, first, heights)
        return heights

    def advanced(self, start: FloatArray, crossed: BoolArray) -> FloatArray:
        """Return the starts of paths, (k, 3) m, in the present frame of the first solid that each path crosses."""
        if not self.translates:
            return start
        moved = [self.records[name] - self.before[name] for name in TRANSLATION[:3]]
        return np.asarray(start + np.stack(moved, axis=1)[crossed.argmax(axis=1)])


def solids_of(scene: Scene) -> HalfSpaces:
    """Return the half-spaces of a scene, followed by its walls if it has any."""
    flat = half_spaces(scene)
    motions = [*(plane.motion for plane in scene.plane), *[None] * (len(flat) - len(scene.plane))]
    motions += [wall.motion for wall in scene.wall]
    guided = registry.load("model", "piston")(scene, flat.normal) if scene.has_piston else None
    translates = guided is not None or any(motion is not None and motion.translates for motion in motions)
    if not (scene.wall or translates):
        return flat
    used = {wall.shape for wall in scene.wall}
    shapes = sorted({*(name for name in registry.HOUSE["walls"] if shape_called(name).facets is None), *used})
    faceted = [(k, shape_called(wall.shape)) for k, wall in enumerate(scene.wall, start=len(flat))]
    facets = {k: shape.facets(scene.wall[k - len(flat)].section) for k, shape in faceted if shape.facets is not None}
    parameters = [_parameters(scene, wall) for wall in scene.wall]
    # records have the fields of all shapes, so that a set of shapes has one type of record
    names = sorted({name for shape in shapes for name in shape_called(shape).fields})
    spins = np.array([_spin_of(wall) for wall in scene.wall]).reshape(-1, len(MOTION))
    names += [*(MOTION if spins.any() else ()), *(TRANSLATION if translates else ()), *(TREE if facets else ())]
    kinds = [("kind", np.int64), *((name, np.float64) for name in (*_PLANE, *names))]
    records = np.zeros(
        len(flat) + len(scene.wall), np.dtype([(mark_of(shapes, translates), np.float64), *kinds], align=True)
    )
    for name, values in zip(_PLANE, (*flat.normal.T, flat.offset), strict=True):
        records[name][: len(flat)] = values
    for row, (wall, values) in enumerate(zip(scene.wall, parameters, strict=True), start=len(flat)):
        records["kind"][row] = 1 + shapes.index(wall.shape)
        for name, value in values.items():
            records[name][row] = value
    for name, column in zip(MOTION, spins.T if spins.any() else (), strict=False):
        records[name][len(flat) :] = column
    if translates:
        for name, column in zip(TRANSLATION, np.array([translation_of(motion) for motion in motions]).T, strict=True):
            records[name] = column
        place(records, 0.0, np.empty((len(records), 3)))
    owner = [np.arange(len(records)), *(np.full(len(each.triangles), k) for k, each in facets.items())]
    records = _with_facets(records, facets)
    zeros = np.zeros((len(scene.wall), 3))
    return SolidsWithWalls(
        name=[*flat.name, *scene.wall_names],
        normal=np.concatenate((flat.normal, zeros)),
        offset=np.concatenate((flat.offset, zeros[:, 0])),
        records=records,
        before=records.copy() if translates else records,
        motions=motions,
        solid_of_end=np.concatenate(owner),
        guided=guided,
        press_alone=load(scene) == pressing_wall(scene) != "",
    )


def _with_facets(walls: Records, facets: Mapping[int, Facets]) -> Records:
    """Return the records of solids, followed by the records of all facets and of the trees over the facets.

    A wall of facets is a plane infinitely far away, with the limits of its tree.
    """
    if not facets:
        return walls
    count, number = len(walls), sum(len(each.triangles) for each in facets.values())
    first, node = count, count + number
    parts, nodes = [walls], list[Records]()
    for k, each in facets.items():
        rows = np.repeat(walls[k : k + 1], len(each.triangles))
        for name, values in each.fields.items():
            rows[name] = values
        table = tree_of(each.triangles, first, node)
        boxes = np.repeat(walls[k : k + 1], len(table))
        for name, values in zip(TREE, table.T, strict=True):
            boxes[name] = values
        walls["kind"][k], walls["plane_offset"][k] = 0, -np.inf
        walls["tree_first"][k], walls["tree_skip"][k] = node, node + len(table)
        parts.append(rows)
        nodes.append(boxes)
        first, node = first + len(rows), node + len(table)
    return np.concatenate((*parts, *nodes))


def _parameters(scene: Scene, wall: Wall) -> Mapping[str, float]:
    """Return the fields of a wall; along periodic axes, the wall is endless."""
    shape, size = shape_called(wall.shape), scene.domain.size or (0.0, 0.0, 0.0)
    if shape.facets is not None:  # the facets have the fields
        return {}
    values = dict(shape.parameters(wall.section))
    for axis in scene.domain.repeating:
        values |= shape.periodic(wall.section, axis, size[axis]) or {}
    return values


def _spin_of(wall: Wall) -> FloatArray:
    """Return the angular velocity of a wall in rad/s, and a point of its axis in m, (6,); zeros for a wall at rest."""
    axis = shape_called(wall.shape).axis
    if wall.motion is None or wall.motion.rotation == 0.0 or axis is None:
        return np.zeros(len(MOTION))
    point, direction = axis(wall.section)
    return np.concatenate((wall.motion.rotation * direction, point))
