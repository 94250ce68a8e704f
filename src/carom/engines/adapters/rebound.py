"""REBOUND: its recorder, and the engine that `crosscheck` compares. REBOUND is an optional package, under the GPL.

REBOUND integrates bodies that attract each other, or smooth hard spheres. Every integrator that can run the scene is
compared: IAS15, which controls its error, and the integrators of constant steps, at several steps. WHFast, MERCURIUS
and TRACE, the symplectic maps for one dominant body, get steps that are fractions of the shortest period about that
body.
"""

from __future__ import annotations

import ctypes
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.engines.engine import FINER, EngineSimulation, InOrder, own_step, refuse, watch
from carom.engines.source import Model, Source, State, StateMemory, engine_package, named_version
from carom.errors import ExperimentError, RecordingError
from carom.lab.compared_run import STEPS, RunStoppedError, Setting, Trajectory
from carom.physics.placement import place
from carom.physics.space import Space
from carom.plan.features import require
from carom.plan.hierarchy import DOMINANT
from carom.plan.interactions import further
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.start import half_spaces
from carom.scene.units.dimension import TIME
from carom.scene.units.system import WITHOUT, UnitSystem, units_of_rebound

G_SI = 6.674e-11  # m³ kg⁻¹ s⁻²; REBOUND's own constant differs in the fifth digit
READ = ("x", "y", "z", "vx", "vy", "vz")  # names of the first numbers of a particle in memory
# the numbers `READ` of a particle as one item, which is copied six times as fast as the numbers
ROW = np.dtype((np.void, 8 * len(READ)))


class ReboundSource:
    """The particles of a simulation, in its ``units``.

    Without ``units``, the particles are in SI if G has its SI value, and otherwise dimensionless.

    Parameters
    ----------
    simulation
        A rebound.Simulation. Particles cannot be added or removed while it is recorded.
    radius
        m, drawn for particles without a radius; by default a hundredth of their extent.
    """

    def __init__(self, simulation: Any, radius: float | None = None) -> None:
        self._stride = _size_of(engine_package("rebound").Particle)
        self._simulation = simulation
        self._all, self._n = simulation.N, simulation.N - _variational(simulation)
        self._address = 0
        self._particles: Records = np.empty(0, ROW)  # a view of positions and velocities in REBOUND's memory
        mass, size = np.zeros(simulation.N), np.zeros(simulation.N)
        simulation.serialize_particle_data(m=mass, r=size)
        mass, size = mass[: self._n], size[: self._n]
        touches = _setting_name(simulation, "collision") != "none" and bool((size > 0.0).all())
        if radius is not None:
            size = np.where(size > 0.0, size, radius)
        particles = [simulation.particles[k] for k in range(self._n)]
        has_gravity = _setting_name(simulation, "gravity") != "none"
        periodic = _setting_name(simulation, "boundary") in ("periodic", "shear")
        roots = ("N_root_x", "N_root_y", "N_root_z")
        si = math.isclose(simulation.G, G_SI, rel_tol=1e-3)  # also true if no units were set
        self.model = Model(
            engine=named_version("rebound"),
            mass=mass,
            radius=size,
            names=[str(getattr(each, "name", None) or f"body {k}") for k, each in enumerate(particles)],
            constant=simulation.G if has_gravity else 0.0,
            softening=simulation.softening,
            box=np.array([getattr(simulation, n) for n in roots]) * simulation.root_size if periodic else None,
            collides=touches,
            time_step=abs(simulation.dt),
            units=units_of_rebound(simulation.units) or ("" if si else WITHOUT),
        )

    def state(self) -> State:
        """Return positions and velocities of the particles."""
        snapshot = self.memory()
        self.read(snapshot)
        return snapshot.state

    def memory(self) -> StateMemory:
        """Return memory for one state; see `BulkSource`."""
        block = np.empty((self._n, len(READ)))
        return StateMemory(State(0.0, block[:, :3], block[:, 3:]), block, (block.view(ROW)[:, 0],))

    def read(self, into: StateMemory) -> None:
        """Copy positions and velocities from REBOUND's own memory, in one pass."""
        simulation = self._simulation
        if self._all != simulation.N:
            raise RecordingError(
                f"rebound had {self._all} particles, but now has {simulation.N}; where particles come and go, record "
                "carom.record.rebound(simulation, changing=True)"
            )
        if not simulation.is_synchronized:
            simulation.synchronize()
        address = ctypes.addressof(simulation._particles.contents)  # `simulation.particles` would create objects
        if address != self._address:
            raw = (ctypes.c_char * (self._stride * self._n)).from_address(address)
            self._particles = np.ndarray((self._n,), ROW, memoryview(raw), strides=(self._stride,))
            self._address = address
        into.parts[0][:] = self._particles
        into.state.time = simulation.t


