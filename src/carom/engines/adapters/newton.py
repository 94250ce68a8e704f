"""Newton: its recorder, and the engine that `crosscheck` compares.

Newton moves rigid bodies by extended position-based dynamics (XPBD), on the processor, in single precision. The
recorder audits free spheres; bodies with other joints or shapes are only drawn.

Newton combines coefficients of restitution and friction by the mean. Bodies get the coefficients of the scene; a plane
gets values such that each mean equals the plane's own coefficient. A contact acts only on bodies that overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from carom.arrays import FloatArray, Records, SingleArray
from carom.engines.engine import EngineSimulation, SteppedEngine, dt_of, problem_of
from carom.engines.source import CONTACT, Model, Plane, State, engine_package, named_version
from carom.errors import RecordingError
from carom.lab.compared_run import Setting
from carom.scene.load import Scene
from carom.scene.schema import Coefficients

WORLD = -1  # the body that owns static shapes
_NAMES = ("body_label", "body_key")  # attributes that hold the names, in newer and older versions


class NewtonSource:
    """The bodies of a Newton model.

    Parameters
    ----------
    model
        newton.Model.
    now
        Function that returns the present state and its time in s, ``lambda: (state_0, time)``: Newton's states do not
        contain their time, and a step swaps two states.
    forces
        The newton.Contacts of the solver's steps, and the array ``contact_f`` that the solver fills.
    """

    def __init__(self, model: Any, now: Callable[[], tuple[Any, float]], forces: tuple[Any, Any] | None = None) -> None:
        package = engine_package("newton")
        self._now, self._centre = now, model.body_com.numpy().astype(np.float64)
        self._off_centre = bool(self._centre.any())  # whether any body's centre of mass differs from its origin
        mass = model.body_mass.numpy().astype(np.float64)
        if len(mass) == 0:
            raise RecordingError("newton: the model has no rigid body")
        owner, kind, scale = model.shape_body.numpy(), model.shape_type.numpy(), model.shape_scale.numpy()
        place = model.shape_transform.numpy()
        sphere = (kind == int(package.GeoType.SPHERE)) & (owner != WORLD)
        count = np.bincount(owner[owner != WORLD], minlength=len(mass))
        radius = np.zeros(len(mass))
        radius[owner[sphere]] = scale[sphere, 0]
        tied = np.zeros(len(mass), bool)  # whether a body has a joint other than a free joint
        jointed = np.stack((model.joint_parent.numpy(), model.joint_child.numpy()))
        jointed = jointed[:, model.joint_type.numpy() != int(package.JointType.FREE)]
        tied[jointed[jointed != WORLD]] = True
        simple = (radius > 0.0) & (count == 1) & ~tied & (np.abs(self._centre).max(axis=1) == 0.0)
        inertia = model.body_inertia.numpy().astype(np.float64).trace(axis1=1, axis2=2) / 3.0
        size = np.where(radius > 0.0, radius, np.sqrt(2.5 * inertia / np.where(mass > 0.0, mass, 1.0)))
        gravity = np.atleast_2d(model.gravity.numpy() if hasattr(model.gravity, "numpy") else model.gravity)
        if len(gravity) > 1 and np.ptp(gravity, axis=0).any():
            raise RecordingError("newton: the worlds of the model differ in gravity; record one of them")
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
        self._forces, self._end_of = forces, np.where(owner == WORLD, -1, owner)
        self._end_of[static] = len(mass) + np.arange(len(static))

    def state(self) -> State:
        """Return the present state."""
        state, time = self._now()
        pose, rate = state.body_q.numpy(), state.body_qd.numpy()
        position = pose[:, :3]
        if self._off_centre:
            position = position + _turned(pose[:, 3:].astype(np.float64), self._centre)
        contacts = None if self._forces is None else self._contacts(pose.astype(np.float64), *self._forces)
        return State(float(time), position, rate[:, :3], pose[:, 3:], rate[:, 3:], contacts)

    def _contacts(self, pose: FloatArray, contacts: Any, force: Any) -> Records:
        """Return the contacts of the last step with their forces, (m,) `CONTACT`, between bodies and planes."""
        count = int(contacts.rigid_contact_count.numpy()[0])
        shapes = [getattr(contacts, f"rigid_contact_shape{k}").numpy()[:count] for k in (0, 1)]
        ends = np.stack([self._end_of[each] for each in shapes], axis=1).reshape(-1, 2)
        known = np.flatnonzero((ends >= 0).all(axis=1) & (ends[:, 0] != ends[:, 1]))
        found = np.zeros(len(known), CONTACT)
        found["i"], found["j"] = ends[known].T
        found["normal"] = contacts.rigid_contact_normal.numpy()[known]
        # contact points, and their offsets by the thickness of a shape, are in body frames
        moving = (ends[known] >= len(pose)).argmin(axis=1)
        body = ends[known, moving]
        place = [
            getattr(contacts, f"rigid_contact_point{k}").numpy() + getattr(contacts, f"rigid_contact_offset{k}").numpy()
            for k in (0, 1)
        ]
        local = np.stack(place)[moving, known].astype(np.float64)
        found["point"] = pose[body, :3] + _turned(pose[body, 3:], local)
        on_second = -force.numpy()[known, :3].astype(np.float64)
        found["force"] = np.einsum("ij,ij->i", on_second, found["normal"])
        found["friction"] = on_second - found["force"][:, None] * found["normal"]
        return found


newton = NewtonSource  # name of this source in `carom.record`


def _plane(place: SingleArray, number: int) -> Plane:
    """Return a plane from its position and rotation; the normal is the z axis of the plane's own frame."""
    turn = place[None, 3:].astype(np.float64)
    normal = _turned(turn, np.array([[0.0, 0.0, 1.0]]))[0]
    x, y, z = (float(v) for v in normal)
    return Plane((x, y, z), float(normal @ place[:3]), f"plane {number}")


