"""`Engine`, the interface of an engine that is compared with carom, and `watch`, which runs a scene in one.

`SteppedEngine` is the base of engines with spheres, planes, a uniform field and Coulomb friction. `watch` collects the
trajectory of a run, its extremes and violated laws, and may record it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time as clock
from typing import Any, Protocol

import numpy as np

from carom import registry
from carom.arrays import FloatArray, IntArray
from carom.engines.faults import Fault, Tolerances
from carom.engines.observer import Observer, not_finite
from carom.engines.snapshot_writer import observed_recording, observed_totals
from carom.engines.source import SPHERE, Model, Source, State, engine_package, setup_of
from carom.errors import ExperimentError, RecordingError
from carom.lab.compared_run import RunStoppedError, Setting, Trajectory, between
from carom.physics.placement import place
from carom.physics.space import Space
from carom.plan.features import require
from carom.plan.interactions import further
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.schema import Coefficients
from carom.scene.start import HalfSpaces, InitialBodies, half_spaces
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import suggestion
from carom.state.books import Extremes
from carom.state.frame import Frame


@dataclass(frozen=True, slots=True)
class Problem:
    """A scene in the terms of a game or robot engine."""

    start: InitialBodies
    planes: HalfSpaces
    between: Coefficients  # coefficients of two bodies
    at_planes: list[Coefficients]
    field: FloatArray  # (3,) m/s²
    collides: bool
    duration: float  # s

    @property
    def reach(self) -> float:
        """Extent (m) that a plane needs if bodies move at the largest speed for the whole run."""
        start = self.start
        away = np.linalg.norm(start.position - start.position.mean(axis=0), axis=1)
        speed = float(np.linalg.norm(start.velocity, axis=1).max())
        fall = 0.5 * float(np.linalg.norm(self.field)) * self.duration**2
        return 10.0 * (float(max(away.max(), start.radius.max())) + speed * self.duration + fall)

    def named(self, model: Model) -> Model:
        """Add the names of the scene's bodies and planes to an engine's model."""
        named = zip(model.planes, self.planes.name, strict=True)
        return replace(model, names=self.start.name, planes=[plane._replace(name=name) for plane, name in named])


def problem_of(engine: str, scene: Scene) -> Problem:
    """Translate a scene for an engine of rigid bodies; refuse features that such engines lack."""
    parts, coefficients, force = require(scene), pair_coefficients(scene), further(scene)
    lacks = {
        "the bodies' own gravity": parts.gravity.modelled,
        "a periodic box": scene.domain.is_periodic,
        "drag": scene.drag is not None,
        "a [[wall]]": bool(scene.wall),
        "moving planes": bool(scene.translating),
        "bodies that enter or leave": scene.admits,
        f"the force {force}": force != "",
        scene.contact.law_key: parts.contact.modelled and bool(scene.contact.laws),
        "bodies of several materials": len(coefficients.places) > 0,
    }
    refuse(engine, lacks)
    start = place(scene)
    solid_spheres = np.allclose(start.inertia, SPHERE * start.mass * start.radius**2, rtol=1e-12)
    refuse(engine, {"test particles (mass = 0)": not start.mass.all()})
    refuse(engine, {"moments of inertia that differ from solid spheres": not solid_spheres})
    laws = [Coefficients(*row.tolist()) for row in coefficients.rows]
    return Problem(
        start=start,
        planes=half_spaces(scene),
        between=laws[0],
        at_planes=laws[1:],
        field=np.array(scene.gravity.uniform, dtype=np.float64),
        collides=parts.contact.modelled,
        duration=scene.time.duration,
    )


def refuse(engine: str, lacks: dict[str, bool]) -> None:
    """Raise ExperimentError if a scene has a feature that an engine lacks."""
    found = [what for what, there in lacks.items() if there]
    if found:
        raise ExperimentError(f"{engine} cannot represent this scene: {', '.join(found)}")


FINER = (1.0, 4.0)  # factors by which the compared steps are shorter than the scene's step


@dataclass(frozen=True, slots=True)
class EngineSimulation:
    """A scene in another engine."""

    source: Source
    step: Callable[[], None]  # advances the engine by one step
    dt: float  # s, length of the step; 0 if the engine chooses its steps


class Engine(Protocol):
    """An engine that runs a scene with one of the engine's own settings."""

    @property
    def name(self) -> str:
        """The engine's name in ``--engine`` and in names of settings."""

    def ensure_installed(self) -> None:
        """Raise ExperimentError, with the command that installs the engine, if it is missing."""

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if the engine cannot represent a scene; the message names the missing feature."""

    def notes(self, scene: Scene) -> list[str]:
        """Describe each difference of the translated scene from the original in a clause."""

    def settings(self, scene: Scene) -> list[Setting]:
        """Check the installation and the scene; return the settings that are worth comparing."""

    def examined(self, scene: Scene) -> list[Setting]:
        """Return the few settings for `carom crosscheck`."""

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start, to be advanced step by step."""

    def follow(self, scene: Scene, setting: Setting, times: FloatArray, limit: float = math.inf) -> Trajectory:
        """Run a scene and sample it at some times in s.

        ExperimentError if the state is no longer finite; `RunStoppedError` after ``limit`` s of CPU time.
        """

    def samples_steps(self, scene: Scene) -> bool:
        """Return whether `follow` samples the ends of steps, like `watch`."""

    def run(self, scene: Scene, setting: Setting) -> float:
        """Run a scene without sampling; return the seconds that the engine took: CPU time if it uses one thread."""