class ChangingReboundSource:
    """The particles of a simulation in which particles merge, come or go; see `rebound`.

    REBOUND moves particles in memory, and their names are optional. This source therefore numbers particles in their
    field ``ap``, which REBOUND reserves for other packages.
    """

    def __init__(self, simulation: Any, radius: float | None = None) -> None:
        particle = engine_package("rebound").Particle
        fields = {"place": READ[0], "mass": "m", "radius": "r", "id": "ap"}
        formats = [(np.float64, len(READ)), np.float64, np.float64, np.uint64]
        offsets = [getattr(particle, name).offset for name in fields.values()]
        self._row = np.dtype(
            {"names": [*fields], "formats": formats, "offsets": offsets, "itemsize": _size_of(particle)}
        )
        self._simulation, self._radius, self._numbered = simulation, radius, 0
        if any(particle.ap for particle in simulation.particles):
            raise RecordingError(
                "rebound: the field `ap` of a particle is used, by REBOUNDx or another package; carom needs it to "
                "follow particles that come and go"
            )
        radii = [particle.r for particle in simulation.particles]
        collides = _setting_name(simulation, "collision") != "none" and min(radii, default=0.0) > 0.0
        self.model = replace(ReboundSource(simulation, radius).model, collides=collides)

    def state(self) -> State:
        """Return the present particles."""
        simulation = self._simulation
        if not simulation.is_synchronized:
            simulation.synchronize()
        count = simulation.N - _variational(simulation)
        memory = (ctypes.c_char * (self._row.itemsize * count)).from_address(
            ctypes.addressof(simulation._particles.contents)
        )
        rows = np.frombuffer(memory, self._row)
        new = rows["id"] == 0
        rows["id"][new] = self._numbered + 1 + np.arange(np.count_nonzero(new))
        self._numbered += int(np.count_nonzero(new))
        size = rows["radius"].copy()
        if self._radius is not None:
            size[size == 0.0] = self._radius
        position, velocity = rows["place"][:, :3].copy(), rows["place"][:, 3:].copy()
        ids = rows["id"].astype(np.int64)
        return State(simulation.t, position, velocity, ids=ids, mass=rows["mass"].copy(), radius=size)


def rebound(simulation: Any, radius: float | None = None, *, changing: bool = False) -> Source:
    """Return the source of a rebound.Simulation; see `ReboundSource`.

    ``changing`` says whether particles merge, come or go during the recording. With ``changing``, carom numbers the
    particles in their field ``ap``.
    """
    return ChangingReboundSource(simulation, radius) if changing else ReboundSource(simulation, radius)


def _variational(simulation: Any) -> int:
    """Return how many of the N particles are variational; 0 if they have a separate array, as in REBOUND 5.2."""
    return 0 if hasattr(simulation, "particles_var") else int(getattr(simulation, "N_var", 0))


def _setting_name(simulation: Any, name: str) -> str:
    value = getattr(simulation, name, "none")
    return value if isinstance(value, str) else str(getattr(value, "name", value)).lower()


def _size_of(particle: Any) -> int:
    """Return the size of a particle in bytes; refuse a version with another layout of particles in memory."""
    if [getattr(particle, name).offset for name in READ] != [8 * k for k in range(len(READ))]:
        raise RecordingError(f"{named_version('rebound')} stores its particles in an unknown order; carom supports 5.x")
    return ctypes.sizeof(particle)


NAME = "rebound"
INSTALL = "the engine rebound needs the package of that name: pip install 'rebound>=5'"
OLDEST = 5  # oldest major version; earlier versions use other names for the settings of integrators
ANY = "leapfrog"  # the setting that runs with the scene's own step
DOMINATED = ("whfast", "mercurius", "trace")
UNSYNCHRONISED = ("whfast", "mercurius")  # integrators whose steps end with a readable state only on request
TOUCHING = "leapfrog, hard spheres"  # the only setting for scenes with contacts, at several steps
SEED = 1  # seed of the random order of impacts in a step; by default, REBOUND takes the seed from the clock
PARTS = (20.0, 40.0, 80.0, 160.0)  # numbers of steps in the shortest period


