"""Sentences about what moves in a scene besides its bodies: a still picture does not show motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from carom.recording.schema.header import Header
from carom.recording.schema.paths import MOVING
from carom.scene.schema.motion import WallMotion
from carom.scene.units import dimension
from carom.scene.units.dimension import Dimension
from carom.scene.wall_shapes import shape_called


def motion_texts(header: Header) -> Iterator[str]:
    """Yield a sentence for each plane and wall that moves, and for the shear of a periodic box."""
    planes = [] if header.planes is None else header.planes.name
    walls = header.shapes or ()
    names = {f"{MOVING}/plane-{k}": name or f"plane {k}" for k, name in enumerate(planes)}
    names |= {f"{MOVING}/wall-{k}": wall.name or f"{wall.shape} {k}" for k, wall in enumerate(walls)}
    for path, motion in header.motions.items():
        if (name := names.get(path)) is None:
            continue
        if motion.rotation:
            axis = _axis_of(header, path)
            yield f"{name}: turns at {_size(header, motion.rotation, dimension.ANGULAR_VELOCITY)}{axis}"
        if motion.translates:
            yield f"{name}: {_translation(header, motion)}"
    for piston in header.pistons:
        if piston < len(planes):
            yield f"{planes[piston] or f'plane {piston}'}: moves as bodies push it"
    if header.shear is not None:
        shear = header.shear
        way = "+" if shear.rate > 0.0 else "-"
        rate = _size(header, shear.rate, dimension.RATE)
        yield f"box: sheared at {rate}; the side at +{shear.gradient} moves along {way}{shear.flow}"


def _axis_of(header: Header, path: str) -> str:
    """Say about which direction a wall turns, right-handed; empty if the wall's shape is not known."""
    number = int(path.rpartition("-")[2])
    if f"{MOVING}/wall-{number}" != path or header.shapes is None or number >= len(header.shapes):
        return ""
    wall = header.shapes[number]
    axis = shape_called(wall.shape).axis
    if axis is None:
        return ""
    direction = np.copysign(1.0, header.motions[path].rotation) * axis(wall.section)[1]
    return f" about {_direction(direction.tolist())}"


def _translation(header: Header, motion: WallMotion) -> str:
    """Say how a plane or wall changes its place."""
    if any(motion.amplitude):
        size = _size(header, float(np.linalg.norm(motion.amplitude)), dimension.LENGTH)
        rate = _size(header, motion.frequency or 0.0, dimension.RATE)
        return f"oscillates by {size} along {_direction(motion.amplitude)}, {rate}"
    if any(motion.velocity):
        speed = _size(header, float(np.linalg.norm(motion.velocity)), dimension.VELOCITY)
        return f"moves at {speed} along {_direction(motion.velocity)}"
    return "moves at given times"


def _direction(vector: Sequence[float]) -> str:
    """Name an axis of the coordinates, or write the components of the unit vector."""
    unit = np.array(vector) / np.linalg.norm(vector)
    largest = int(np.argmax(np.abs(unit)))
    if abs(unit[largest]) > 1.0 - 1e-9:
        return f"{'+' if unit[largest] > 0.0 else '-'}{'xyz'[largest]}"
    return f"({', '.join(f'{value:.2g}' for value in unit)})"


def _size(header: Header, value: float, kind: Dimension) -> str:
    return header.units.text(abs(value), kind, ".3g")
