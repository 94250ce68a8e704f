"""Checks that the walls of a scene leave space for bodies, at the start and as they move.

Walls at rest may cross: planes form boxes, and an end plane cuts a cylinder. Two things are mistakes: a wall behind
another wall, where no body can be; and walls that are apart at the start but meet later, and crush the bodies between
them. A wall is represented by points of its drawn surface. In the frame of another wall, these points move by the
difference of both displacements. The points cannot meet the other wall until this difference is as long as the distance
between points and wall.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np

from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.contact.solid_records import SolidsWithWalls
from carom.scene.load import Scene
from carom.scene.schema.motion import WallMotion
from carom.scene.start import HalfSpaces, InitialBodies
from carom.scene.units.dimension import TIME
from carom.scene.wall_shapes import shape_called

TOUCHING = 1e-6  # largest gap of touching walls over a wall's size: coordinates may be rounded to seven digits
OPPOSED = 1e-12  # largest difference of the normals of parallel planes
# shortest step as a fraction of the run, unless both walls are thin; steps are longer if the gap between them allows it
LONGEST_STEP = 1.0 / 512.0
MOST_STEPS = 4096  # largest number of steps that are checked, for walls that oscillate close to each other
HALVINGS = 3  # halvings of the sides of drawn triangles
ENOUGH_TRIANGLES = 256


def refuse_crossing_walls(scene: Scene, start: InitialBodies, solids: HalfSpaces) -> None:
    """Refuse walls that no body can touch, and walls that meet as they move.

    Raises
    ------
    SceneError
        The message names both walls, and the time if they move.
    """
    if not isinstance(solids, SolidsWithWalls):
        return
    first = len(solids) - len(scene.wall)
    shapes = [shape_called(wall.shape) for wall in scene.wall]
    is_thin = [False] * first + [shape.thin for shape in shapes]
    for one, points in _surfaces(scene, start, solids):
        touching = TOUCHING * float(np.sqrt(np.square(np.ptp(points, axis=0)).sum()))
        # no point of a plate may be outside of another wall; some points of a hollow shape may be
        farthest = np.min if is_thin[one] else np.max
        for other in range(len(solids)):
            if other == one:
                continue

            def gaps(time: float, points: FloatArray = points, one: int = one, other: int = other) -> FloatArray:
                """Return the distance of each point from the other wall, in m."""
                moved = points + _between(solids, one, other, time) + _displacement(solids.motions[other], 0.0)
                return solids.height(moved, other)

            if gaps(0.0).max() < -touching:
                raise SceneError(
                    f"{solids.name[one]} lies behind {solids.name[other]}, where no body can be; move one of them, or "
                    "remove it",
                    _key(scene, one, first),
                )
            limit = touching if is_thin[other] and is_thin[one] else -touching
            _refuse_meeting(scene, solids, (one, other), lambda time: float(farthest(gaps(time))), limit)  # noqa: B023
    planes = range(first)
    for one, other in combinations(planes, 2):
        N = solids.normal
        if np.abs(N[one] + N[other]).max() < OPPOSED:
            space = -float(solids.offset[one] + solids.offset[other])

            def height(time: float, one: int = one, other: int = other, space: float = space) -> float:
                """Return the distance between both planes, in m."""
                return space - float((N[one] * _between(solids, one, other, time)).sum())  # noqa: B023

            _refuse_meeting(scene, solids, (one, other), height, 0.0)


def _refuse_meeting(
    scene: Scene, solids: SolidsWithWalls, pair: tuple[int, int], gap: Callable[[float], float], limit: float
) -> None:
    """Refuse two walls whose gap (m), a function of time (s), falls to a limit that the gap exceeds at first."""
    motions = solids.motions[pair[0]], solids.motions[pair[1]]
    fastest = sum(_fastest(motion) for motion in motions if motion is not None)
    time, end = 0.0, scene.time.duration
    if motions[0] == motions[1] or fastest == 0.0 or gap(0.0) <= limit:
        return
    for _ in range(MOST_STEPS):
        distance = gap(time)
        if distance <= limit:
            moving = pair[0] if motions[0] is not None and motions[0].translates else pair[1]
            one, other = solids.name[moving], solids.name[sum(pair) - moving]
            at = scene.unit_system.text(time, TIME, ".4g")
            raise SceneError(
                f"{one} meets {other} at t = {at} and would crush bodies between them; end its motion earlier, "
                "or shorten time.duration",
                (*_key(scene, moving, len(solids) - len(scene.wall)), "motion"),
            )
        if time == end:
            return
        time = min(end, time + max(distance / fastest, LONGEST_STEP * end if limit <= 0.0 else 0.0))


def _between(solids: SolidsWithWalls, one: int, other: int, time: float) -> FloatArray:
    """Return the displacement (m) of a wall relative to another wall at a time (s)."""
    return _displacement(solids.motions[one], time) - _displacement(solids.motions[other], time)


def _displacement(motion: WallMotion | None, time: float) -> FloatArray:
    return np.zeros(3) if motion is None else np.array(motion.displacement(time))


def _fastest(motion: WallMotion) -> float:
    """Return an upper bound of the speed of a wall, in m/s."""
    speeds = [np.sqrt(np.square(velocity).sum()) for velocity in (motion.velocity, *motion.velocities)]
    oscillation = np.sqrt(np.square(motion.amplitude).sum()) * 2.0 * np.pi * (motion.frequency or 0.0)
    return float(max(speeds) + oscillation)


def _surfaces(scene: Scene, start: InitialBodies, solids: SolidsWithWalls) -> Iterator[tuple[int, FloatArray]]:
    """Yield the number of each wall, and points on it at the place given in its section, (k, 3) m."""
    first, centre = len(solids) - len(scene.wall), start.position.mean(axis=0)
    reach = float(np.abs(start.position - centre).max() + start.radius.max())
    fastest = max((_fastest(motion) for motion in solids.motions if motion is not None), default=0.0)
    reach += fastest * scene.time.duration  # endless walls are drawn so long that no wall moves past their ends
    for number, wall in enumerate(scene.wall, start=first):
        mesh = shape_called(wall.shape).mesh(wall.section, centre, reach)
        triangles = mesh.corners[mesh.triangles]
        for _ in range(HALVINGS):
            if len(triangles) < ENOUGH_TRIANGLES:
                a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
                ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
                parts = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
                triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
        yield number, np.unique(triangles.reshape(-1, 3), axis=0)


def _key(scene: Scene, number: int, first: int) -> tuple[str | int, ...]:
    """Return the key of a plane or a wall; walls of the domain do not move."""
    return ("wall", number - first) if number >= first else ("plane", number)
