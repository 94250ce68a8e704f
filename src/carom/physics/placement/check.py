"""Refusals of starts that cannot be simulated: overlaps, and numbers out of range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carom.errors import SceneError
from carom.physics.placement.neighbours import overlapping_pairs, squared_distance
from carom.scene.key_places import KeyPath
from carom.scene.schema import Scene
from carom.scene.start import HalfSpaces, InitialBodies
from carom.scene.units.dimension import LENGTH
from carom.scene.units.system import UnitSystem
from carom.scene.wording import body_called, body_key

FloatArray = NDArray[np.float64]

MOST_PAIRS = 3  # that a message names
WRITTEN = 5e-7  # half a unit in the last of seven digits, of numbers that begin with 1; files and people write no fewer
MOST_WRITTEN = 1e-3  # of a radius: an overlap above it is one, however far from the origin


def key_of(scene: Scene, number: int) -> KeyPath:
    """Return the key of a body whose position is given, or that of the data that it is a row of."""
    row = number - len(scene.body)
    if row < 0:
        return "body", number
    ends = np.cumsum([len(columns) for columns in scene.data])
    return "bodies", int(np.searchsorted(ends, row, side="right"))


def written_name(scene: Scene, number: int, names: Sequence[str]) -> str:
    """Name a body whose position is given by its key in the scene, or by its row in the data."""
    return "".join(_place_of(scene, number, names))


def _place_of(scene: Scene, number: int, names: Sequence[str]) -> tuple[str, str]:
    """Return the key of a body in the scene, or its row, and the data that it is a row of."""
    row, name = number - len(scene.body), names[number]
    if row < 0:
        return body_key(number, name), ""
    for section, columns in zip(scene.bodies, scene.data, strict=True):
        if row < len(columns):
            own = f' ("{name}")' if columns.name else ""
            return f"row {row}{own}", f" of {section.called}"
        row -= len(columns)
    raise IndexError(number)


def refuse_unresolved(
    called: str, key: KeyPath, reach: float, radius: float, units: UnitSystem, remedy: str = ""
) -> None:
    """Refuse bodies smaller than the spacing of floating-point numbers at their positions; lengths in m."""
    step = float(np.spacing(reach))
    if step > radius:
        away, apart, size = (units.text(length, LENGTH, ".3g") for length in (reach, step, radius))
        raise SceneError(
            f"{called}: {away} from the origin, positions are {apart} apart, and the radius is "
            f"{size}; place it nearer to the origin or enlarge the radius{remedy}",
            key,
        )


def refuse_overflow(start: InitialBodies) -> None:
    """Refuse bodies whose mass, moment of inertia or motion overflows or underflows."""
    with np.errstate(over="ignore", divide="ignore"):
        wrong = {
            "mass": ~(np.isfinite(start.mass) & (np.isfinite(1.0 / start.mass) | (start.mass == 0.0))),
            "moment of inertia": ~(
                np.isfinite(start.inertia) & (np.isfinite(1.0 / start.inertia) | (start.mass == 0.0))
            ),
            "velocity": ~np.isfinite(start.velocity).all(axis=1),
            "angular velocity": ~np.isfinite(start.angular_velocity).all(axis=1),
        }
    for what, bodies in wrong.items():
        if bodies.any():
            worst = int(np.argmax(bodies))
            called = body_called(worst, start.name[worst])
            raise SceneError(f"the {what} of {called} is too large or too small a number; choose other units")


def refuse_overlaps(scene: Scene, start: InitialBodies, box: FloatArray | None) -> None:
    """Refuse overlapping bodies; touching is allowed, up to the rounding of positions of seven digits."""
    pairs = overlapping_pairs(start.position, start.radius, box)
    if len(pairs) == 0:
        return
    i, j = pairs.T
    reach = start.radius[i] + start.radius[j]
    distance = np.sqrt(squared_distance(start.position[i], start.position[j], box))
    rounding = _rounding(start, reach) + np.minimum(_written(start)[i] + _written(start)[j], MOST_WRITTEN * reach)
    overlap = reach - distance
    deep = np.flatnonzero(overlap > rounding)
    if len(deep) == 0:
        return
    worst = int(np.argmax(overlap - rounding))
    others = [k for k in deep[: MOST_PAIRS + 1] if k != worst][:MOST_PAIRS]

    def called(k: int) -> str:
        (first, source), (second, its) = (_place_of(scene, int(number), start.name) for number in pairs[k])
        return f"{first}{'' if source == its else source} and {second}{its}"

    more = ""
    if others:
        left = len(deep) - 1 - len(others)
        more = f"; so do {', '.join(map(called, others))}{f' and {left} more pairs' if left else ''}"
    depth = scene.unit_system.text(overlap[worst], LENGTH)
    raise SceneError(
        f"{called(worst)} overlap by {depth} at the start{more}; move them apart, or set contact.allow_overlap = true",
        key_of(scene, int(pairs[worst, 0])),
    )


def refuse_immersion(scene: Scene, start: InitialBodies, solids: HalfSpaces) -> None:
    """Refuse bodies that reach into a plane or a wall."""
    depth = solids.depth(start.position, start.radius)
    rounding = (_rounding(start, start.radius) + np.minimum(_written(start), MOST_WRITTEN * start.radius))[:, None]
    if len(solids) and np.max(depth - rounding) > 0.0:
        body, plane = np.unravel_index(np.argmax(depth - rounding), depth.shape)
        deep = scene.unit_system.text(depth[body, plane], LENGTH)
        raise SceneError(
            f"{written_name(scene, int(body), start.name)} reaches {deep} into {solids.name[plane]} "
            "at the start; move it out, or set contact.allow_overlap = true",
            key_of(scene, int(body)),
        )


def _rounding(start: InitialBodies, length: FloatArray) -> FloatArray:
    """Return the possible rounding errors of lengths, in m; less than a length, however far from the origin."""
    return np.asarray(np.minimum(1e-9 * length + 4 * np.spacing(np.abs(start.position).max()), 0.5 * length))


def _written(start: InitialBodies) -> FloatArray:
    """Return how far each centre may be from where it was meant, (n,) m, if its coordinates have seven digits."""
    return np.asarray(WRITTEN * np.sqrt(np.sum(start.position * start.position, axis=1)))
