"""PyBullet: its recorder, and the engine that `crosscheck` compares.

PyBullet moves rigid bodies by impulses with one coefficient of friction, in double precision. The recorder audits
spheres. Bodies with joints or other shapes are drawn, but not judged.

PyBullet multiplies the coefficients of two bodies. Bodies therefore get the square root of the scene's coefficients,
and a plane gets values such that each product equals the plane's own coefficient. PyBullet's default damping is
switched off.
"""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Iterable
from dataclasses import replace
from itertools import chain, repeat
from typing import Any

import numpy as np

from carom.arrays import FloatArray, Records
from carom.engines.engine import EngineSimulation, SteppedEngine, dt_of, problem_of, refuse
from carom.engines.source import CONTACT, SPHERE, Model, Plane, State, engine_package, named_version
from carom.errors import RecordingError
from carom.lab.compared_run import Setting
from carom.scene.load import Scene

BASE = -1  # the number of a body's first link
SLOW = 200  # number of bodies beyond which copying their states takes more than a thirtieth of a step
SELDOM = 5  # steps per frame for 1000 bodies, whose states take a sixth of a step to read
_MARK = "carom"  # key of the user data that marks bodies while bodies come and go
UNNAMED = ("", "baseLink", "link0")  # names that PyBullet gives to unnamed bodies


class PyBulletSource:
    """The bodies of a physics server.

    The state of a body takes two calls, so a `Recorder` of 1000 bodies records every fifth frame by default. PyBullet
    reports neither the time step nor the field, so both must be passed as they were set.

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
    contacts
        Whether to record the forces of contacts.
    """

    def __init__(
        self,
        time_step: float = 1.0 / 240.0,
        gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        client: int = 0,
        steps_per_frame: int = 1,
        contacts: bool = False,
    ) -> None:
        package = engine_package("pybullet")
        self._package, self._client, self.frames = package, client, 0
        self._stride = time_step * steps_per_frame
        everything = [package.getBodyUniqueId(k, client) for k in range(package.getNumBodies(client))]
        shapes = {body: package.getCollisionShapeData(body, BASE, client) for body in everything}
        planes = [b for b in everything if _is_plane(package, shapes[b])]
        self.bodies = [b for b in everything if b not in planes]  # unique ids
        if not self.bodies:
            raise RecordingError("pybullet: the physics server has no body besides planes")
        self._forces = contacts
        self._end_of = {body: end for end, body in enumerate([*self.bodies, *planes])}
        dynamics = [package.getDynamicsInfo(b, BASE, client) for b in self.bodies]
        mass = np.array([found[0] for found in dynamics])
        spheres = np.array([_is_sphere(package, b, shapes[b], client) for b in self.bodies])
        known = zip(self.bodies, spheres, strict=True)
        radius = np.array([shapes[b][0][3][0] if sphere else _reach(package, b, client) for b, sphere in known])
        spheres &= ~np.isin(self.bodies, _constrained(package, client))
        own_inertia = [np.mean(found[2]) for found in dynamics]
        labels = ([text.decode(errors="replace") for text in package.getBodyInfo(b, client)] for b in self.bodies)
        names = [name or base for base, name in labels]
        self.model = Model(
            engine=named_version("pybullet"),
            mass=np.where(mass > 0.0, mass, 1.0),
            radius=radius,
            # PyBullet marks a fixed body by the mass 0; here it gets 1 kg
            inertia=np.where(mass > 0.0, own_inertia, SPHERE * radius**2),
            names=[f"body {k}" if name in UNNAMED else name for k, name in enumerate(names)],
            fixed=mass == 0.0,
            judged=spheres,
            gravity=gravity,
            planes=_planes_of(package, client),
            friction=_common_friction(package, everything, client),
            time_step=time_step,
            every=calls_per_frame(len(self.bodies)),
        )

    def stepped(self) -> None:
        """Count the steps up to the next frame."""
        self.frames += 1

    def state(self) -> State:
        """Return the present state."""
        # PyBullet has no call for several bodies: these two calls per body are most of the cost of a frame
        places = map(self._package.getBasePositionAndOrientation, self.bodies, repeat(self._client))
        rates = map(self._package.getBaseVelocity, self.bodies, repeat(self._client))
        place, rate = _rows(places, len(self.bodies), 7), _rows(rates, len(self.bodies), 6)
        forces = self.forces() if self._forces else None
        return State(self.frames * self._stride, place[:, :3], rate[:, :3], place[:, 3:], rate[:, 3:], forces)

    def forces(self) -> Records:
        """Return the contacts of the last step with their forces, (m,) `CONTACT`."""
        rows = self._package.getContactPoints(physicsClientId=self._client)
        if not rows:
            return np.zeros(0, CONTACT)
        _, a, b, _, _, _, point, normal, _, push, f, u, g, v = zip(*rows, strict=True)
        found = np.zeros(len(rows), CONTACT)
        ends = [[self._end_of.get(body, -1) for body in each] for each in (b, a)]
        found["i"], found["j"], found["point"], found["normal"], found["force"] = *ends, point, normal, push
        # PyBullet's normal points from B to A, and its friction acts on A
        found["friction"] = np.array(f)[:, None] * np.array(u) + np.array(g)[:, None] * np.array(v)
        return np.compress((found["i"] >= 0) & (found["j"] >= 0) & (found["i"] != found["j"]), found)


