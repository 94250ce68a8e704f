"""The interface of an engine that is compared with carom, and `SteppedEngine`, which advances by equal steps.

A stepped engine has spheres, planes, a uniform field and Coulomb friction.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from carom import Scene, Space, registry
from carom.arrays import FloatArray
from carom.errors import ExperimentError, RecordingError
from carom.extend import (
    SI,
    SPHERE,
    TIME,
    Coefficients,
    HalfSpaces,
    InitialBodies,
    UnitSystem,
    engine_package,
    further,
    half_spaces,
    pair_coefficients,
    place,
    require,
    suggestion,
)
from carom.lab.compared_run import Setting, Trajectory
from carom.lab.engines.watched import ROUNDING, watch
from carom.record import Model, Source


@dataclass(frozen=True, slots=True)
class Problem:
    """A scene in the terms of a game or robot engine."""

    start: InitialBodies
    planes: HalfSpaces
    between: Coefficients  # of two bodies
    at_planes: list[Coefficients]
    field: FloatArray  # (3,) m/s²
    collides: bool
    duration: float  # s

    @property
    def extent(self) -> float:
        """Distance (m) from the initial middle of the bodies to the farthest one, at least the largest radius."""
        centre = self.start.position.mean(axis=0)
        away = np.linalg.norm(self.start.position - centre, axis=1)
        return float(max(away.max(), self.start.radius.max()))

    @property
    def reach(self) -> float:
        """Extent (m) of a plane, for bodies that keep the largest speed for the whole run."""
        speed = float(np.linalg.norm(self.start.velocity, axis=1).max())
        fall = 0.5 * float(np.linalg.norm(self.field)) * self.duration**2
        return 10.0 * (self.extent + speed * self.duration + fall)

    def named(self, model: Model) -> Model:
        """Return an engine's model, which lacks names, with the names of the scene's bodies and planes."""
        named = zip(model.planes, self.planes.name, strict=True)
        return replace(model, names=self.start.name, planes=[plane._replace(name=name) for plane, name in named])


def problem_of(engine: str, scene: Scene) -> Problem:
    """Translate a scene for an engine of rigid bodies.

    Raises
    ------
    ExperimentError
        If the scene has features that such engines lack; the message names each.
    """
    parts, coefficients, force = require(scene), pair_coefficients(scene), further(scene)
    lacks = {
        "the bodies' own gravity": parts.gravity.modelled,
        "a periodic box": scene.domain.is_periodic,
        "drag": scene.drag is not None,
        "a [[wall]]": bool(scene.wall),
        "moving planes": bool(scene.translating),
        f"the force {force}": force != "",
        scene.contact.law_key: parts.contact.modelled and bool(scene.contact.laws),
        "bodies of several materials": len(coefficients.places) > 0,
    }
    refuse(engine, lacks)
    start, solids = place(scene), half_spaces(scene)
    solid_spheres = np.allclose(start.inertia, SPHERE * start.mass * start.radius**2, rtol=1e-12)
    refuse(engine, {"test particles (mass = 0)": not start.mass.all()})
    refuse(engine, {"moments of inertia other than those of solid spheres": not solid_spheres})
    laws = [Coefficients(*row.tolist()) for row in coefficients.rows]
    return Problem(
        start=start,
        planes=solids,
        between=laws[0],
        at_planes=laws[1:],
        field=np.array(scene.gravity.uniform, dtype=np.float64),
        collides=parts.contact.modelled,
        duration=scene.time.duration,
    )


def refuse(engine: str, lacks: dict[str, bool]) -> None:
    """Raise ExperimentError if a scene has anything that an engine lacks."""
    found = [what for what, there in lacks.items() if there]
    if found:
        raise ExperimentError(f"{engine} cannot represent this scene: {', '.join(found)}")


FINER = (1.0, 4.0)  # the scene's step over the compared steps


@dataclass(frozen=True, slots=True)
class EngineSimulation:
    """A scene in another engine."""

    source: Source
    step: Callable[[], None]  # advances by one step
    dt: float  # s; 0 if the engine chooses its steps


class SteppedEngine(ABC):
    """An engine of rigid bodies; see `Engine`."""

    name: str
    package: str  # that is imported
    distribution: str  # that is installed

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if the engine cannot represent a scene; nothing is built yet."""

    @abstractmethod
    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""

    @abstractmethod
    def notes(self, scene: Scene) -> list[str]:
        """Describe each difference of the translated scene in a clause."""

    def ensure_installed(self) -> None:
        """Raise ExperimentError, with the command that installs the engine, if it is missing."""
        try:
            engine_package(self.package, self.distribution)
        except RecordingError as error:
            raise ExperimentError(f"--engine {self.name}: {error}") from None

    def settings(self, scene: Scene) -> list[Setting]:
        """Return the scene's own step and a quarter of it."""
        self.ensure_installed()
        self.check(scene)
        step = scene.time.fixed_dt or Space(scene, 1).first_dt
        return [self.setting(step / finer, scene.unit_system) for finer in FINER]

    def examined(self, scene: Scene) -> list[Setting]:
        """Return the settings for `carom crosscheck`."""
        return self.settings(scene)

    def setting(self, step: float, units: UnitSystem = SI) -> Setting:
        """Return the setting of a step in s, named in the units of the scene."""
        return Setting(f"{self.name}, dt = {units.text(step, TIME, '.4g')}", (f"dt={step!r}",), engine=self.name)

    def follow(self, scene: Scene, setting: Setting, times: FloatArray, limit: float = math.inf) -> Trajectory:
        """Run a scene and sample it; see `Engine`."""
        return watch(self.begin(scene, setting), scene, times, limit=limit).trajectory

    def samples_steps(self, scene: Scene) -> bool:
        """Return True: `follow` takes its samples from the ends of steps."""
        return True

    def run(self, scene: Scene, setting: Setting) -> float:
        """Run a scene without reading its state; return the time (s)."""
        simulation = self.begin(scene, setting)
        count, step = steps_of(scene, simulation.dt), simulation.step
        began = time.perf_counter()
        for _ in range(count):
            step()
        return time.perf_counter() - began


