"""Box3D through the package robox3d: its recorder, and the engine that `crosscheck` compares.

Box3D has soft contact constraints and substeps, in single precision. The recorder checks free spheres and only draws
other shapes.

Box3D has no planes. A plane becomes the face of a static box as wide as the bodies can travel. Box3D combines
restitution by the maximum and friction by the geometric mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from carom.arrays import FloatArray, IntArray, Records, SingleArray
from carom.engines.engine import EngineSimulation, SteppedEngine, dt_of, problem_of, refuse
from carom.engines.source import CONTACT, Model, Plane, State, StateMemory, engine_package, named_version
from carom.errors import RecordingError
from carom.lab.compared_run import Setting
from carom.scene.load import Scene

PACKAGE = "robox3d"
_NEAR = 0.2  # largest distance of a contact point from its plane, divided by its distance from the centre
_PARALLEL = 1e-4  # largest 1 - cos(angle) between the normals of a contact and of its plane
_LARGEST = 64  # largest group of points whose impulses are computed from velocities
_ROUNDED = 1e-6  # smallest change of velocity, relative to the speed, that is not rounding in single precision
_WEIGHT = 1e-3  # weight of the engine's impulses in the fit; the observed velocity changes have errors below 1e-6
MOST_SHAPES = 64  # shapes examined for each body


class Box3DSource:
    """The bodies of a world. Box3D computes in single precision.

    The audit covers dynamic bodies of one sphere without joints. Other bodies are drawn as spheres of their size;
    static bodies are spheres that never move.

    Parameters
    ----------
    world
        A robox3d.World, with its bodies and shapes.
    planes
        The planes of the world's static shapes, such as the top of a large box; Box3D itself has no planes.
    contacts
        Whether to record the forces of contacts; see `Box3DForces`.
    """

    def __init__(self, world: Any, planes: tuple[Plane, ...] = (), contacts: bool = False) -> None:
        package = engine_package(PACKAGE)
        self._world, self._backend = world, engine_package(f"{PACKAGE}._ffi", PACKAGE)
        lib = self._backend.lib
        bodies = [body for body in world.bodies if lib.b3Body_IsValid(body.id)]
        sized = [_sphere_of(self._backend, body) for body in bodies]
        dynamic = np.array([lib.b3Body_GetType(body.id) == lib.b3_dynamicBody for body in bodies], dtype=bool)
        shown = [k for k, size in enumerate(sized) if dynamic[k] or (size is not None and not size[1])]
        if not dynamic.any():
            raise RecordingError("box3d: the world has no dynamic body")
        chosen, moves = [bodies[k] for k in shown], dynamic[shown]
        self.bodies = chosen
        self._group = package.BodyGroup(chosen)
        jointed = bool(lib.b3World_GetCounters(world.id).jointCount)
        known = [sized[k] for k in shown]
        judged = [size is not None and not size[1] and not jointed for size in known]
        self._forces = Box3DForces(self._backend, world, chosen, judged, planes) if contacts else None
        mass = np.array([body.mass for body in chosen])
        # bodies without a sphere are drawn as spheres of water of the same mass
        water = (3.0 * np.maximum(mass, 1e-9) / (4.0e3 * np.pi)) ** (1.0 / 3.0)
        self.model = Model(
            engine=_version(),
            mass=np.where(moves, mass, 1.0),
            radius=np.where(
                [size is None for size in known], water, [0.0 if size is None else size[0] for size in known]
            ),
            names=[body.name or f"body {k}" for k, body in enumerate(chosen)],
            fixed=~moves,
            judged=judged,
            gravity=world.gravity,
            planes=planes,
            time_step=world.last_dt,
        )

    def state(self) -> State:
        """Return the present state."""
        snapshot = self.memory()
        self.read(snapshot)
        return snapshot.state

    def memory(self) -> StateMemory:
        """Return memory for one state, in the single precision of Box3D; see `BulkSource`."""
        n = len(self._group)
        block = np.empty(13 * n, np.float32)
        poses, rates = block[: 7 * n].reshape(n, 7), block[7 * n :].reshape(n, 6)
        state = State(0.0, poses[:, :3], rates[:, :3], poses[:, 3:], rates[:, 3:])
        return StateMemory(state, block, (poses, rates))

    def read(self, into: StateMemory) -> None:
        """Let Box3D write directly into the snapshot."""
        poses, rates = into.parts
        self._group.poses(poses)
        self._group.velocities(rates)
        into.state.time = self._world.time
        if self._forces is not None:
            into.state.contacts = self._forces.read(poses[:, :3], rates)


class ChangingBox3DSource:
    """The bodies of a world in which bodies are created and destroyed; see `box3d`."""

    def __init__(self, world: Any, planes: tuple[Plane, ...] = (), contacts: bool = False) -> None:
        self._world, self._planes, self._contacts = world, planes, contacts
        self._lib = engine_package(f"{PACKAGE}._ffi", PACKAGE).lib
        self._ids: list[int] = []  # ids of the world's valid bodies
        self._source: Box3DSource | None = None  # the source of these bodies; None if no body moves
        self._find()
        no_body = Model(engine=_version(), mass=[], radius=[], gravity=world.gravity, planes=planes)
        self.model = no_body if self._source is None else self._source.model

    def state(self) -> State:
        """Return the present state."""
        self._find()
        source = self._source
        if source is None:
            nobody, contacts = np.empty((0, 3)), np.zeros(0, CONTACT) if self._contacts else None
            return State(self._world.time, nobody, nobody, np.empty((0, 4)), nobody, contacts, np.empty(0, np.int64))
        state, model = source.state(), source.model
        state.ids = np.array([_identity(body) for body in source.bodies])
        state.mass, state.radius = model.mass, model.radius
        state.names = ["" if name == f"body {k}" else name for k, name in enumerate(model.names or ())]
        state.fixed, state.judged = model.fixed, model.judged
        return state

    def _find(self) -> None:
        """Make a source for the present bodies if they changed."""
        there = [body for body in self._world.bodies if self._lib.b3Body_IsValid(body.id)]
        ids = [_identity(body) for body in there]
        if ids != self._ids:
            moves = any(self._lib.b3Body_GetType(body.id) == self._lib.b3_dynamicBody for body in there)
            self._source = Box3DSource(self._world, self._planes, self._contacts) if moves else None
            self._ids = ids


def box3d(
    world: Any, planes: tuple[Plane, ...] = (), contacts: bool = False, *, changing: bool = False
) -> Box3DSource | ChangingBox3DSource:
    """Return the source of a robox3d.World; see `Box3DSource`.

    ``changing`` says whether bodies are created or destroyed during the recording.
    """
    return (ChangingBox3DSource if changing else Box3DSource)(world, planes, contacts)


def _identity(body: Any) -> int:
    """Return a number that is unique in the world, although Box3D reuses the indices of destroyed bodies."""
    return int(body.id.index1) << 16 | int(body.id.generation)


def _version() -> str:
    return named_version("box3d", PACKAGE).replace("box3d", f"box3d ({PACKAGE}") + ")"


class _Point(NamedTuple):
    """A contact point of the last step."""

    ends: tuple[int, int]  # ends of the contact, as in `CONTACT`
    place: FloatArray  # (3,) m
    normal: FloatArray  # (3,) unit vector from the first end to the second
    arms: tuple[FloatArray, FloatArray]  # (3,) m, from the centre of each end to the contact
    closing: float  # m/s, closing speed before the step
    impulse: float  # N s, the impulse if all substeps are like the last one
    total: float  # N s, the sum over all substeps; some may be counted twice
    friction: FloatArray  # (3,) N, friction in the last substep


class Box3DForces:
    """Reads the forces of contacts between the recorded bodies, and with planes.

    Box3D has the impulses of its last substep, and sums over all substeps, which may include a substep twice. Neither
    number is the impulse of a step with an impact. Between spheres, impulses are therefore fitted to the observed
    changes of normal velocities, and kept as close as possible to the impulses of the last substep. For other shapes
    and in large piles, the recorded impulses are the impulses of the last substep or, in an impact, the sum over the
    step. Friction is always the friction of the last substep.

    ``backend`` is the module robox3d._ffi, ``spheres`` marks the recorded bodies that are spheres about their centres,
    and ``planes`` are the planes of static shapes.
    """

    def __init__(
        self, backend: Any, world: Any, bodies: list[Any], spheres: Sequence[bool], planes: tuple[Plane, ...]
    ) -> None:
        self._ffi, self._lib, self._world, self._bodies = backend.ffi, backend.lib, world, bodies
        self._number = {body.id.index1: k for k, body in enumerate(bodies)}
        moves = [self._lib.b3Body_GetType(body.id) == self._lib.b3_dynamicBody for body in bodies]
        inverse = [1.0 / body.mass if one else 0.0 for body, one in zip(bodies, moves, strict=True)]
        self._inverse_mass = np.array([*inverse, *(0.0 for _ in planes)])
        self._spheres = np.array([*spheres, *(True for _ in planes)])
        self._normal = np.array([plane.normal for plane in planes], dtype=np.float64).reshape(-1, 3)
        self._offset = np.array([plane.offset for plane in planes], dtype=np.float64)

    def read(self, position: SingleArray, rates: SingleArray) -> Records:
        """Return the contacts, (m,) `CONTACT`, of bodies at (n, 3) m, with velocities and spins (n, 6)."""
        lib, points = self._lib, list[_Point]()
        for k, body in enumerate(self._bodies if self._world.last_dt else ()):  # the time is 0 before the first step
            capacity = lib.b3Body_GetContactCapacity(body.id)
            if capacity == 0:
                continue
            found = self._ffi.new("b3ContactData[]", capacity)
            for contact in found[0 : lib.b3Body_GetContactData(body.id, found, capacity)]:
                shapes = (contact.shapeIdA, contact.shapeIdB)
                ends = [self._number.get(lib.b3Shape_GetBody(shape).index1, -1) for shape in shapes]
                if ends[0] == k or ends[0] < 0:  # otherwise the other body of the contact reports it, too
                    points += self._points(contact, ends, position[k].astype(np.float64), is_first=ends[0] == k)
        impulses = self._impulses(points, rates.astype(np.float64)) if points else np.empty(0)
        step = self._world.last_dt
        rows = [(*p.ends, p.place, p.normal, J / step, p.friction) for p, J in zip(points, impulses, strict=True)]
        return np.array(rows, CONTACT)

    def _points(self, contact: Any, ends: list[int], centre: FloatArray, is_first: bool) -> list[_Point]:
        """Return the points of a contact; one end is a body at ``centre``, (3,) m, and an unknown end is -1."""
        points, step, substep = list[_Point](), self._world.last_dt, self._world.last_substep_dt
        for manifold in contact.manifolds[0 : contact.manifoldCount]:
            normal, friction = _vector(manifold.normal), _vector(manifold.frictionImpulse)
            for point in manifold.points[0 : manifold.pointCount]:
                arms = _vector(point.anchorA), _vector(point.anchorB)
                arm = arms[0] if is_first else arms[1]
                place, outward = centre + arm, -normal if is_first else normal
                near = _NEAR * float(np.linalg.norm(arm))
                first, second = (self._plane(outward, place, near) if end < 0 else end for end in ends)
                if first < 0 or second < 0:  # a shape belongs neither to a recorded body nor to a plane
                    continue
                impulse, total = point.normalImpulse * step / substep, point.totalNormalImpulse
                share = friction / (substep * manifold.pointCount)
                points.append(
                    _Point((first, second), place, normal, arms, -point.normalVelocity, impulse, total, share)
                )
        return points

    def _impulses(self, points: list[_Point], rates: FloatArray) -> FloatArray:
        """Return the normal impulses of points in the last step, (m,) N s."""
        ends = np.array([point.ends for point in points])
        inverse = self._inverse_mass[ends]  # (m, 2)
        closing = np.array([point.closing for point in points])
        guess, total = (np.array([getattr(point, name) for point in points]) for name in ("impulse", "total"))
        mobility = inverse.sum(axis=1)
        stops = np.divide(np.maximum(0.0, closing), mobility, out=np.zeros(len(points)), where=mobility > 0.0)
        found = np.where((stops <= guess) & (guess <= total), guess, total)
        # change of each normal velocity in the step, minus the change by the field
        change, field = closing.copy(), self._world.last_dt * np.asarray(self._world.gravity)
        normal, fastest = np.array([point.normal for point in points]), np.abs(closing)
        for side, sign in ((0, -1.0), (1, 1.0)):
            own = np.minimum(ends[:, side], len(rates) - 1)
            arm = np.array([point.arms[side] for point in points])
            moved = rates[own, :3] + np.cross(rates[own, 3:], arm) - field
            change += np.where(inverse[:, side] > 0.0, sign * np.einsum("ij,ij->i", normal, moved), 0.0)
            fastest = np.maximum(fastest, np.where(inverse[:, side] > 0.0, np.linalg.norm(moved, axis=1), 0.0))
        signed = inverse * (-1.0, 1.0)  # velocity changes of the two ends by a unit impulse
        for group in self._groups(ends):
            if len(group) > _LARGEST or not self._spheres[ends[group]].all():
                continue
            n, share = normal[group], signed[group]
            # velocity changes at each point by unit impulses at the other points
            matrix = np.zeros((len(group), len(group)))
            for a in (0, 1):
                for b in (0, 1):
                    same = ends[group, a][:, None] == ends[group, b][None, :]
                    matrix += np.where(same, (-1.0, 1.0)[a] * share[:, b][None, :] * (n @ n.T), 0.0)
            weight = _WEIGHT * np.diag(np.diag(matrix))
            both = np.vstack((matrix, weight))
            found[group] = nnls(both, np.concatenate((change[group], weight @ found[group])))[0]
        return np.where(mobility * found > _ROUNDED * fastest, found, 0.0)

    def _groups(self, ends: IntArray) -> list[IntArray]:
        """Return groups of points that moving bodies connect, as lists of rows."""
        moves = self._inverse_mass[ends] > 0.0
        row, side = np.nonzero(moves)
        count = len(ends)
        graph = coo_array(
            (np.ones(len(row)), (row, count + ends[row, side])), shape=(count + len(self._inverse_mass),) * 2
        )
        _, label = connected_components(graph, directed=False)
        order = np.argsort(label[:count], kind="stable")
        return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)

    def _plane(self, normal: FloatArray, point: FloatArray, near: float) -> int:
        """Return the end of the nearest plane with this normal within ``near`` m of a point (3,) m; -1 if none."""
        off = np.abs(self._normal @ point - self._offset)
        own = np.flatnonzero((off < near) & (self._normal @ normal > 1.0 - _PARALLEL))
        return len(self._bodies) + int(own[np.argmin(off[own])]) if len(own) else -1


def _vector(value: Any) -> FloatArray:
    return np.array([value.x, value.y, value.z])


def _sphere_of(backend: Any, body: Any) -> tuple[float, bool] | None:
    """Return the radius (m) of a body's sphere, and whether the body has further shapes; None without a sphere."""
    ffi, lib = backend.ffi, backend.lib
    shapes = ffi.new("b3ShapeId[]", MOST_SHAPES)
    count = lib.b3Body_GetShapes(body.id, shapes, MOST_SHAPES)
    spheres = [
        lib.b3Shape_GetSphere(shapes[k]) for k in range(count) if lib.b3Shape_GetType(shapes[k]) == lib.b3_sphereShape
    ]
    if not spheres:
        return None
    centre = spheres[0].center
    return float(spheres[0].radius), count > 1 or any((centre.x, centre.y, centre.z))