def _turned(quaternion: FloatArray, local: FloatArray) -> FloatArray:
    """Rotate vectors (n, 3) by quaternions xyzw."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, local)
    return np.asarray(local + w * twice + np.cross(axis, twice))


ITERATIONS = 2  # iterations per step, the solver's default


class Newton(SteppedEngine):
    """Runs scenes with Newton's solver XPBD, with its default iterations and relaxation."""

    name = package = "newton"
    differences = (f"single precision, XPBD with {ITERATIONS} iterations",)

    def ensure_installed(self) -> None:
        """Raise ExperimentError if Newton is not installed; silence Warp's messages about loading."""
        with suppress(RecordingError):  # without Warp there is no Newton; the missing package is reported below
            warp = engine_package("warp", "warp-lang")
            warp.config.log_level = warp.LOG_ERROR
        super().ensure_installed()

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        _compile()
        return self._build(scene, dt_of(setting))

    def _build(self, scene: Scene, dt: float) -> EngineSimulation:
        engine, warp = engine_package(self.package), engine_package("warp", "warp-lang")
        problem = problem_of(self.name, scene)
        start, law = problem.start, problem.between
        builder = engine.ModelBuilder(gravity=problem.field.tolist())
        for k in range(len(start.mass)):
            place = warp.transform(start.position[k].tolist(), warp.quat_identity())
            mass, inertia = (0.0, 0.0) if start.fixed[k] else (float(start.mass[k]), float(start.inertia[k]))
            tensor = warp.mat33(np.diag(np.full(3, inertia)))
            body = builder.add_body(xform=place, mass=mass, inertia=tensor, lock_inertia=True, label=start.name[k])
            builder.add_shape_sphere(body, radius=float(start.radius[k]), cfg=_config(engine, law, problem.collides))
        for normal, offset, name, own in zip(
            problem.planes.normal, problem.planes.offset, problem.planes.name, problem.at_planes, strict=True
        ):
            equation = (*normal.tolist(), -float(offset))
            # the mean of this coefficient and of the bodies' coefficient equals the plane's own coefficient
            mirrored = Coefficients(*(2.0 * np.array(own) - law).tolist())
            config = _config(engine, mirrored, problem.collides)
            builder.add_shape_plane(plane=equation, width=0.0, length=0.0, cfg=config, label=name)
        model = builder.finalize(device="cpu")
        solver = engine.solvers.SolverXPBD(model, iterations=ITERATIONS, enable_restitution=True)
        pipeline = engine.CollisionPipeline(model)
        contacts, control = pipeline.contacts(), model.control()
        states, steps = [model.state(), model.state()], [0]
        rates = np.concatenate((start.velocity, start.angular_velocity), axis=1)
        rates[start.fixed] = 0.0
        states[0].body_qd.assign(rates.astype(np.float32))

        def step() -> None:
            states[0].clear_forces()
            pipeline.collide(states[0], contacts)
            solver.step(states[0], states[1], control, contacts, dt)
            states.reverse()
            steps[0] += 1

        return EngineSimulation(NewtonSource(model, lambda: (states[0], steps[0] * dt)), step, dt)


@cache
def _compile() -> None:
    """Make one step, so that Warp compiles its kernels before the run; this takes half a minute, once on a machine."""
    ball = {"mass": 1.0, "radius": 0.5}
    bodies = [ball | {"position": [0.0, 0.0, height]} for height in (0.5, 1.5)]
    plane = {"normal": [0.0, 0.0, 1.0], "point": [0.0, 0.0, 0.0]}
    document = {"body": bodies, "plane": [plane], "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}}
    Newton()._build(Scene.from_dict(document), 0.001).step()


def _config(engine: Any, law: Coefficients, collides: bool) -> Any:
    return engine.ModelBuilder.ShapeConfig(
        density=0.0,
        mu=law.kinetic_friction,
        restitution=law.restitution,
        mu_torsional=0.0,
        mu_rolling=0.0,
        has_shape_collision=collides,
    )
