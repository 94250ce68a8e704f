"""Runs the settings of a study: once with samples, for the errors, and again without recording, for the cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from carom import registry
from carom.arrays import FloatArray
from carom.errors import ExperimentError, PhysicsError, SceneError
from carom.lab.compared_run import RunBound, RunStoppedError, Setting, Trajectory, follow, sample_times
from carom.lab.tradeoff.reference import Teller
from carom.lab.tradeoff.settings_grid import SettingResult
from carom.physics.jit import cores
from carom.physics.look_ahead.find_step import with_promise
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.runs.stopwatch import Stopwatch
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME

EngineFollower = Callable[[Setting, FloatArray], Trajectory]  # runs a setting of another engine, sampled at times in s


class SettingRuns:
    """Runs a scene with settings.

    Parameters
    ----------
    threads
        Number of threads for settings without a number of their own; None for all cores.
    limit
        CPU time, in s, after which a run of another engine is stopped.
    """

    def __init__(self, scene: Scene, threads: int | None, limit: float) -> None:
        self.scene, self._threads = scene, threads
        self.follow_engine: EngineFollower = lambda setting, times: _engine_called(setting.engine).follow(
            scene, setting, times, limit
        )

    def scene_of(self, result: SettingResult) -> Scene | None:
        """Return the scene with a setting; None if this version refuses it, or another engine runs it."""
        if result.status == "refused" or result.setting.engine:
            return None
        scene = result.setting.apply(self.scene)
        try:
            Space(scene)
        except (SceneError, PhysicsError) as error:
            result.status, result.reason = "refused", str(error)
            return None
        return scene

    def follow(self, result: SettingResult, bound: RunBound, tell: Teller) -> Trajectory | None:
        """Run a setting with samples, and note how it ended; return None if the run was stopped or failed."""
        times, setting = sample_times(self.scene), result.setting
        result.reason, units = "", self.scene.unit_system

        def reached(step: int, time: float) -> None:
            tell(f", {step} steps, t = {units.text(time, TIME)} of {units.text(self.scene.time.duration, TIME)}")

        try:
            if setting.engine:
                run = self.follow_engine(setting, times)
            else:
                space = Space(setting.apply(self.scene), setting.threads or self._threads)
                watch = Stopwatch()
                run = follow(space, times, bound, reached)
                result.followed = watch.seconds
        except RunStoppedError as stopped:
            result.status, result.reason = "stopped", str(stopped)
            result.steps, result.spent = stopped.steps, stopped.seconds
            return None
        except (PhysicsError, ExperimentError) as error:
            result.status, result.reason = "failed", str(error)
            return None
        result.steps, result.frames, result.digest = run.steps, run.frames, run.digest
        return run

    def cost(self, result: SettingResult) -> float:
        """Run a setting once without recording; return its time in s, including the time of a look-ahead.

        With one thread, this is CPU time, which other programs on the machine hardly change.
        """
        setting = result.setting
        if setting.engine:
            return float(_engine_called(setting.engine).run(self.scene, setting))
        threads = setting.threads or self._threads or cores()
        clock = time.thread_time if threads == 1 else time.perf_counter
        scene = setting.apply(self.scene)
        began = clock()
        scene = with_promise(scene, threads)
        ahead = clock() - began
        space = Space(scene, threads)
        space.check_interval = math.inf  # no checks, since other engines compute none
        began = clock()
        for _ in space.run(schedule=at(())):
            pass
        return ahead + clock() - began


def _engine_called(name: str) -> Any:
    """Return an engine (`carom.engines.engine.Engine`); the folder of engines may be missing."""
    return registry.imported("carom.engines.engine:engine_called")(name)