class Rebound:
    """Runs scenes with REBOUND's integrators."""

    name = NAME

    def settings(self, scene: Scene) -> list[Setting]:
        """Return IAS15, leapfrog at the scene's steps, and the maps for a dominant body; see `Engine`."""
        self.ensure_installed()
        self.check(scene)
        units, step = scene.unit_system, own_step(scene)
        if require(scene).contact.modelled:
            return [_setting(TOUCHING, units, step / finer) for finer in FINER]
        found = [_setting("ias15", units), *(_setting(ANY, units, step * factor) for factor in STEPS)]
        if period := shortest_period(scene):
            found += [_setting(name, units, period / part) for name in DOMINATED for part in PARTS]
        return found

    def examined(self, scene: Scene) -> list[Setting]:
        """Return the settings for `carom crosscheck`."""
        settings, units = self.settings(scene), scene.unit_system
        if require(scene).contact.modelled:
            return settings
        return [_setting("ias15", units), _setting(ANY, units, own_step(scene))]

    def ensure_installed(self) -> None:
        """Raise ExperimentError if REBOUND is not installed."""
        _package()

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if REBOUND cannot represent a scene."""
        parts, start, force = require(scene), place(scene), further(scene)
        lacks = {
            "friction (set contact.static_friction = 0 and contact.kinetic_friction = 0)": parts.contact.modelled
            and parts.friction.modelled,
            "planes": bool(len(half_spaces(scene))),
            "a [[wall]]": bool(scene.wall),
            "bodies of several materials": len(pair_coefficients(scene).places) > 0,
            "a periodic box": scene.domain.is_periodic,
            "a uniform field": any(scene.gravity.uniform),
            "bodies that enter or leave": scene.admits,
            "drag": scene.drag is not None,
            f"the force {force}": force != "",
            scene.contact.law_key: parts.contact.modelled and bool(scene.contact.laws),
            "fixed bodies": bool(np.any(start.fixed)),
            "bodies without gravity and contacts": not parts.gravity.modelled and not parts.contact.modelled,
        }
        refuse("rebound", lacks)

    def notes(self, scene: Scene) -> list[str]:
        """Describe how the translated scene differs from the original."""
        return ["hard spheres that bounce at the end of a step"] if require(scene).contact.modelled else []

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start, to be advanced step by step."""
        simulation = _simulation(scene, setting, safe=True)
        start = place(scene)
        order = np.argsort(_heaviest_first(start.mass))
        dt = simulation.dt if "dt=" in " ".join(setting.overrides) else 0.0
        return EngineSimulation(InOrder(ReboundSource(simulation), order, start.name), lambda: simulation.steps(1), dt)

    def follow(self, scene: Scene, setting: Setting, times: FloatArray, limit: float = math.inf) -> Trajectory:
        """Run a scene and sample it; a copy of the simulation integrates back from the end of a step to each time."""
        if self.samples_steps(scene):
            return watch(self.begin(scene, setting), scene, times, limit=limit).trajectory
        simulation = _simulation(scene, setting, safe=True)
        space = Space(scene, 1)
        initial, mass = space.energy(), space.state.mass
        energies, momenta, positions, velocities = [simulation.energy()], [_momenta(simulation, mass)], [], []
        began = time.process_time()
        for moment in times.tolist():
            spent = time.process_time() - began
            if spent > limit:
                reached = scene.unit_system.text(simulation.t, TIME)
                raise RunStoppedError(simulation.steps_done, spent, reached, option="--limit")
            if simulation.t < moment:  # otherwise REBOUND would step back
                simulation.integrate(moment, exact_finish_time=0)
            sample = simulation.copy()
            sample.integrate(moment, exact_finish_time=1)
            position, velocity = _state(sample, mass)
            if not np.isfinite(position).all():
                raise ExperimentError(f"the state is no longer finite at t = {scene.unit_system.text(moment, TIME)}")
            positions.append(position)
            velocities.append(velocity)
            energies.append(simulation.energy())
            momenta.append(_momenta(simulation, mass))
        energy, momentum = np.array(energies), np.array(momenta)
        moved = np.abs(momentum - momentum[0]).max(axis=(0, 2))
        # the scale is Σ m |v| and Σ m |x| |v| about the centre of mass
        speed, away = (
            np.linalg.norm(each - mass @ each / mass.sum(), axis=1) for each in (velocities[0], positions[0])
        )
        scales = float(mass @ speed) or 1.0, float(mass @ (away * speed)) or 1.0
        return Trajectory(
            time=times,
            position=np.array(positions),
            velocity=np.array(velocities),
            pair=np.empty((0, 2), np.int64),
            met=np.empty(0),
            energy_error=initial.relative_change(float(np.abs(energy - energy[0]).max())),
            energy_gain=initial.relative_change(float((energy - np.minimum.accumulate(energy)).max())),
            momentum_error=float(moved[0] / scales[0]),
            angular_momentum_error=float(moved[1] / scales[1]),
            overlap=np.nan,
            sinking=np.nan,
            impacts=0,
            steps=simulation.steps_done,
            frames=0,
        )

    def samples_steps(self, scene: Scene) -> bool:
        """Return whether `follow` takes its samples at the ends of steps, which it does if bodies touch."""
        return require(scene).contact.modelled

    def run(self, scene: Scene, setting: Setting) -> float:
        """Run a scene as fast as the integrator allows; return its CPU time (s) on one thread."""
        simulation = _simulation(scene, setting, safe=False)
        began = time.thread_time()
        simulation.integrate(scene.time.duration, exact_finish_time=0)
        simulation.synchronize()
        return time.thread_time() - began


