"""PyBullet: the bodies of a physics server. Spheres are judged; what has joints or another shape is only drawn."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain, repeat
from typing import Any

import numpy as np

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.recording.source.adapters.package import engine_package, named_version
from carom.recording.source.source import SPHERE, Model, Plane, State

BASE = -1  # the number of a body's first link
SLOW = 200  # bodies; copying their states takes a thirtieth of a step
SELDOM = 5  # steps for a frame of 1000 bodies: reading it takes a sixth of one step
UNNAMED = ("", "baseLink", "link0")  # the names of bodies that have none


class PyBulletSource:
    """The bodies of a physics server.

    The state of a body takes two calls, so a `Recorder` of 1000 bodies records every fifth frame by default. PyBullet
    reports neither the time nor the field: pass both, as they were set.

    Parameters
    ----------
    time_step
        s, as given to ``setTimeStep``. The time is counted by the calls of `stepped`, which `Recorder.frame` makes.
    gravity
        (3,) m/s², as given to ``setGravity``.
    client
        The number of the physics client.
    steps_per_frame
        Number of steps between two calls of `Recorder.frame`.
    """

    def __init__(
        self,
        time_step: float = 1.0 / 240.0,
        gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        client: int = 0,
        steps_per_frame: int = 1,
    ) -> None:
        package = engine_package("pybullet")
        self._package, self._client, self._frames = package, client, 0
        self._stride = time_step * steps_per_frame
        everything = [package.getBodyUniqueId(k, client) for k in range(package.getNumBodies(client))]
        shapes = {body: package.getCollisionShapeData(body, BASE, client) for body in everything}
        planes = [b for b in everything if len(shapes[b]) == 1 and shapes[b][0][2] == package.GEOM_PLANE]
        self._bodies = [b for b in everything if b not in planes]
        if not self._bodies:
            raise RecordingError("pybullet: the physics server has no body besides planes")
        dynamics = [package.getDynamicsInfo(b, BASE, client) for b in self._bodies]
        mass = np.array([found[0] for found in dynamics])
        spheres = np.array([_is_sphere(package, b, shapes[b], client) for b in self._bodies])
        radius = np.array(
            [
                shapes[b][0][3][0] if round_ else _reach(package, b, client)
                for b, round_ in zip(self._bodies, spheres, strict=True)
            ]
        )
        self.model = Model(
            engine=named_version("pybullet"),
            mass=np.where(mass > 0.0, mass, 1.0),
            radius=radius,
            inertia=np.where(
                mass > 0.0,
                [np.mean(found[2]) for found in dynamics],
                SPHERE * np.where(mass > 0, mass, 1.0) * radius**2,
            ),
            names=[_name(package, b, k, client) for k, b in enumerate(self._bodies)],
            fixed=mass == 0.0,
            judged=spheres,
            gravity=gravity,
            planes=[_plane(package, b, shapes[b][0], k, client) for k, b in enumerate(planes)],
            time_step=time_step,
            every=calls_per_frame(len(self._bodies)),
        )

    def stepped(self) -> None:
        """Count the steps up to the next frame."""
        self._frames += 1

    def state(self) -> State:
        """Return the present state."""
        # PyBullet has no call for several bodies: these two a body are most of the cost of a frame
        places = map(self._package.getBasePositionAndOrientation, self._bodies, repeat(self._client))
        rates = map(self._package.getBaseVelocity, self._bodies, repeat(self._client))
        place, rate = _rows(places, len(self._bodies), 7), _rows(rates, len(self._bodies), 6)
        return State(self._frames * self._stride, place[:, :3], rate[:, :3], place[:, 3:], rate[:, 3:])


def pybullet(
    time_step: float = 1.0 / 240.0,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    client: int = 0,
    steps_per_frame: int = 1,
) -> PyBulletSource:
    """Return the source of a physics server; see `PyBullet`."""
    return PyBulletSource(time_step, gravity, client, steps_per_frame)


def calls_per_frame(bodies: int) -> int:
    """Return the number of steps for a frame for which copying the states takes a small fraction of the time."""
    return min(SELDOM, 1 + bodies // SLOW)


def _rows(pairs: Iterable[Any], count: int, width: int) -> FloatArray:
    """Return pairs of tuples as rows of numbers."""
    flat = chain.from_iterable(chain.from_iterable(pairs))
    return np.fromiter(flat, np.float64, count * width).reshape(count, width)


def _is_sphere(package: Any, body: int, shapes: Any, client: int) -> bool:
    """Return whether a body is one sphere about its centre of mass, without joints."""
    one = len(shapes) == 1 and shapes[0][2] == package.GEOM_SPHERE and not any(shapes[0][5])
    return bool(one and package.getNumJoints(body, client) == 0)


def _reach(package: Any, body: int, client: int) -> float:
    low, high = package.getAABB(body, BASE, client)
    return float(0.5 * np.linalg.norm(np.subtract(high, low)))


def _plane(package: Any, body: int, shape: Any, number: int, client: int) -> Plane:
    place, turn = package.getBasePositionAndOrientation(body, client)
    normal = np.array(package.getMatrixFromQuaternion(turn)).reshape(3, 3) @ np.array(shape[3])
    x, y, z = (float(v) for v in normal / np.linalg.norm(normal))
    return Plane((x, y, z), float(normal @ np.array(place) / np.linalg.norm(normal)), f"plane {number}")


def _name(package: Any, body: int, number: int, client: int) -> str:
    base, name = (text.decode(errors="replace") for text in package.getBodyInfo(body, client))
    called = name or base
    return f"body {number}" if called in UNNAMED else called
