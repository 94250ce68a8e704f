"""Arrows that show which way walls, planes and sheared boxes move: a still picture does not show motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from carom.arrays import FloatArray
from carom.display.supplement import Static
from carom.recording.layout import FIELD
from carom.recording.layout.canvas import Area, View
from carom.recording.layout.drawing import line_radii, single
from carom.recording.schema import palette
from carom.recording.schema.header import Header
from carom.recording.schema.paths import MOVING
from carom.scene.wall_shapes import across, shape_called

_LENGTH = 0.13  # length of an arrow, in heights of the view
_THICK = 0.009  # radius of an arrow, in heights of the view
_BESIDE = 0.55  # distance of a plane's arrow from the middle of the view, in half widths of the view
_OUTSIDE = 1.06  # radius of the arc around a rotating wall, in radii of the wall; also for the arrows of a box
_ARC = np.linspace(-0.45, 0.45, 25)  # rad, angles of the arc from its beginning to its end, about the highest point
_HEAD = 6  # number of points of the arc that its final arrow replaces

_Arrow = tuple[FloatArray, FloatArray]  # origin and vector, (3,) m


def motion_marks(header: Header, origin: FloatArray, view: View, area: Area, time: float) -> Iterator[Static]:
    """Yield an arrow for each translating plane and wall, an arc for each rotating wall, two arrows for a sheared box.

    An oscillation has arrows both ways. ``origin``, (3,) m, is the origin of the recording, and ``time`` (s) is the
    moment.
    """
    length = _LENGTH * view.height()
    arrows, arcs = [*_of_planes(header, origin, view, area, time), *_of_shear(header, origin, view)], list[FloatArray]()
    for path, motion in header.motions.items():
        kind, _, number = path.removeprefix(f"{MOVING}/").partition("-")
        if kind != "wall" or not header.shapes:
            continue
        wall = header.shapes[int(number)]
        shape = shape_called(wall.shape)
        corners = shape.mesh(wall.section, origin, view.height()).corners - origin
        if motion.rotation and shape.axis is not None:
            point, axis = shape.axis(wall.section)
            arcs.append(_arc(corners, point - origin, np.sign(motion.rotation) * axis, view))
        if motion.translates:
            middle = corners.mean(axis=0) + motion.displacement(time)
            arrows += [(middle, way) for way in _ways(motion.amplitude, motion.velocity)]
    if not arrows and not arcs:
        return
    origins, vectors = [place for place, _ in arrows], [length * way for _, way in arrows]
    for arc in arcs:  # the end of an arc is an arrow
        origins.append(arc[-_HEAD])
        vectors.append(arc[-1] - arc[-_HEAD])
    width, ink = line_radii(_THICK, view.height()), palette.INKS[area.theme]
    yield (
        f"{FIELD}/motion",
        rr.Arrows3D(origins=single(np.array(origins)), vectors=single(np.array(vectors)), colors=ink, radii=width),
    )
    if arcs:
        strips = [single(arc[: 1 - _HEAD]) for arc in arcs]
        yield f"{FIELD}/turns", rr.LineStrips3D(strips, colors=ink, radii=width)


def _ways(amplitude: object, velocity: object) -> list[FloatArray]:
    """Return unit vectors along a motion: both ways of an oscillation, or the way of a velocity; otherwise none."""
    swing, drift = np.asarray(amplitude, dtype=np.float64), np.asarray(velocity, dtype=np.float64)
    if swing.any():
        return [sign * swing / np.linalg.norm(swing) for sign in (-1.0, 1.0)]
    return [drift / np.linalg.norm(drift)] if drift.any() else []


def _of_planes(header: Header, origin: FloatArray, view: View, area: Area, time: float) -> Iterator[_Arrow]:
    """Yield the arrows of planes, left of the middle of the view."""
    if header.planes is None:
        return
    right, _ = view.axes()
    for k, (normal, offset) in enumerate(zip(header.planes.normal, header.planes.offset, strict=True)):
        motion = header.motions.get(f"{MOVING}/plane-{k}")
        if motion is None or not motion.translates:  # a piston, for instance, is moved by bodies
            continue
        shift = motion.displacement(time, normal)
        aside = -right + (right @ normal) * normal
        aside /= max(float(np.linalg.norm(aside)), np.finfo(float).tiny)
        beside = view.target + _BESIDE * 0.5 * view.height() * area.aspect * aside
        place = beside + (offset - normal @ (origin + beside) + normal @ shift) * normal
        yield from ((place, way) for way in _ways(motion.amplitude, motion.velocity))


def _of_shear(header: Header, origin: FloatArray, view: View) -> Iterator[_Arrow]:
    """Yield the arrows of a sheared box, on the edges of both faces that are nearer to the eye."""
    if header.shear is None or header.drawn_box is None:
        return
    flow, gradient = header.shear.axes
    third = 3 - flow - gradient
    for side in (-1.0, 1.0):
        place, way = np.zeros(3), np.zeros(3)
        place[gradient] = side * 0.5 * _OUTSIDE * header.drawn_box[gradient]
        place[third] = np.copysign(0.5 * header.drawn_box[third], view.to_eye[third])
        way[flow] = side * np.sign(header.shear.rate)
        yield place - origin, way


def _arc(corners: FloatArray, point: FloatArray, axis: FloatArray, view: View) -> FloatArray:
    """Return the points of an arc around the end of a wall that is nearer to the eye, in the sense of its rotation."""
    heights = (corners - point) @ axis
    radius = float(np.linalg.norm(corners - point - heights[:, None] * axis, axis=1).max())
    end = heights.max() if axis @ view.to_eye >= 0.0 else heights.min()
    top = view.up - (view.up @ axis) * axis
    size = float(np.linalg.norm(top))
    top = top / size if size > 1e-6 else across(axis)
    onward = np.cos(_ARC)[:, None] * top + np.sin(_ARC)[:, None] * np.cross(axis, top)
    return np.asarray(point + end * axis + _OUTSIDE * radius * onward)