class ChangingPyBulletSource:
    """The bodies of a physics server while bodies are added and removed; see `pybullet`.

    PyBullet reuses the unique ids of bodies. This source therefore marks each body with user data of the key "carom",
    which PyBullet removes with the body. Planes are recorded as they are at the start.
    """

    def __init__(self, time_step: float, gravity: tuple[float, float, float], *others: Any) -> None:
        self._arguments = (time_step, gravity, *others)
        self._package, self._client, self._frames = engine_package("pybullet"), int(others[0]), 0
        self._marked = 0  # number of bodies marked so far
        self._ids: dict[int, int] = {}  # carom's id of each body, by its unique id on the server
        self._source: PyBulletSource | None = None  # the source of these bodies; None if there are none
        self._find()
        no_body = Model(engine=named_version("pybullet"), mass=[], radius=[], gravity=gravity, time_step=time_step)
        planes = _planes_of(self._package, self._client)
        self.model = replace(no_body, planes=planes) if self._source is None else self._source.model

    def stepped(self) -> None:
        """Count the steps up to the next frame."""
        self._frames += 1

    def state(self) -> State:
        """Return the present state."""
        self._find()
        source = self._source
        if source is None:
            time, nobody = self._frames * self._arguments[0] * self._arguments[3], np.empty((0, 3))
            contacts = np.zeros(0, CONTACT) if self._arguments[4] else None
            return State(time, nobody, nobody, np.empty((0, 4)), nobody, contacts, np.empty(0, np.int64))
        source.frames = self._frames
        state, model = source.state(), source.model
        state.ids = np.array([self._ids[body] for body in source.bodies])
        state.mass, state.radius = model.mass, model.radius
        state.names = ["" if name == f"body {k}" else name for k, name in enumerate(model.names or ())]
        state.fixed, state.judged = model.fixed, model.judged
        return state

    def _find(self) -> None:
        """Mark new bodies; make a source for the present bodies if they changed."""
        package, client = self._package, self._client
        there = [package.getBodyUniqueId(k, client) for k in range(package.getNumBodies(client))]
        new = [body for body in there if package.getUserDataId(body, _MARK, physicsClientId=client) < 0]
        if not new and len(there) == len(self._ids):
            return
        for body in new:
            self._marked += 1
            package.addUserData(body, _MARK, str(self._marked), physicsClientId=client)
            self._ids[body] = self._marked
        self._ids = {body: self._ids[body] for body in there}
        planes = len(_planes_of(package, client))
        self._source = PyBulletSource(*self._arguments) if len(there) > planes else None


def pybullet(
    time_step: float = 1.0 / 240.0,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    client: int = 0,
    steps_per_frame: int = 1,
    contacts: bool = True,
    *,
    changing: bool = False,
) -> PyBulletSource | ChangingPyBulletSource:
    """Return the source of a physics server; see `PyBulletSource`.

    ``changing`` says whether bodies are added or removed during the recording. With ``changing``, carom marks the
    bodies with user data, "carom".
    """
    kind = ChangingPyBulletSource if changing else PyBulletSource
    return kind(time_step, gravity, client, steps_per_frame, contacts)


