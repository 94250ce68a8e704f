"""MuJoCo: the bodies of a model. Free spheres are judged; what has joints or another shape is only drawn."""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.recording.source.adapters.package import engine_package, named_version
from carom.recording.source.source import Model, Plane, State

WORLD = 0  # the body that owns everything static


class MuJoCoSource:
    """The bodies of a MuJoCo model.

    A body whose one shape is a sphere about its centre of mass and whose one joint is free is judged. Another is drawn
    as a sphere about all its shapes. Spheres that belong to the world are bodies that never move, and its planes are
    planes.

    Parameters
    ----------
    model, data
        mujoco.MjModel and mujoco.MjData.
    """

    def __init__(self, model: Any, data: Any) -> None:
        package = engine_package("mujoco")
        self._package, self._model, self._data = package, model, data
        shapes = package.mjtGeom
        owner, kind = model.geom_bodyid, model.geom_type
        solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        moving = [b for b in range(1, model.nbody) if model.body_mass[b] > 0.0 and model.body_weldid[b] != WORLD]
        still = [
            int(g)
            for g in np.flatnonzero((kind == shapes.mjGEOM_SPHERE) & solid)
            if model.body_weldid[owner[g]] == WORLD
        ]
        if not moving:
            raise RecordingError("mujoco: the model has no body with a mass that can move")
        self._moving, self._still = np.array(moving), np.array(still, dtype=np.int64)
        planes = [
            int(g)
            for g in np.flatnonzero((kind == shapes.mjGEOM_PLANE) & solid)
            if model.body_weldid[owner[g]] == WORLD
        ]
        package.mj_kinematics(model, data)
        package.mj_comPos(model, data)
        own = [np.flatnonzero(owner == b) for b in moving]
        free = np.array([_is_free_sphere(package, model, b, geoms) for b, geoms in zip(moving, own, strict=True)])
        radius = np.array([_reach(model, data, b, geoms) for b, geoms in zip(moving, own, strict=True)])
        self._simple = bool(free.all())
        self._joint = model.body_jntadr[self._moving]
        self._end_of = _ends(model, moving, still, planes)
        self._velocity = np.empty(6)
        n = len(moving) + len(still)
        self._position, self._speed, self._spin = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        self._turn = np.zeros((n, 4))
        self._turn[:, 3] = 1.0
        self._position[len(moving) :] = data.geom_xpos[self._still]
        if self._simple:
            self._places = model.jnt_qposadr[self._joint][:, None] + np.arange(7)
            self._rates = model.jnt_dofadr[self._joint][:, None] + np.arange(6)
        self.model = Model(
            engine=named_version("mujoco"),
            mass=np.concatenate((model.body_mass[self._moving], np.ones(len(still)))),
            radius=np.concatenate((radius, model.geom_size[self._still, 0])),
            inertia=np.concatenate((model.body_inertia[self._moving].mean(axis=1), np.ones(len(still)))),
            names=[_named(model.body(b).name, k) for k, b in enumerate(moving)]
            + [_named(model.geom(g).name, len(moving) + k) for k, g in enumerate(still)],
            fixed=np.arange(n) >= len(moving),
            judged=np.concatenate((free, np.ones(len(still), bool))),
            gravity=model.opt.gravity,
            planes=[_plane(model, data, g) for g in planes],
            time_step=model.opt.timestep,
        )

    def state(self) -> State:
        """Return the present state, with the contacts of the last step."""
        data, k = self._data, len(self._moving)
        if self._simple:
            # qpos and qvel are those of the end of the step; xpos is still that of its start
            places, rates = data.qpos[self._places], data.qvel[self._rates]
            self._position[:k] = places[:, :3]
            self._turn[:k, :3], self._turn[:k, 3] = places[:, 4:], places[:, 3]
            self._speed[:k] = rates[:, :3]
            self._spin[:k] = _turned(places[:, 3:], rates[:, 3:])
        else:
            self._of_any_bodies(k)
        return State(data.time, self._position, self._speed, self._turn, self._spin)

    def _of_any_bodies(self, k: int) -> None:
        package, model, data = self._package, self._model, self._data
        package.mj_kinematics(model, data)
        package.mj_comPos(model, data)
        package.mj_comVel(model, data)
        self._position[:k] = data.xipos[self._moving]
        turn = data.xquat[self._moving]
        self._turn[:k, :3], self._turn[:k, 3] = turn[:, 1:], turn[:, 0]
        for row, body in enumerate(self._moving):
            package.mj_objectVelocity(model, data, package.mjtObj.mjOBJ_BODY, int(body), self._velocity, 0)
            self._spin[row], self._speed[row] = self._velocity[:3], self._velocity[3:]  # of the centre of mass

    def contacts(self) -> IntArray:
        """Return the pairs in contact at the last step, (m, 2)."""
        ends = self._end_of[self._data.contact.geom]
        return np.asarray(ends[(ends >= 0).all(axis=1)], dtype=np.int64)


def mujoco(model: Any, data: Any) -> MuJoCoSource:
    """Return the source of a mujoco.MjModel and its mujoco.MjData; see `MuJoCo`."""
    return MuJoCoSource(model, data)


def _is_free_sphere(package: Any, model: Any, body: int, geoms: IntArray) -> bool:
    """Return whether a body is one sphere about its centre of mass that moves freely."""
    return (
        model.body_jntnum[body] == 1
        and model.jnt_type[model.body_jntadr[body]] == package.mjtJoint.mjJNT_FREE
        and not np.any(model.body_parentid == body)
        and len(geoms) == 1
        and model.geom_type[geoms[0]] == package.mjtGeom.mjGEOM_SPHERE
        and bool(np.abs(model.body_ipos[body]).max() == 0.0)
        and bool(np.abs(model.geom_pos[geoms[0]]).max() == 0.0)
    )


def _reach(model: Any, data: Any, body: int, geoms: IntArray) -> float:
    """Return the radius of the sphere about the centre of mass that holds all shapes of a body, in m."""
    if len(geoms) == 0:
        return float(np.sqrt(2.5 * model.body_inertia[body].max() / model.body_mass[body]))
    away = np.linalg.norm(data.geom_xpos[geoms] - data.xipos[body], axis=1)
    return float((away + model.geom_rbound[geoms]).max())


def _ends(model: Any, moving: list[int], still: list[int], planes: list[int]) -> IntArray:
    """Return the end of each shape: a body, a plane (from n on), or -1 for none."""
    ends = np.full(model.ngeom, -1)
    of_body = {body: k for k, body in enumerate(moving)}
    for geom in range(model.ngeom):
        ends[geom] = of_body.get(int(model.geom_bodyid[geom]), -1)
    for k, geom in enumerate([*still, *planes]):
        ends[geom] = len(moving) + k
    return ends


def _plane(model: Any, data: Any, geom: int) -> Plane:
    normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    x, y, z = (float(v) for v in normal)
    return Plane((x, y, z), float(normal @ data.geom_xpos[geom]), model.geom(geom).name)


def _turned(quaternion: FloatArray, local: FloatArray) -> FloatArray:
    """Rotate vectors (n, 3) from the frames of the bodies into the frame of the world; quaternions are wxyz."""
    w, axis = quaternion[:, :1], quaternion[:, 1:]
    twice = 2.0 * np.cross(axis, local)
    return np.asarray(local + w * twice + np.cross(axis, twice))


def _named(name: str, number: int) -> str:
    return name or f"body {number}"