def steps_of(scene: Scene, dt: float) -> int:
    """Return the number of steps of a scene at a dt (s); the last step may end slightly after the scene."""
    return math.ceil(scene.time.duration / dt * (1.0 - ROUNDING))


def dt_of(setting: Setting) -> float:
    """Return the step of a setting in s."""
    return float(dict(key.split("=") for key in setting.overrides)["dt"])


class Engine(Protocol):
    """An engine that runs a scene with one of its own settings."""

    @property
    def name(self) -> str:
        """The name in ``--engine`` and in names of settings."""

    def ensure_installed(self) -> None:
        """Raise ExperimentError, with the command that installs the engine, if it is missing."""

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if the engine cannot represent a scene; the message names the missing feature."""

    def notes(self, scene: Scene) -> list[str]:
        """Describe each difference of the translated scene in a clause."""

    def examined(self, scene: Scene) -> list[Setting]:
        """Return the few settings for `carom crosscheck`."""

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start, to be advanced step by step."""

    def settings(self, scene: Scene) -> list[Setting]:
        """Return the engine's settings that are worth comparing on a scene.

        Raises
        ------
        ExperimentError
            If the engine is not installed, or cannot represent the scene; the message names the missing feature.
        """

    def follow(self, scene: Scene, setting: Setting, times: FloatArray, limit: float = math.inf) -> Trajectory:
        """Run a scene and sample it at some times in s.

        Parameters
        ----------
        limit
            s of CPU time, after which the run is stopped.

        Raises
        ------
        ExperimentError
            If the state is no longer finite; `RunStoppedError` if it takes longer than the limit.
        """

    def samples_steps(self, scene: Scene) -> bool:
        """Return whether `follow` takes its samples from the ends of steps, as `watch` does."""

    def run(self, scene: Scene, setting: Setting) -> float:
        """Run a scene without sampling; return the seconds that the engine took: CPU time if it uses one thread."""


def engine_called(name: str) -> Engine:
    """Return an engine of `carom.registry` by its name.

    Raises
    ------
    ExperimentError
        If there is no engine of that name.
    """
    known = registry.names("engines")
    if name not in known:
        raise ExperimentError(f"--engine {name}: unknown; {suggestion(name, known)}")
    engine: Engine = registry.load("engines", name)()
    return engine


def engines_called(names: Iterable[str]) -> list[Engine]:
    """Return engines by their names, each once; a text may contain several names, separated by commas.

    Raises
    ------
    ExperimentError
        If one is unknown, or a text names none.
    """
    given = list(names)
    each = [name.strip() for text in given for name in text.split(",") if name.strip()]
    if not each and given:
        raise ExperimentError(f"--engine: names no engine; expected some of {', '.join(registry.names('engines'))}")
    return [engine_called(name) for name in dict.fromkeys(each)]