def shortest_period(scene: Scene) -> float:
    """Return the shortest period about the dominant body in s; 0 without such a body, or if nothing orbits it."""
    start = place(scene)
    heavy = int(np.argmax(start.mass))
    if start.mass[heavy] < DOMINANT * start.mass.sum() or len(start.mass) < 2:
        return 0.0
    others = np.arange(len(start.mass)) != heavy
    away = start.position[others] - start.position[heavy]
    speed = start.velocity[others] - start.velocity[heavy]
    parameter = scene.gravity.constant * (start.mass[heavy] + start.mass[others])
    inverse_axis = 2.0 / np.linalg.norm(away, axis=1) - (speed**2).sum(axis=1) / parameter
    bound = inverse_axis > 0.0
    if not bound.any():
        return 0.0
    return float((2.0 * np.pi / np.sqrt(parameter[bound] * inverse_axis[bound] ** 3)).min())


def _setting(integrator: str, units: UnitSystem, step: float = 0.0) -> Setting:
    words = f"rebound {integrator}" + (f", dt = {units.text(step, TIME, '.4g')}" if step else "")
    keys = (f"integrator={integrator}", *((f"dt={step!r}",) if step else ()))
    return Setting(words, keys, engine=NAME)


def _simulation(scene: Scene, setting: Setting, *, safe: bool) -> Any:
    """Build a simulation in the frame of the scene; with ``safe``, every step ends with a readable state."""
    rebound, start, keys = _package(), place(scene), dict(key.split("=") for key in setting.overrides)
    simulation = rebound.Simulation()
    simulation.rand_seed = SEED
    simulation.G = scene.gravity.constant
    simulation.softening = scene.gravity.softening
    simulation.integrator = keys["integrator"].partition(",")[0]
    parts = require(scene)
    if not parts.gravity.modelled:
        simulation.gravity = "none"
    if parts.contact.modelled:
        restitution = pair_coefficients(scene).of(0, 1).restitution
        simulation.collision, simulation.collision_resolve = "direct", "hardsphere"
        simulation.coefficient_of_restitution = lambda engine, speed: restitution
    if "dt" in keys:
        simulation.dt = float(keys["dt"])
    if keys["integrator"] in UNSYNCHRONISED:
        simulation.integrator.safe_mode = int(safe)
    for k in _heaviest_first(start.mass).tolist():
        (x, y, z), (vx, vy, vz) = start.position[k].tolist(), start.velocity[k].tolist()
        radius = float(start.radius[k]) if parts.contact.modelled else 0.0
        simulation.add(m=float(start.mass[k]), r=radius, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
    return simulation


def _heaviest_first(mass: FloatArray) -> IntArray:
    """Return the bodies in the order in which the maps for a dominant body need them."""
    return np.argsort(np.arange(len(mass)) != np.argmax(mass), kind="stable")


def _state(simulation: Any, mass: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (n, 3) in the order of the scene."""
    position, velocity = np.empty((2, len(mass), 3))
    order = _heaviest_first(mass)
    position[order] = [particle.xyz for particle in simulation.particles]
    velocity[order] = [particle.vxyz for particle in simulation.particles]
    return position, velocity


def _momenta(simulation: Any, mass: FloatArray) -> FloatArray:
    """Return momentum and angular momentum, (2, 3)."""
    position, velocity = _state(simulation, mass)
    return np.array([mass @ velocity, mass @ np.cross(position, velocity)])


def _package() -> Any:
    try:
        import rebound  # noqa: PLC0415 - optional
    except ImportError:
        raise ExperimentError(INSTALL) from None
    if int(rebound.__version__.partition(".")[0]) < OLDEST:
        raise ExperimentError(f"{INSTALL}; this is {rebound.__version__}")
    return rebound
