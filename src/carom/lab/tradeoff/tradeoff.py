"""Measures the cost of accuracy on a scene: runs and times settings in rotation, with errors relative to a reference.

Each measurement is stored at once, in ``tradeoff.json`` and as a trajectory, so that a study can be interrupted and
resumed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from carom import registry
from carom.arrays import FloatArray
from carom.errors import ExperimentError, PhysicsError, SceneError
from carom.lab.compared_run import (
    AS_WRITTEN,
    RunBound,
    RunStoppedError,
    Setting,
    Trajectory,
    follow,
    sample_times,
    write_document,
)
from carom.lab.tradeoff.reference import BUDGET, COMPARED, NAMES, Reference, Teller, fineness, make_reference
from carom.lab.tradeoff.settings_grid import (
    SettingResult,
    pareto_front,
    reference_entry,
    reference_of,
    result_entry,
    result_of,
)
from carom.physics.jit import cores
from carom.physics.look_ahead.find_step import with_promise
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.recording.write.whole_file import output_folder
from carom.runs.environment import environment
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME

DOCUMENT = "tradeoff.json"
REFERENCE = "reference.npz"
FIGURE = "tradeoff.png"
OVERLAY = "tradeoff.rrd"
VERSION = 5  # of the document; before, equal runs were timed apart and held bodies fell between steps
ADVICE = "start over with --force, or choose another folder with -o"
ROUND_OFF = 1e-13  # of a whole run, over its scale
WORK = 3e7  # limit of steps × (bodies + `BODIES_PER_STEP`) of a bounded setting, some 20 s
BODIES_PER_STEP = 30  # the fixed time of a step is about that of this many bodies
DEARER = 30.0  # a bounded setting may always make this many times the steps of the scene as written
MARGIN = 2.0  # smallest allowed ratio of the shortest compared steps to the steps of a refined reference

EngineFollower = Callable[[Setting, FloatArray], Trajectory]  # runs a setting of another engine, sampled at times in s
Examiner = Callable[[SettingResult, Teller], None]  # examines a followed run


def _engine_called(name: str) -> Any:
    """Return an engine, a `carom.engines.engine.Engine`; that folder may be missing."""
    return registry.imported("carom.engines.engine:engine_called")(name)


class Study:
    """The settings of a scene, measured. An earlier study of the same scene in the folder is resumed.

    Parameters
    ----------
    force
        Whether to replace an existing study.
    advice
        Advice in the message if the folder contains another study.
    limit
        s of CPU time at which a run is stopped, and s after which no reference begins.
    files
        Names of the files that the command writes into the folder; existing ones are not replaced before it has a
        study.
    bounded
        Whether each setting is also stopped after a number of steps, see `WORK`, as for default settings.

    Raises
    ------
    ExperimentError
        Without ``force``, if the folder contains a study of another scene, a study that cannot be read, or one of
        ``files`` without a study.
    SceneError
        If the scene is sheared.
    """

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        *,
        threads: int | None = None,
        force: bool = False,
        advice: str = ADVICE,
        limit: float = math.inf,
        bounded: bool = False,
        files: Iterable[str] = (REFERENCE, FIGURE, OVERLAY),
    ) -> None:
        if scene.domain.shear:
            raise SceneError("domain.shear: errors in a sheared box cannot be measured yet; remove it")
        self.scene, self.folder, self.threads = scene, folder, threads
        self.limit, self.bounded = limit, bounded
        self._advice = advice
        self.results: list[SettingResult] = []
        self.reference: Reference | None = None
        self.budget = min(BUDGET, limit)  # s, for the reference
        self.follow_engine: EngineFollower = lambda setting, times: _engine_called(setting.engine).follow(
            scene, setting, times, limit
        )
        self.examine: Examiner = lambda result, tell: None
        self._busy = 0.0
        output_folder(folder)
        if force:
            return
        if (folder / DOCUMENT).exists():
            self._load()
        elif kept := next((folder / name for name in files if (folder / name).exists()), None):
            raise ExperimentError(
                f"{kept}: exists, and no study in {folder} made it; choose another folder with -o, or give "
                "--force to replace it"
            )

    @property
    def noise(self) -> float:
        """The relative uncertainty of every cost: the median of the ranges of the settings' costs.

        A single run deviates by half the range, but two of three runs, and with them the median, may deviate in the
        same direction by chance. A setting with a larger range has the larger uncertainty. 0 if nothing was run twice.
        """
        ranges = [2.0 * result.spread for result in self.results if len(result.costs) > 1]
        return median(ranges) if ranges else 0.0

    def measure(self, settings: list[Setting], repeats: int, tell: Teller) -> list[SettingResult]:
        """Measure the unmeasured settings, and return the results of all given settings.

        The first run of a setting measures its errors and is not timed, because it also compiles kernels. Then all
        settings are timed in rotation, so that a temporary slowdown of the machine affects all of them.
        """
        self.prepare(settings, tell)
        results = [self._result(setting) for setting in settings]
        for number, result in enumerate(results, start=1):
            bound = self._bound(result)
            is_longer = result.steps < bound.steps and result.spent < bound.seconds
            if result.status == "pending" or (result.status == "stopped" and is_longer):
                heading = f"{_count(number, results)}{result.setting.name}: errors"
                tell(heading)
                self._follow(result, lambda text: tell(heading + text))  # noqa: B023
                write_document(self.folder / DOCUMENT, self.document())
                self.examine(result, tell)
        for turn in range(repeats):
            for number, result in enumerate(results, start=1):
                if result.status == "measured" and len(result.costs) <= turn:
                    left = _left(results, repeats)
                    which = _count(number, results)
                    tell(f"{which}{result.setting.name}: cost, {turn + 1} of {repeats}{left}")
                    result.costs.append(self._cost(result))
                    self._busy = max(self._busy, os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0)
                    write_document(self.folder / DOCUMENT, self.document())
        return results

    def prepare(self, settings: list[Setting], tell: Teller) -> Reference:
        """Return the reference of the scene; compute a finer one if some settings need it."""
        scenes = [self._applied(self._result(setting)) for setting in settings]
        finest = max([1.0, *(fineness(self.scene, scene) for scene in scenes if scene is not None)])
        if self.reference is None or self.reference.fineness < MARGIN * finest:
            self.reference = make_reference(self.scene, finest, threads=self.threads, budget=self.budget, tell=tell)
            self.reference.trajectory.save(self.folder / REFERENCE)
            for result in self.results:  # results of an earlier study, which had a coarser reference
                if result.status == "measured":
                    result.errors = self.reference.errors(self.trajectory(result))
            write_document(self.folder / DOCUMENT, self.document())
        return self.reference

    def floor(self, error: str) -> float:
        """Return the uncertainty of the reference, or of rounding: smaller errors are not distinguished."""
        value = getattr(self.reference.uncertainty, error) if self.reference and error in COMPARED else 0.0
        return float(np.fmax(value, ROUND_OFF))

    def marks(self, error: str) -> dict[str, str]:
        """Return "front", "near" (undecided) or "" (beaten) for each setting by name, for one kind of error."""
        done = [result for result in self.results if result.complete and not result.same_as]
        cost = np.array([result.cost for result in done])
        wrong = np.array([max(getattr(result.errors, error), ROUND_OFF) for result in done])
        noise = np.array([max(result.spread, self.noise) for result in done])
        on, near = pareto_front(cost, wrong, noise, self.floor(error) if error in COMPARED else 0.0)
        words = ["front" if a else "near" if b else "" for a, b in zip(on, near, strict=True)]
        return dict(zip((result.setting.name for result in done), words, strict=True))

    def trajectory(self, result: SettingResult) -> Trajectory:
        """Read the trajectory of a setting that is measured."""
        return Trajectory.load(self._path(result))

    def document(self) -> dict[str, Any]:
        """Return all results as one JSON document."""
        marks = {error: self.marks(error) for error in NAMES}
        return {
            "version": VERSION,
            "units": self.scene.unit_system.recorded,
            "scene": {"title": self.scene.title, "bodies": self.scene.count, "toml": self.scene.toml},
            "environment": environment(self.threads or 0),
            "noise": self.noise,
            "load": self._busy,  # largest one-minute load of the machine while costs were measured
            "reference": None if self.reference is None else reference_entry(self.reference),
            "settings": [
                {
                    **result_entry(result),
                    "marks": {e: marks[e].get(result.setting.name, "") for e in NAMES} if result.complete else {},
                }
                for result in self.results
            ],
        }

    def _result(self, setting: Setting) -> SettingResult:
        """Return the result of a setting; creates one if there is none."""
        for result in self.results:
            if _key(result.setting) == _key(setting):
                return result
        self.results.append(SettingResult(setting))
        return self.results[-1]

    def _applied(self, result: SettingResult) -> Scene | None:
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

    def _bound(self, result: SettingResult) -> RunBound:
        """Return the bound of a setting; the scene as written has only the time limit."""
        if not self.bounded or not result.setting.overrides:
            return RunBound(seconds=self.limit)
        own = max((each.steps for each in self.results if each.setting == AS_WRITTEN), default=0)
        return RunBound(max(WORK / (self.scene.count + BODIES_PER_STEP), DEARER * own), self.limit)

    def _follow(self, result: SettingResult, tell: Teller) -> None:
        assert self.reference is not None, "the reference comes first"
        times, setting = sample_times(self.scene), result.setting
        result.reason, units = "", self.scene.unit_system

        def reached(step: int, time: float) -> None:
            tell(f", {step} steps, t = {units.text(time, TIME)} of {units.text(self.scene.time.duration, TIME)}")

        try:
            if setting.engine:
                run = self.follow_engine(setting, times)
            else:
                space = Space(result.setting.apply(self.scene), result.setting.threads or self.threads)
                run = follow(space, times, self._bound(result), reached)
        except RunStoppedError as stopped:
            result.status, result.reason = "stopped", str(stopped)
            result.steps, result.spent = stopped.steps, stopped.seconds
            return
        except (PhysicsError, ExperimentError) as error:
            result.status, result.reason = "failed", str(error)
            return
        run.save(self._path(result))
        result.status, result.errors = "measured", self.reference.errors(run)
        result.steps, result.frames = run.steps, run.frames
        for other in self.results:
            alike = other is not result and other.errors is not None and not other.same_as
            alike = alike and other.steps == run.steps and _threads(other) == _threads(result)
            if alike and self.trajectory(other).is_same(run):
                self._join(result, other)
                return

    def _join(self, result: SettingResult, other: SettingResult) -> None:
        """Let a setting share the costs of another one with the same run."""
        result.same_as, result.costs = other.setting.name, other.costs

    def _cost(self, result: SettingResult) -> float:
        """Run a setting once without recording; return its time in s, including that of a look-ahead.

        On one thread that is CPU time, which other programs on the machine hardly change.
        """
        setting = result.setting
        if setting.engine:
            return float(_engine_called(setting.engine).run(self.scene, setting))
        threads = setting.threads or self.threads or cores()
        clock = time.thread_time if threads == 1 else time.perf_counter
        scene = setting.apply(self.scene)
        began = clock()
        scene = with_promise(scene, threads)
        ahead = clock() - began
        space = Space(scene, threads)
        space.check_interval = math.inf  # other engines compute no checks
        began = clock()
        for _ in space.run(schedule=at(())):
            pass
        return ahead + clock() - began

    def _path(self, result: SettingResult) -> Path:
        threads = [f"threads={result.setting.threads}"] if result.setting.threads else []
        engine = [f"engine={result.setting.engine}"] if result.setting.engine else []
        name = hashlib.sha256("\n".join([*result.setting.overrides, *threads, *engine]).encode()).hexdigest()[:12]
        return self.folder / f"{name}.npz"

    def _load(self) -> None:
        path = self.folder / DOCUMENT
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            theirs, known = kept["scene"]["toml"], kept["reference"]
            if kept["version"] == VERSION and theirs == self.scene.toml:
                if known is not None:
                    self.reference = reference_of(known, self.scene, Trajectory.load(self.folder / REFERENCE))
                for entry in kept["settings"]:
                    result = result_of(entry)
                    if result.status == "measured" and self.reference is not None:
                        result.errors = self.reference.errors(self.trajectory(result))
                    elif result.status in ("refused", "measured"):  # another version may run it
                        result.status = "pending"
                    self.results.append(result)
                by_name = {result.setting.name: result for result in self.results}
                for result in self.results:
                    if result.same_as:
                        self._join(result, by_name[result.same_as])
                self._busy = kept.get("load", 0.0)
                return
            if kept["version"] != VERSION and theirs == self.scene.toml:
                raise ValueError("another version of carom measured it")
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            raise ExperimentError(f"{path}: cannot be resumed ({error}); {self._advice}") from None
        raise ExperimentError(
            f"{self.folder}: holds a study of another scene or of an earlier version of this scene; {self._advice}"
        )


def _key(setting: Setting) -> tuple[tuple[str, ...], int | None, str]:
    """Return the key that identifies a setting; its name may differ."""
    return setting.overrides, setting.threads, setting.engine


def _threads(result: SettingResult) -> tuple[int | None, str]:
    """Return what changes the cost of a run, but not its bits."""
    return result.setting.threads, result.setting.engine


def _count(number: int, results: list[SettingResult]) -> str:
    """Describe the number of a setting."""
    return f"{number}/{len(results)}  " if len(results) > 1 else ""


def _left(results: list[SettingResult], repeats: int) -> str:
    """Estimate the remaining time from earlier timings; empty before the first."""
    known = [result.cost for result in results if result.costs]
    if not known:
        return ""
    typical = median(known)
    runs = [result for result in results if result.status == "measured"]
    seconds = sum((repeats - len(r.costs)) * (r.cost if r.costs else typical) for r in runs if len(r.costs) < repeats)
    return f"; about {seconds:.2g} s left"
