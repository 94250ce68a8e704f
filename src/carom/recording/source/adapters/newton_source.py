"""Newton: the rigid bodies of a model. Free spheres are judged; what has joints or another shape is only drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from carom.arrays import FloatArray, SingleArray
from carom.errors import RecordingError
from carom.recording.source.adapters.package import engine_package, named_version
from carom.recording.source.source import Model, Plane, State

WORLD = -1  # the body that owns static shapes
_NAMES = ("body_label", "body_key")  # attributes with the names, in newer and older versions


class NewtonSource:
    """The bodies of a Newton model.

    Parameters
    ----------
    model
        newton.Model.
    now
        Returns the present state and its time in s, ``lambda: (state_0, time)``: Newton's states do not know their
        time, and a step swaps them.
    """

    def __init__(self, model: Any, now: Callable[[], tuple[Any, float]]) -> None:
        package = engine_package("newton")
        self._now, self._centre = now, model.body_com.numpy().astype(np.float64)
        self._off_centre = bool(self._centre.any())  # whether any centre of mass is not the origin of its body
        mass = model.body_mass.numpy().astype(np.float64)
        if len(mass) == 0:
            raise RecordingError("newton: the model has no rigid body")
        owner, kind, scale = model.shape_body.numpy(), model.shape_type.numpy(), model.shape_scale.numpy()
        place = model.shape_transform.numpy()
        sphere = (kind == int(package.GeoType.SPHERE)) & (owner != WORLD)
        count = np.bincount(owner[owner != WORLD], minlength=len(mass))
        radius = np.zeros(len(mass))
        radius[owner[sphere]] = scale[sphere, 0]
        tied = np.zeros(len(mass), bool)
        for joint in np.flatnonzero(model.joint_type.numpy() != int(package.JointType.FREE)).tolist():
            tied[[b for b in (model.joint_parent.numpy()[joint], model.joint_child.numpy()[joint]) if b != WORLD]] = (
                True
            )
        simple = (radius > 0.0) & (count == 1) & ~tied & (np.abs(self._centre).max(axis=1) == 0.0)
        inertia = model.body_inertia.numpy().astype(np.float64).trace(axis1=1, axis2=2) / 3.0
        size = np.where(radius > 0.0, radius, np.sqrt(2.5 * inertia / np.where(mass > 0.0, mass, 1.0)))
        gravity = np.atleast_2d(model.gravity.numpy() if hasattr(model.gravity, "numpy") else model.gravity)
        if len(gravity) > 1 and np.ptp(gravity, axis=0).any():
            raise RecordingError("newton: the worlds of the model have different gravity; record one of them")
        static = np.flatnonzero((kind == int(package.GeoType.PLANE)) & (owner == WORLD))
        names = next((list(getattr(model, name)) for name in _NAMES if getattr(model, name, None)), None)
        self.model = Model(
            engine=named_version("newton"),
            mass=np.where(mass > 0.0, mass, 1.0),
            radius=size,
            inertia=inertia,
            names=names,
            fixed=mass == 0.0,
            judged=simple,
            gravity=gravity[0].astype(np.float64),
            planes=[_plane(place[k], number) for number, k in enumerate(static)],
        )

    def state(self) -> State:
        """Return the present state."""
        state, time = self._now()
        pose, rate = state.body_q.numpy(), state.body_qd.numpy()
        position = pose[:, :3]
        if self._off_centre:
            position = position + _turned(pose[:, 3:].astype(np.float64), self._centre)
        return State(float(time), position, rate[:, :3], pose[:, 3:], rate[:, 3:])


def newton(model: Any, now: Callable[[], tuple[Any, float]]) -> NewtonSource:
    """Return the source of a newton.Model; see `Newton`."""
    return NewtonSource(model, now)


def _plane(place: SingleArray, number: int) -> Plane:
    """Return a plane from its position and rotation; its normal is its own z axis."""
    turn = place[None, 3:].astype(np.float64)
    normal = _turned(turn, np.array([[0.0, 0.0, 1.0]]))[0]
    x, y, z = (float(v) for v in normal)
    return Plane((x, y, z), float(normal @ place[:3]), f"plane {number}")


def _turned(quaternion: FloatArray, local: FloatArray) -> FloatArray:
    """Rotate vectors (n, 3) by quaternions xyzw."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, local)
    return np.asarray(local + w * twice + np.cross(axis, twice))