class SteppedEngine(Engine):
    """An engine of rigid bodies, which advances by equal steps."""

    name: str
    package: str  # name of the package that is installed and imported
    differences: tuple[str, ...] = ()  # differences of every translated scene from the original

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if the engine cannot represent a scene; nothing is built yet."""
        problem_of(self.name, scene)

    def notes(self, scene: Scene) -> list[str]:
        """Describe each difference of the translated scene from the original in a clause."""
        friction = ["one coefficient of friction, the kinetic one"] if scene.contact.static_friction > 0.0 else []
        return [*self.differences, *friction]

    def ensure_installed(self) -> None:
        """Raise ExperimentError, with the command that installs the engine, if it is missing."""
        try:
            engine_package(self.package)
        except RecordingError as error:
            raise ExperimentError(f"--engine {self.name}: {error}") from None

    def settings(self, scene: Scene) -> list[Setting]:
        """Return settings with the scene's own step and with a quarter of it."""
        self.ensure_installed()
        self.check(scene)
        return [self.setting(own_step(scene) / finer, scene.unit_system) for finer in FINER]

    def examined(self, scene: Scene) -> list[Setting]:
        """Return all settings."""
        return self.settings(scene)

    def setting(self, step: float, units: UnitSystem = SI) -> Setting:
        """Return the setting for a step in s, named in the units of the scene."""
        return Setting(f"{self.name}, dt = {units.text(step, TIME, '.4g')}", (f"dt={step!r}",), engine=self.name)

    def follow(self, scene: Scene, setting: Setting, times: FloatArray, limit: float = math.inf) -> Trajectory:
        """Run a scene and sample it at some times in s."""
        return watch(self.begin(scene, setting), scene, times, limit=limit).trajectory

    def samples_steps(self, scene: Scene) -> bool:
        """Return True: samples are taken at the ends of steps."""
        return True

    def run(self, scene: Scene, setting: Setting) -> float:
        """Run a scene without reading its state; return the time (s)."""
        simulation = self.begin(scene, setting)
        # the last step may end slightly after the scene
        count, step = math.ceil(scene.time.duration / simulation.dt * (1.0 - ROUNDING)), simulation.step
        began = time.perf_counter()
        for _ in range(count):
            step()
        return time.perf_counter() - began


def own_step(scene: Scene) -> float:
    """Return the fixed step (s) of a scene, or else its first step."""
    return scene.time.fixed_dt or Space(scene, 1).first_dt


def dt_of(setting: Setting) -> float:
    """Return the step (s) of a setting."""
    return float(dict(key.split("=") for key in setting.overrides)["dt"])


def engine_called(name: str) -> Engine:
    """Return an engine of `carom.registry` by its name; raise ExperimentError if there is none."""
    known = registry.names("engines")
    if name not in known:
        raise ExperimentError(f"--engine {name}: unknown; {suggestion(name, known)}")
    engine: Engine = registry.load("engines", name)()
    return engine