def calls_per_frame(bodies: int) -> int:
    """Return the number of steps per frame: enough for copying the states to take only a small fraction of the time."""
    return min(SELDOM, 1 + bodies // SLOW)


def _rows(pairs: Iterable[Any], count: int, width: int) -> FloatArray:
    """Return pairs of tuples as rows of numbers."""
    flat = chain.from_iterable(chain.from_iterable(pairs))
    return np.fromiter(flat, np.float64, count * width).reshape(count, width)


def _is_sphere(package: Any, body: int, shapes: Any, client: int) -> bool:
    """Return whether a body is one sphere about its centre of mass, without joints."""
    one = len(shapes) == 1 and shapes[0][2] == package.GEOM_SPHERE and not any(shapes[0][5])
    return bool(one and package.getNumJoints(body, client) == 0)


def _constrained(package: Any, client: int) -> list[int]:
    """Return the bodies that constraints hold, for instance joints created between bodies."""
    numbers = [package.getConstraintUniqueId(k, client) for k in range(package.getNumConstraints(client))]
    return [body for number in numbers for body in package.getConstraintInfo(number, client)[0:3:2]]


def _common_friction(package: Any, bodies: list[int], client: int) -> float | None:
    """Return the friction coefficient (a product) that all contacts share; None if bodies or links differ."""
    if any(package.getNumJoints(body, client) for body in bodies):
        return None
    own = {package.getDynamicsInfo(body, BASE, client)[1] for body in bodies}
    return float(own.pop() ** 2) if len(own) == 1 else None


def _reach(package: Any, body: int, client: int) -> float:
    low, high = package.getAABB(body, BASE, client)
    return float(0.5 * np.linalg.norm(np.subtract(high, low)))


def _is_plane(package: Any, shapes: Any) -> bool:
    return len(shapes) == 1 and bool(shapes[0][2] == package.GEOM_PLANE)


def _planes_of(package: Any, client: int) -> list[Plane]:
    """Return the planes of a server, in the order of its bodies."""
    bodies = [package.getBodyUniqueId(k, client) for k in range(package.getNumBodies(client))]
    shapes = {body: package.getCollisionShapeData(body, BASE, client) for body in bodies}
    planes: list[Plane] = []
    for body in (each for each in bodies if _is_plane(package, shapes[each])):
        place, turn = package.getBasePositionAndOrientation(body, client)
        normal = np.array(package.getMatrixFromQuaternion(turn)).reshape(3, 3) @ np.array(shapes[body][0][3])
        x, y, z = (float(v) for v in normal / np.linalg.norm(normal))
        offset = float(normal @ np.array(place) / np.linalg.norm(normal))
        planes.append(Plane((x, y, z), offset, f"plane {len(planes)}"))
    return planes


ITERATIONS = 50  # iterations of the solver, PyBullet's default
_DAMPING = ("linearDamping", "angularDamping", "rollingFriction", "spinningFriction", "contactProcessingThreshold")
_NO_DAMPING = dict.fromkeys(_DAMPING, 0.0)


class PyBullet(SteppedEngine):
    """Runs scenes with PyBullet's default solver."""

    name = package = "pybullet"

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if PyBullet cannot represent a scene."""
        problem = problem_of(self.name, scene)
        law, planes = problem.between, problem.at_planes
        bounces = law.restitution == 0.0 and any(plane.restitution > 0.0 for plane in planes)
        rubs = law.kinetic_friction == 0.0 and any(plane.kinetic_friction > 0.0 for plane in planes)
        what = "a plane that {} where bodies do not: PyBullet multiplies the coefficients"
        refuse(self.name, {what.format("bounces"): bounces, what.format("rubs"): rubs})

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        engine, problem, dt = engine_package(self.package), problem_of(self.name, scene), dt_of(setting)
        self.check(scene)
        client = engine.connect(engine.DIRECT)
        engine.setTimeStep(dt, client)
        engine.setGravity(*problem.field.tolist(), physicsClientId=client)
        engine.setPhysicsEngineParameter(
            numSolverIterations=ITERATIONS, restitutionVelocityThreshold=0.0, physicsClientId=client
        )
        start, law = problem.start, problem.between
        bounce, rub = math.sqrt(law.restitution), math.sqrt(law.kinetic_friction)
        bodies = []
        for k in range(len(start.mass)):
            ball = engine.createCollisionShape(engine.GEOM_SPHERE, radius=start.radius[k], physicsClientId=client)
            mass = 0.0 if start.fixed[k] else start.mass[k]
            body = engine.createMultiBody(mass, ball, basePosition=start.position[k].tolist(), physicsClientId=client)
            rates = start.velocity[k].tolist(), start.angular_velocity[k].tolist()
            engine.resetBaseVelocity(body, *rates, physicsClientId=client)
            law_of_body = {"restitution": bounce, "lateralFriction": rub} | _NO_DAMPING
            engine.changeDynamics(body, BASE, physicsClientId=client, **law_of_body)
            bodies.append(body)
        for normal, offset, own in zip(problem.planes.normal, problem.planes.offset, problem.at_planes, strict=True):
            shape = engine.createCollisionShape(engine.GEOM_PLANE, planeNormal=normal.tolist(), physicsClientId=client)
            plane = engine.createMultiBody(0.0, shape, basePosition=(offset * normal).tolist(), physicsClientId=client)
            restitution = own.restitution / bounce if bounce else 0.0
            friction = own.kinetic_friction / rub if rub else 0.0
            engine.changeDynamics(
                plane, BASE, restitution=restitution, lateralFriction=friction, physicsClientId=client
            )
            bodies.append(plane)
        for one, other in itertools.combinations(bodies, 2) if not problem.collides else ():
            engine.setCollisionFilterPair(one, other, BASE, BASE, 0, physicsClientId=client)
        x, y, z = (float(g) for g in np.asarray(problem.field))
        source = PyBulletSource(dt, (x, y, z), client)
        source.model = problem.named(source.model)
        weakref.finalize(source, engine.disconnect, client)  # else later calls without a client would use this client

        def step() -> None:
            engine.stepSimulation(client)
            source.stepped()

        return EngineSimulation(source, step, dt)