SUBSTEPS = 4  # substeps per step, Box3D's default


class Box3D(SteppedEngine):
    """Runs scenes with Box3D's solver, without sleep and without a minimum speed for bounces."""

    name, package = "box3d", PACKAGE
    differences = (f"single precision, {SUBSTEPS} substeps",)

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if Box3D cannot represent a scene."""
        problem = problem_of(self.name, scene)
        law, planes = problem.between, problem.at_planes
        duller = any(plane.restitution < law.restitution for plane in planes)
        slippery = law.kinetic_friction == 0.0 and any(plane.kinetic_friction > 0.0 for plane in planes)
        lacks = {
            "a plane with less restitution than the bodies, because Box3D uses the larger restitution": duller,
            "a plane with friction and bodies without, because Box3D multiplies the coefficients": slippery,
            "contact.enabled = false": not problem.collides and not scene.contact.enabled,
        }
        refuse(self.name, lacks)

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        engine, problem, dt = engine_package(PACKAGE), problem_of(self.name, scene), dt_of(setting)
        backend, turns = (engine_package(f"{PACKAGE}.{part}", PACKAGE) for part in ("_ffi", "math"))
        world = engine.World(gravity=problem.field.tolist(), substeps=SUBSTEPS)
        backend.lib.b3World_SetRestitutionThreshold(world.id, 0.0)
        start, law, planes = problem.start, problem.between, []
        for k in range(len(start.mass)):
            kind = "static" if start.fixed[k] else "dynamic"
            body = world.create_body(position=start.position[k], kind=kind, name=start.name[k])
            density = start.mass[k] / (4.0 / 3.0 * math.pi * start.radius[k] ** 3)
            body.add_sphere(
                float(start.radius[k]),
                density=density,
                friction=law.kinetic_friction,
                restitution=law.restitution,
            )
            if not start.fixed[k]:
                body.linear_velocity, body.angular_velocity = start.velocity[k], start.angular_velocity[k]
        half = problem.reach
        for normal, offset, name, own in zip(
            problem.planes.normal, problem.planes.offset, problem.planes.name, problem.at_planes, strict=True
        ):
            box = world.create_body(position=(offset - half) * normal, rotation=turns.quat_z_to(normal), kind="static")
            friction = own.kinetic_friction**2 / law.kinetic_friction if law.kinetic_friction else 0.0
            box.add_box((half, half, half), friction=friction, restitution=own.restitution)
            x, y, z = (float(component) for component in np.asarray(normal))
            planes.append(Plane((x, y, z), float(offset), name))
        return EngineSimulation(Box3DSource(world, tuple(planes)), lambda: world.step(dt), dt)