def engines_called(names: Iterable[str]) -> list[Engine]:
    """Return engines by their names, each once; a text may contain several names, separated by commas."""
    given = list(names)
    each = [name.strip() for text in given for name in text.split(",") if name.strip()]
    if not each and given:
        raise ExperimentError(f"--engine: names no engine; expected some of {', '.join(registry.names('engines'))}")
    return [engine_called(name) for name in dict.fromkeys(each)]


ROUNDING = 1e-9  # fraction of the duration by which the sum of the steps may fall short
COMPLETED = "completed"
MOST_SEEN = 20_000  # largest number of steps that are examined if nothing can touch
MOST_OVERLAP = 0.05  # overlap, in smaller radii, above which engines treat contacts differently
FRAMES = 600  # frames of a recording, besides the frames that violate a law


@dataclass(frozen=True, slots=True)
class Watched:
    """Observations of an engine's run."""

    outcome: str  # "completed", or the reason for an early end
    dt: float  # s, length of the steps
    trajectory: Trajectory
    extremes: Extremes
    faults: list[Fault]  # first fault of each law, in order of time
    counts: dict[str, int]  # number of frames that violate each law
    broken: list[tuple[float, str]]  # time (s) and violated law of every frame that violates a law


def watch(
    simulation: EngineSimulation, scene: Scene, times: FloatArray, path: Path | None = None, limit: float = np.inf
) -> Watched:
    """Run a simulation from its start to the end of its scene, and sample it at the given times, (K,) s.

    If nothing can touch, at most `MOST_SEEN` steps are examined. The run is recorded to ``path``, where it replaces a
    file. ExperimentError if it is not recorded and its state is no longer finite, or it takes longer than the limit, in
    s of CPU time (`RunStoppedError`).
    """
    first = simulation.source.state()
    setup = setup_of(simulation.source.model, first)
    observer = Observer(setup, first, Tolerances(overlap=MOST_OVERLAP), scene.unit_system)
    walk = _Walk(simulation, scene, observer, times)
    if path is None:
        outcome = walk.run(first, limit)
        if outcome != COMPLETED:
            raise ExperimentError(outcome.removeprefix("failed: "))
    else:
        with observed_recording(path, walk.observer, scene) as walk.recorder:
            outcome = walk.run(first, limit)
            totals = observed_totals(walk.observer, walk.frame.step, walk.frame.time)
            walk.recorder.finish(outcome, totals, walk.observer.highlights())
    audit = walk.observer.audit
    return Watched(
        outcome=outcome,
        dt=simulation.dt,
        trajectory=walk.trajectory(),
        extremes=walk.observer.extremes,
        faults=sorted(audit.first.values(), key=lambda fault: fault.step),
        counts=audit.counts,
        broken=audit.broken,
    )


