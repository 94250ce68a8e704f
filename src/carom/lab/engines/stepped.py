"""`SteppedEngine`: an engine that advances by equal steps and shows its state after each."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from carom.errors import ExperimentError, RecordingError
from carom.lab.engines.watched import ROUNDING, watch
from carom.lab.tradeoff.settings_grid import Setting
from carom.lab.tradeoff.trajectory import FloatArray, Trajectory
from carom.physics.space import Space
from carom.recording.source.adapters.package import engine_package
from carom.recording.source.source import Source
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem

FINER = (1.0, 4.0)  # the scene's step over those that are compared


@dataclass(frozen=True, slots=True)
class Simulation:
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
    def begin(self, scene: Scene, setting: Setting) -> Simulation:
        """Build a scene at its start."""

    @abstractmethod
    def notes(self, scene: Scene) -> list[str]:
        """Say what is translated differently, a clause each."""

    def ensure_installed(self) -> None:
        """Raise ExperimentError if the engine is not installed; the message has the line that installs it."""
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
        """Tell whether `follow` takes its samples from the ends of steps: it does."""
        return True

    def run(self, scene: Scene, setting: Setting) -> float:
        """Run a scene, and read no state; return the time it took in s."""
        simulation = self.begin(scene, setting)
        count, step = steps_of(scene, simulation.dt), simulation.step
        began = time.perf_counter()
        for _ in range(count):
            step()
        return time.perf_counter() - began


def steps_of(scene: Scene, dt: float) -> int:
    """Return the steps that a scene takes at a dt in s; the last one may end a little later than the scene."""
    return math.ceil(scene.time.duration / dt * (1.0 - ROUNDING))


def dt_of(setting: Setting) -> float:
    """Return the step of a setting in s."""
    return float(dict(key.split("=") for key in setting.overrides)["dt"])
