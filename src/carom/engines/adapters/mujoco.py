"""MuJoCo: its recorder, and the engine that `crosscheck` compares: rigid bodies with soft contacts.

The recorder audits free spheres. Bodies with other joints or shapes are drawn, but not judged.

MuJoCo has no coefficient of restitution. A contact is a damped spring. Its stiffness and damping are chosen so that a
bounce has the scene's coefficient of restitution and takes `BOUNCE` steps.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.engines.engine import EngineSimulation, InOrder, SteppedEngine, dt_of, problem_of
from carom.engines.engine_contacts import rotated
from carom.engines.source import CONTACT, Model, Plane, Source, State, engine_package, named_version
from carom.errors import RecordingError
from carom.lab.compared_run import Setting
from carom.scene.load import Scene
from carom.scene.schema import Coefficients

WORLD = 0  # the body that owns everything static


class MuJoCoSource:
    """The bodies of a MuJoCo model.

    The audit covers each body whose only shape is a sphere about its centre of mass and whose only joint is free. Other
    bodies are drawn as spheres about all their shapes. Spheres that belong to the world body are recorded as bodies
    that never move, its planes as planes.

    Parameters
    ----------
    model, data
        mujoco.MjModel and mujoco.MjData.
    contacts
        Whether to record the forces of contacts.
    """

    def __init__(self, model: Any, data: Any, contacts: bool = False) -> None:
        package = engine_package("mujoco")
        self._package, self._model, self._data = package, model, data
        shapes = package.mjtGeom
        owner, kind = model.geom_bodyid, model.geom_type
        solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        static = solid & (model.body_weldid[owner] == WORLD)
        moving = [b for b in range(1, model.nbody) if model.body_mass[b] > 0.0 and model.body_weldid[b] != WORLD]
        if not moving:
            raise RecordingError("mujoco: the model has no body with a mass that can move")
        still, planes = (np.flatnonzero((kind == own) & static) for own in (shapes.mjGEOM_SPHERE, shapes.mjGEOM_PLANE))
        self._moving, self._still = np.array(moving), still
        package.mj_kinematics(model, data)
        package.mj_comPos(model, data)
        own = [np.flatnonzero(owner == b) for b in moving]
        free = np.array([_is_free_sphere(package, model, b, geoms) for b, geoms in zip(moving, own, strict=True)])
        radius = []  # m, radius of a sphere about the body's centre of mass that contains all its shapes
        for b, geoms in zip(moving, own, strict=True):
            away = np.linalg.norm(data.geom_xpos[geoms] - data.xipos[b], axis=1) + model.geom_rbound[geoms]
            radius.append(away.max() if len(geoms) else np.sqrt(2.5 * model.body_inertia[b].max() / model.body_mass[b]))
        self._simple = bool(free.all())
        self._joint = model.body_jntadr[self._moving]
        # the end that each shape belongs to: a body, a plane (n or above), or -1 for none
        end_of_body = np.full(model.nbody, -1)
        end_of_body[moving] = np.arange(len(moving))
        self._end_of = end_of_body[owner]
        self._end_of[np.concatenate((still, planes))] = len(moving) + np.arange(len(still) + len(planes))
        self._contacts, self._wrench = contacts, np.empty(6)
        # velocities of free joints are in the frame of the world, spins in the frame of the body
        self._free = np.flatnonzero(free)
        self._freedoms = model.jnt_dofadr[self._joint[self._free]][:, None] + np.arange(6)
        self._velocity = np.empty(6)
        n = len(moving) + len(still)
        self._force, self._torque = np.zeros((n, 3)), np.zeros((n, 3))
        self._position, self._speed, self._spin = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        self._turn = np.zeros((n, 4))
        self._turn[:, 3] = 1.0
        self._position[len(moving) :] = data.geom_xpos[self._still]
        if self._simple:
            self._places = model.jnt_qposadr[self._joint][:, None] + np.arange(7)
            self._rates = model.jnt_dofadr[self._joint][:, None] + np.arange(6)
        names = [*(model.body(b).name for b in moving), *(model.geom(g).name for g in still)]
        self.model = Model(
            engine=named_version("mujoco"),
            mass=np.concatenate((model.body_mass[self._moving], np.ones(len(still)))),
            radius=np.concatenate((radius, model.geom_size[self._still, 0])),
            inertia=np.concatenate((model.body_inertia[self._moving].mean(axis=1), np.ones(len(still)))),
            names=[name or f"body {k}" for k, name in enumerate(names)],
            fixed=np.arange(n) >= len(moving),
            judged=np.concatenate((free, np.ones(len(still), bool))),
            gravity=model.opt.gravity,
            planes=[_plane(model, data, int(g)) for g in planes],
            friction=_common_friction(package, model, solid),
            time_step=model.opt.timestep,
        )

    def state(self) -> State:
        """Return the present state, with the contacts of the last step."""
        data, k = self._data, len(self._moving)
        if self._simple:
            # after a step, `qpos` and `qvel` belong to the end of the step, but `xpos` still belongs to its start
            places, rates = data.qpos[self._places], data.qvel[self._rates]
            self._position[:k] = places[:, :3]
            self._turn[:k, :3], self._turn[:k, 3] = places[:, 4:], places[:, 3]
            self._speed[:k] = rates[:, :3]
            self._spin[:k] = rotated(self._turn[:k], rates[:, 3:])
        else:
            package, model = self._package, self._model
            package.mj_kinematics(model, data)
            package.mj_comPos(model, data)
            package.mj_comVel(model, data)
            self._position[:k] = data.xipos[self._moving]
            turn = data.xquat[self._moving]
            self._turn[:k, :3], self._turn[:k, 3] = turn[:, 1:], turn[:, 0]
            for row, body in enumerate(self._moving):
                package.mj_objectVelocity(model, data, package.mjtObj.mjOBJ_BODY, int(body), self._velocity, 0)
                # velocity and spin of the centre of mass
                self._spin[row], self._speed[row] = self._velocity[:3], self._velocity[3:]
        self._read_forces()
        forces = self.forces() if self._contacts else None
        state = State(data.time, self._position, self._speed, self._turn, self._spin, forces)
        state.force, state.torque = self._force, self._torque
        return state

    def _read_forces(self) -> None:
        """Read the forces on free spheres in the last step: applied forces, the medium, compensation of gravity."""
        data, free = self._data, self._free
        given = (data.qfrc_applied + data.qfrc_passive)[self._freedoms]
        applied = data.xfrc_applied[self._moving[free]]
        self._force[free] = given[:, :3] + applied[:, :3]
        axis, w = self._turn[free, :3], self._turn[free, 3:]
        twice = 2.0 * np.cross(axis, given[:, 3:])
        self._torque[free] = given[:, 3:] + w * twice + np.cross(axis, twice) + applied[:, 3:]

    def forces(self) -> Records:
        """Return the contacts of the last step with their forces, (m,) `CONTACT`, between bodies and planes."""
        contacts = self._data.contact
        ends = self._end_of[contacts.geom].reshape(-1, 2)
        known = np.flatnonzero((ends >= 0).all(axis=1) & (ends[:, 0] != ends[:, 1]))
        found = np.zeros(len(known), CONTACT)
        if len(known) == 0:
            return found
        local = np.empty((len(known), 3))
        for row, contact in enumerate(known.tolist()):
            self._package.mj_contactForce(self._model, self._data, contact, self._wrench)
            local[row] = self._wrench[:3]
        frames = contacts.frame[known].reshape(-1, 3, 3)  # the normal, from first to second shape, and two tangents
        found["i"], found["j"] = ends[known].T
        found["point"], found["normal"], found["force"] = contacts.pos[known], frames[:, 0], local[:, 0]
        found["friction"] = local[:, 1:2] * frames[:, 1] + local[:, 2:] * frames[:, 2]
        return found


def mujoco(model: Any, data: Any, contacts: bool = True) -> MuJoCoSource:
    """Return the source of a mujoco.MjModel and mujoco.MjData, with or without contact forces; see `MuJoCoSource`."""
    return MuJoCoSource(model, data, contacts)


def _is_free_sphere(package: Any, model: Any, body: int, geoms: IntArray) -> bool:
    """Return whether a body is a single sphere about its centre of mass, and moves freely."""
    return (
        model.body_jntnum[body] == 1
        and model.jnt_type[model.body_jntadr[body]] == package.mjtJoint.mjJNT_FREE
        and not np.any(model.body_parentid == body)
        and len(geoms) == 1
        and model.geom_type[geoms[0]] == package.mjtGeom.mjGEOM_SPHERE
        and bool(np.abs(model.body_ipos[body]).max() == 0.0)
        and bool(np.abs(model.geom_pos[geoms[0]]).max() == 0.0)
    )


def _common_friction(package: Any, model: Any, solid: BoolArray) -> float | None:
    """Return the friction coefficient that all contacts share; None if shapes or pairs of shapes differ."""
    overridden = model.opt.enableflags & package.mjtEnableBit.mjENBL_OVERRIDE
    rubs = np.where(model.geom_condim[solid] > 1, model.geom_friction[solid, 0], 0.0)
    alike = len(rubs) > 0 and model.npair == 0 and not overridden and np.ptp(rubs) == 0.0
    return float(rubs[0]) if alike else None


def _plane(model: Any, data: Any, geom: int) -> Plane:
    normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    x, y, z = (float(v) for v in normal)
    return Plane((x, y, z), float(normal @ data.geom_xpos[geom]), model.geom(geom).name)


BOUNCE = 20.0  # steps per bounce, so that the spring is resolved
IMPEDANCE = 0.99  # impedance of a contact; 1 would be rigid, which MuJoCo does not allow


class MuJoCo(SteppedEngine):
    """Runs scenes with MuJoCo's default integrator and solver."""

    name = package = "mujoco"
    differences = (f"contacts are springs whose bounces take {BOUNCE:g} steps",)

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        engine, problem, dt = engine_package(self.package), problem_of(self.name, scene), dt_of(setting)
        spec = engine.MjSpec()
        spec.option.timestep = dt
        spec.option.gravity = problem.field
        spec.option.cone = engine.mjtCone.mjCONE_ELLIPTIC
        spec.memory = 1 << 28
        if not problem.collides:
            spec.option.disableflags |= engine.mjtDisableBit.mjDSBL_CONTACT
        for k, normal in enumerate(problem.planes.normal):
            place = problem.planes.offset[k] * normal
            plane = spec.worldbody.add_geom(
                type=engine.mjtGeom.mjGEOM_PLANE, pos=place, quat=_turn(normal), size=[0.0, 0.0, 1.0]
            )
            plane.name = problem.planes.name[k]
            plane.priority = 1  # contacts then use the plane's own coefficients
            _set_law(plane, problem.at_planes[k], dt)
        start = problem.start
        alike = len(set(start.name)) < len(start.name)
        names = [f"{name} {k}" for k, name in enumerate(start.name)] if alike else start.name
        for k in range(len(start.mass)):
            body = spec.worldbody.add_body(pos=start.position[k], name=names[k])
            if not start.fixed[k]:
                body.add_freejoint()
            ball = body.add_geom(
                type=engine.mjtGeom.mjGEOM_SPHERE, size=[start.radius[k], 0.0, 0.0], mass=float(start.mass[k])
            )
            _set_law(ball, problem.between, dt)
        model = spec.compile()
        data = engine.MjData(model)
        moving = np.flatnonzero(~start.fixed)
        data.qvel[:] = np.concatenate((start.velocity[moving], start.angular_velocity[moving]), axis=1).ravel()
        source: Source = MuJoCoSource(model, data)
        if start.fixed.any():
            # MuJoCo puts fixed bodies last, without names
            source = InOrder(source, np.argsort(np.argsort(start.fixed, kind="stable")), names)
        return EngineSimulation(source, lambda: engine.mj_step(model, data), dt)