class _Walk:
    """Runs a simulation from its start to the end of its scene, and examines its steps."""

    def __init__(self, simulation: EngineSimulation, scene: Scene, observer: Observer, times: FloatArray) -> None:
        self.observer = observer
        self.frame: Frame  # the last examined frame
        self.recorder: Any = None  # None if the run is not recorded
        self._due = 0.0  # s, time of the next recorded frame
        self._simulation, self._scene, self._times = simulation, scene, times
        self._position: list[FloatArray] = []  # states at the first sample times, interpolated between ends of steps
        self._velocity: list[FloatArray] = []
        self._end = scene.time.duration * (1.0 - ROUNDING)
        self._met: dict[tuple[int, int], float] = {}  # times (s) at which two ends first touched
        self._step = 0
        many = math.ceil(scene.time.duration / simulation.dt / MOST_SEEN) if simulation.dt else 1
        self._stride = 1 if observer.setup.collides else many  # steps from one examined step to the next

    def run(self, first: State, limit: float) -> str:
        """Run until the scene ends, the state is not finite, or ``limit`` s of CPU time pass; return the outcome."""
        units, began = self._scene.unit_system, clock()
        self.frame = self.observer.frame(0, _copied(first))
        self._record()
        while self.frame.time < self._end:
            spent = clock() - began
            if spent > limit:
                reached = units.text(self.frame.time, TIME)
                if self.recorder is None:
                    raise RunStoppedError(self._step, spent, reached, option="--limit")
                return f"failed: stopped at t = {reached}: it took more than {limit:g} s of CPU time (--limit)"
            if wrong := self._advance():
                return f"failed: {wrong}"
            self._record()
        return COMPLETED

    def _record(self) -> None:
        """Record `FRAMES` frames of the run, the last frame, and all frames that violate a law."""
        frame, end = self.frame, self._scene.time.duration
        if self.recorder is not None and (frame.time >= min(self._due, self._end) or frame.events):
            self.recorder.put(frame)
            self._due = frame.time + end / FRAMES if frame.step else 0.0

    def trajectory(self) -> Trajectory:
        """Return the samples, and the extremes so far."""
        extremes, count = self.observer.extremes, len(self._position)
        n, collides = len(self.observer.setup), self.observer.setup.collides
        # as long as bodies touch, the work of contacts cannot be separated from errors
        touched = extremes.total_contacts + extremes.impacts > 0 or self.frame.energy.ledger.restitution != 0.0
        return Trajectory(
            time=self._times[:count],
            position=np.array(self._position).reshape(count, n, 3),
            velocity=np.array(self._velocity).reshape(count, n, 3),
            pair=np.array(list(self._met), dtype=np.int64).reshape(-1, 2),
            met=np.array(list(self._met.values())),
            energy_error=np.nan if touched or extremes.energy_error is None else extremes.energy_error.value,
            energy_gain=extremes.energy_gain.value,
            momentum_error=extremes.momentum_error.value if extremes.momentum_error else np.nan,
            angular_momentum_error=extremes.angular_momentum_error.value if extremes.angular_momentum_error else np.nan,
            overlap=(extremes.overlap.value if extremes.overlap else 0.0) if collides else np.nan,
            sinking=np.nan,
            impacts=extremes.impacts,
            steps=self.frame.step,
            frames=0,
        )

    def _advance(self) -> str:
        """Advance to the next examined step and examine it; return why the run cannot continue, or an empty text."""
        dt = self._simulation.dt
        left = math.ceil((self._scene.time.duration - self.frame.time) / dt * (1.0 - ROUNDING)) if dt else 1
        for _ in range(min(self._stride, left)):
            self._step += 1
            self._simulation.step()
        state = self._simulation.source.state()
        fault = not_finite(self.observer.setup, self._step, state)
        if fault is not None:
            self.observer.audit.note(fault)
            return fault.text
        # the time decreases when an engine restarts, as MuJoCo does when it becomes unstable
        if state.time < self.frame.time:
            units = self._scene.unit_system
            back = units.text(state.time, TIME, "g")
            return f"the engine's time decreased from {units.text(self.frame.time, TIME, 'g')} to {back}."
        before, self.frame = self.frame, self.observer.frame(self._step, _copied(state))
        frame, dt = self.frame, self.frame.time - before.time
        while len(self._position) < len(self._times):
            due = float(self._times[len(self._position)])
            if due > frame.time * (1.0 + ROUNDING):
                break
            way, s = frame.position - before.position, (due - before.time) / dt
            moved, velocity = between(s, dt, way, before.velocity, frame.velocity, None)
            self._position.append(before.position + moved)
            self._velocity.append(velocity)
        for pair in self.frame.contacts.pairs.tolist():
            self._met.setdefault((pair[0], pair[1]), self.frame.time)
        return ""


class InOrder:
    """A source with bodies and names in the order of the scene; ``order`` has the bodies' indices, (n,)."""

    def __init__(self, source: Source, order: IntArray, names: Sequence[str]) -> None:
        model = source.model
        given = {name: getattr(model, name) for name in ("mass", "radius", "inertia", "fixed", "judged")}
        own: dict[str, Any] = {name: np.asarray(each)[order] for name, each in given.items() if each is not None}
        self._source, self._order = source, order
        self.model = replace(model, names=names, **own)

    def state(self) -> State:
        """Return the present state, without contacts."""
        state = self._source.state()
        arrays = (state.position, state.velocity, state.orientation, state.angular_velocity)
        return State(state.time, *(None if each is None else each[self._order] for each in arrays))


def _copied(state: State) -> State:
    """Copy a state that may be a view of the engine's memory, since the observer keeps it until the next state."""
    arrays = (state.position, state.velocity, state.orientation, state.angular_velocity)
    position, velocity, turn, spin = (None if each is None else np.array(each, dtype=np.float64) for each in arrays)
    return State(state.time, position, velocity, turn, spin, state.contacts)
