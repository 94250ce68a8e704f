"""`Engine`: the interface of an engine that is compared with carom."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Protocol

from carom import Scene, registry
from carom.arrays import FloatArray
from carom.errors import ExperimentError
from carom.extend import suggestion
from carom.lab.compared_run import Setting, Trajectory
from carom.lab.engines.stepped import EngineSimulation


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