def _set_law(geom: Any, law: Coefficients, dt: float) -> None:
    """Set the friction of a shape, and the spring that reproduces the coefficient of restitution."""
    # x'' + 2 ζ ω x' + ω² x = 0 bounces with e = exp(-π ζ / √(1 - ζ²)) after the time π / (ω √(1 - ζ²))
    if law.restitution > 0.0:
        logarithm = math.log(law.restitution)
        damping = -logarithm / math.sqrt(math.pi**2 + logarithm**2)
    else:
        damping = 1.0
    frequency = math.pi / (BOUNCE * dt * math.sqrt(max(1.0 - damping**2, 0.05)))
    geom.solref = [-(frequency**2), -2.0 * damping * frequency]
    geom.solimp = [IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0]
    geom.friction = [law.kinetic_friction, 0.0, 0.0]
    geom.condim = 3 if law.kinetic_friction > 0.0 else 1


def _turn(normal: FloatArray) -> list[float]:
    """Return the quaternion, wxyz, that rotates z into a normal."""
    w, axis = 1.0 + normal[2], np.cross([0.0, 0.0, 1.0], normal)
    if w < 1e-12:
        return [0.0, 1.0, 0.0, 0.0]
    length = math.sqrt(w * w + float(axis @ axis))
    return [w / length, *(axis / length).tolist()]
