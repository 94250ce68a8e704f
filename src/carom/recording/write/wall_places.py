"""The places of planes and walls that move: a transform for each, at every frame and at impacts.

A plane is drawn as if it were infinite, so a displacement within the plane is invisible, and a conveyor belt that runs
for ever would leave the view. A plane with a constant velocity is therefore displaced only along its normal;
oscillations are drawn in full.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from carom.arrays import FloatArray
from carom.recording.layout.drawing import single
from carom.recording.schema.header import Header
from carom.recording.schema.paths import MOVING
from carom.recording.write.rows import Index, Rows, vector_column
from carom.scene.portable_math import cosine_and_sine
from carom.scene.schema.motion import WallMotion
from carom.scene.wall_shapes import shape_called
from carom.state.frame import Frame


@dataclass(frozen=True, slots=True)
class MovingWall:
    """A plane or a wall that moves."""

    motion: WallMotion
    normal: FloatArray | None = None  # (3,) normal, for a plane
    # axis of a wall that rotates: a point (3,) m, and the direction (3,)
    axis: tuple[FloatArray, FloatArray] | None = None

    def turns(self, time: FloatArray) -> FloatArray:
        """Return the wall's orientations, (k, 4), at some times, (k,) s."""
        assert self.axis is not None
        half = np.fmod(self.motion.rotation * time / (4.0 * np.pi), 1.0)
        cosine, sine = cosine_and_sine(360.0 * half)
        return np.concatenate([sine[:, None] * self.axis[1], cosine[:, None]], axis=1)


def moving_walls(header: Header) -> Mapping[str, MovingWall]:
    """Return the planes and walls that move, by their entities."""
    found = {}
    for path, motion in header.motions.items():
        kind, _, number = path.rpartition("/")[2].partition("-")
        if kind == "plane" and header.planes is not None:
            found[path] = MovingWall(motion, normal=header.planes.normal[int(number)])
        elif kind == "wall":
            wall = header.shapes[int(number)] if header.shapes else None
            axis = shape_called(wall.shape).axis if wall is not None else None
            rotates = motion.rotation != 0.0 and axis is not None and wall is not None
            found[path] = MovingWall(motion, axis=axis(wall.section) if rotates and axis and wall else None)
    return found


def piston_rows(header: Header, index: Index, frames: Sequence[Frame]) -> Iterable[Rows]:
    """Yield the transform of each piston in some frames."""
    if header.planes is None:
        return
    states = [frame.memory.pistons for frame in frames if frame.memory is not None]
    for row, plane in enumerate(header.pistons):
        displacement = np.array([0.0 if state is None else state[row, 0] for state in states])
        places = single(displacement[:, None] * header.planes.normal[plane])
        yield Rows(f"{MOVING}/plane-{plane}", index, [vector_column(rr.Transform3D.descriptor_translation(), places)])


def wall_rows(walls: Mapping[str, MovingWall], index: Index, origin: FloatArray) -> Iterable[Rows]:
    """Yield the transform of each wall at the times of an index; ``origin``, (3,) m, is the origin of the drawing."""
    for path, wall in walls.items():
        columns = []
        shift = wall.motion.displacement(index.times, wall.normal)
        if wall.axis is not None:
            turns = wall.turns(index.times)
            point = wall.axis[0] - origin
            vector, scalar = turns[:, :3], turns[:, 3:]
            twice = 2.0 * np.cross(vector, np.broadcast_to(point, vector.shape))
            shift = shift - scalar * twice - np.cross(vector, twice)  # shift of a rotation R about a point c: c - R c
            columns.append(vector_column(rr.Transform3D.descriptor_quaternion(), single(turns)))
        yield Rows(path, index, [vector_column(rr.Transform3D.descriptor_translation(), single(shift)), *columns])
