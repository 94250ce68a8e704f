"""Measures the cost of accuracy on a scene: runs and times settings in rotation, with errors relative to a reference.

Each measurement is stored at once, in ``tradeoff.json`` and as a trajectory, so that a study can be interrupted and
resumed.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from carom.errors import ExperimentError, SceneError
from carom.lab.compared_run import (
    AS_WRITTEN,
    RunBound,
    Setting,
    Trajectory,
    write_document,
)
from carom.lab.tradeoff.budget import (
    ALONE,
    CHEAPER,
    FASTEST,
    FOR_THE_REFERENCE,
    FOR_TIMES,
    MOST_TIMINGS,
    PRECISION,
    SHORT,
    TIMINGS,
    StudyBudget,
    errs_by_rounding,
    estimated_cost,
    is_beaten,
)
from carom.lab.tradeoff.reference import BUDGET, COMPARED, NAMES, Errors, Reference, Teller, fineness, make_reference
from carom.lab.tradeoff.setting_runs import SettingRuns
from carom.lab.tradeoff.settings_grid import (
    SettingResult,
    pareto_front,
)
from carom.lab.tradeoff.study_document import (
    DOCUMENT,
    REFERENCE,
    VERSION,
    read_document,
    reference_entry,
    result_entry,
    trajectory_path,
)
from carom.recording.write.whole_file import output_folder
from carom.runs.environment import environment
from carom.scene.load import Scene
from carom.terminal.printing import finite

FIGURES = "tradeoff.png", "tradeoff.svg", "tradeoff.pdf"  # files of the figure, as pixels and as vectors
TABLE = "tradeoff.csv"
OVERLAY = "tradeoff.rrd"
ADVICE = "start over with --force, or choose another folder with -o"
ROUND_OFF = 1e-13  # round-off of a whole run, relative to its scale
WORK = 3e7  # limit on steps × (bodies + `BODIES_PER_STEP`) of a bounded setting, some 20 s
BODIES_PER_STEP = 30  # number of bodies whose step takes as long as a step without bodies
DEARER = 30.0  # steps that a bounded setting may always make, in multiples of the steps of the scene as written
CERTAIN = 6  # smallest number of costs whose range contains the median with 95 % probability
WRITING = 1.0  # s between two writings of the document while short runs are timed
MARGIN = 2.0  # smallest allowed ratio of the shortest compared step to the step of a refined reference

Examiner = Callable[[SettingResult, Teller], None]  # examines a followed run


class Study:
    """The settings of a scene, measured. An earlier study of the same scene in the folder is resumed.

    Parameters
    ----------
    force
        Whether to replace an existing study.
    advice
        Advice in the message if the folder contains another study.
    limit
        CPU time, in s, after which a run is stopped, and limit of the time of a reference.
    files
        Names of the files that the command writes into the folder; existing files are not replaced before the folder
        has a study.
    bounded
        Whether each setting is also stopped after a number of steps (see `WORK`), as the default settings are.
    budget
        Time, in s, that all measurements may take; None for `RUNS` times the time that the scene takes as written.

    Raises
    ------
    ExperimentError
        Without ``force``, if the folder contains a study of another scene, a study that cannot be read, or one of
        ``files`` without a study.
    SceneError
        If the scene is sheared, or bodies enter or leave.
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
        budget: float | None = math.inf,
        files: Iterable[str] = (REFERENCE, *FIGURES, TABLE, OVERLAY),
    ) -> None:
        if scene.domain.shear:
            raise SceneError("domain.shear: errors in a sheared box cannot be measured yet; remove it")
        if scene.admits:
            raise SceneError(
                "bodies enter and leave as a step begins, so the errors of a scene with [group.release] or [[outlet]] "
                "cannot be measured; remove these sections"
            )
        self.scene, self.folder, self.threads = scene, folder, threads
        self.limit, self.bounded = limit, bounded
        self.results: list[SettingResult] = []
        self.reference: Reference | None = None
        self.budget = StudyBudget(budget)
        self.runs = SettingRuns(scene, threads, limit)
        self.examine: Examiner = lambda result, tell: None
        self._busy, self._written_at, self._is_unwritten = 0.0, 0.0, False
        self._environment: dict[str, str | int] = {}
        output_folder(folder)
        if force:
            return
        if (folder / DOCUMENT).exists():
            self.reference, self.results, self._busy = read_document(folder, scene, advice)
        elif kept := next((folder / name for name in files if (folder / name).exists()), None):
            raise ExperimentError(
                f"{kept}: exists, and no study in {folder} made it; choose another folder with -o, or give "
                "--force to replace it"
            )

    @property
    def noise(self) -> float:
        """The relative uncertainty of every cost: the median of the intervals, or of the ranges if costs are few.

        A single run deviates by half the range, but two of three runs, and therefore the median, may deviate in the
        same direction by chance. A setting with a larger range has a larger uncertainty. The result is 0 if nothing was
        run twice.
        """
        ranges = [
            result.spread if len(result.costs) >= CERTAIN else 2.0 * result.spread
            for result in self.results
            if len(result.costs) > 1
        ]
        return median(ranges) if ranges else 0.0

    def doubt(self, result: SettingResult) -> float:
        """Return the relative uncertainty of a cost: its own if certain, otherwise at least the noise of all costs."""
        return result.spread if len(result.costs) >= CERTAIN else max(result.spread, self.noise)

    def measure(
        self, settings: list[Setting], repeats: int | None, tell: Teller, *, chooses: bool = False
    ) -> list[SettingResult]:
        """Measure the unmeasured settings, and return the results of all given settings.

        The first run of a setting measures its errors and is not timed, because it also compiles kernels. Then all
        settings are timed in rotation, so that a temporary slowdown of the machine affects all of them.

        Parameters
        ----------
        repeats
            Number of timings of each setting; None for as many as the front needs, within the budget.
        chooses
            Whether to leave out settings that cannot be on the front.
        """
        results = [self._result(setting) for setting in settings]
        scenes = [self.runs.scene_of(result) for result in results]  # loads the scenes' kernels before the clock runs
        if self.budget.seconds is None:
            self.budget.choose(self._run_time(tell))
        self.budget.begin()
        self._prepare(scenes, tell)
        self.budget.reserve += FOR_TIMES
        for number, (result, scene) in enumerate(zip(results, scenes, strict=True), start=1):
            self._examine_setting(result, scene, f"{_count(number, results)}{result.setting.name}", tell, chooses)
            if repeats is None and result.status == "measured" and not result.costs and not self._is_left_out(result):
                if chooses and (rival := self._dominating(result)):
                    result.reason = f'"{rival}" is as accurate and clearly cheaper'
                    continue
                tell(f"{_count(number, results)}{result.setting.name}: cost{self.budget.text}")
                self._time(result)
        self.budget.reserve -= FOR_TIMES
        try:
            while due := [result for result in results if self._needs_a_run(result, repeats)]:
                for result in due:
                    if self.budget.is_over and any(each.complete for each in self.results):
                        for untimed in due:
                            self._is_left_out(untimed)
                        return results
                    count, run = _count(results.index(result) + 1, results), len(result.costs) + 1
                    of = "" if repeats is None else f" of {repeats}"
                    left = self.budget.text or _left(results, repeats)
                    tell(f"{count}{result.setting.name}: cost, {run}{of}{left}")
                    self._time(result)
        finally:
            if self._is_unwritten:
                self._write()
        return results

    def _examine_setting(
        self, result: SettingResult, scene: Scene | None, heading: str, tell: Teller, chooses: bool
    ) -> None:
        """Measure the errors of a setting, unless they are known or the setting is left out."""
        bound = self._bound(result)
        is_longer = result.steps < bound.steps and result.spent < bound.seconds
        if result.status not in ("pending", "left out") and not (result.status == "stopped" and is_longer):
            return
        if chooses and scene is not None and (rival := self._exact_and_cheaper(scene)):
            result.status, result.reason = "left out", f'"{rival}" errs by rounding alone, and shorter steps cost more'
            return
        if self._is_left_out(result):
            return
        heading = f"{heading}: errors"
        tell(heading + self.budget.text)
        self._follow(result, lambda text: tell(heading + text + self.budget.text))
        self._write()
        self.examine(result, tell)

    def _is_left_out(self, result: SettingResult) -> bool:
        """Return whether the budget is too small for a run, and note it; the first setting is always measured."""
        written = self._written
        least = 0.0 if written is None or result.status == "measured" else FASTEST * written.followed
        if self.budget.left > least or not any(other is not result and other.errors for other in self.results):
            return False
        if result.status in ("pending", "left out"):
            result.status = "left out"
        if result.status == "left out" or not result.costs:
            result.reason = f"the budget of {self.budget.seconds:.3g} s was spent"
            self._is_unwritten = True
        return True

    def _run_time(self, tell: Teller) -> float:
        """Return the time (s) of the scene as written, which sets the budget; the kernels are already loaded."""
        written = self._written or SettingResult(AS_WRITTEN)
        if not written.costs:
            tell("as written: the time of a run")
            if written.status != "measured":
                self._follow(written, lambda text: tell(f"as written{text}"))
            if written.status != "measured":  # for example, if the run was stopped at its limit
                return written.spent
            written.costs.append(self.runs.cost(written))
        return written.cost

    @property
    def _written(self) -> SettingResult | None:
        return next((result for result in self.results if result.setting == AS_WRITTEN), None)

    @property
    def _floors(self) -> Errors:
        """The uncertainties of the errors."""
        return Errors(**{name: self.floor(name) for name in NAMES})

    def _exact_and_cheaper(self, scene: Scene) -> str:
        """Name a timed setting that has only rounding errors and is cheaper than a scene with shorter steps, if any."""
        written = self._written
        finer = fineness(self.scene, scene)
        if written is None or not written.complete or finer <= 1.0:
            return ""
        return next(
            (
                rival.setting.name
                for rival in self.results
                if rival.errors is not None and rival.costs and errs_by_rounding(rival.errors, self._floors)
                if rival.cost < finer * written.cost
            ),
            "",
        )

    def _dominating(self, result: SettingResult) -> str:
        """Name a timed setting, if any, as accurate as ``result`` and clearly cheaper than its estimated cost."""
        written = self._written
        if written is None or result.errors is None or result.setting.engine or result.setting.threads:
            return ""
        least = estimated_cost(result, written)
        return next(
            (
                rival.setting.name
                for rival in self.results
                if rival.errors is not None and rival.costs and CHEAPER * rival.cost < least
                if is_beaten(result.errors, rival.errors, self._floors)
            ),
            "",
        )

    def _needs_a_run(self, result: SettingResult, repeats: int | None) -> bool:
        """Return whether to time a setting again; without a number of repeats, as long as the front is uncertain."""
        timed = len(result.costs)
        if result.status != "measured" or result.same_as:
            return False
        if repeats is not None:
            return timed < repeats
        is_vague = timed < TIMINGS or (result.cost < SHORT and result.spread > PRECISION and timed < MOST_TIMINGS)
        if not timed or not is_vague:
            return False
        noise = ALONE if timed < TIMINGS else 0.0
        return result.setting == AS_WRITTEN or any(self.marks(name, noise)[result.setting.name] for name in NAMES)

    def _time(self, result: SettingResult) -> None:
        """Run a setting once and keep its cost."""
        result.costs.append(self.runs.cost(result))
        result.reason, self._is_unwritten = "", True
        self._busy = max(self._busy, os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0)
        if time.perf_counter() - self._written_at > WRITING:
            self._write()

    def _write(self) -> None:
        """Write the document."""
        write_document(self.folder / DOCUMENT, self.document())
        self._written_at, self._is_unwritten = time.perf_counter(), False

    def prepare(self, settings: list[Setting], tell: Teller) -> Reference:
        """Return the reference of the scene; compute a finer reference if some settings need it."""
        return self._prepare([self.runs.scene_of(self._result(setting)) for setting in settings], tell)

    def _prepare(self, scenes: list[Scene | None], tell: Teller) -> Reference:
        finest = max([1.0, *(fineness(self.scene, scene) for scene in scenes if scene is not None)])
        if self.reference is None or self.reference.fineness < MARGIN * finest:
            budget = min(BUDGET, self.limit, FOR_THE_REFERENCE * self.budget.left)
            self.reference = make_reference(self.scene, finest, threads=self.threads, budget=budget, tell=tell)
            self.reference.trajectory.save(self.folder / REFERENCE)
            # settings may have run before this reference was made, perhaps in an earlier study with a coarser one
            for result in self.results:
                if result.status == "measured":
                    result.errors = self.reference.errors(self.trajectory(result))
            self._write()
        return self.reference

    def floor(self, error: str) -> float:
        """Return the uncertainty of an error, by the reference or by rounding; smaller errors are not distinguished."""
        value = getattr(self.reference.uncertainty, error) if self.reference and error in COMPARED else 0.0
        return float(np.fmax(value, ROUND_OFF))

    def marks(self, error: str, least_noise: float = 0.0) -> dict[str, str]:
        """Return "front", "near" (undecided) or "" (beaten) for each setting by name, for one kind of error.

        ``least_noise`` is a lower limit of the relative noise of every cost.
        """
        done = [result for result in self.results if result.complete and not result.same_as]
        cost = np.array([result.cost for result in done])
        wrong = np.array([max(getattr(result.errors, error), ROUND_OFF) for result in done])
        noise = np.array([max(self.doubt(result), least_noise) for result in done])
        on, near = pareto_front(cost, wrong, noise, self.floor(error) if error in COMPARED else 0.0)
        words = ["front" if a else "near" if b else "" for a, b in zip(on, near, strict=True)]
        return dict(zip((result.setting.name for result in done), words, strict=True))

    def trajectory(self, result: SettingResult) -> Trajectory:
        """Read the trajectory of a setting that is measured."""
        return Trajectory.load(trajectory_path(self.folder, result.setting))

    @property
    def left_out(self) -> dict[str, str]:
        """The settings that were left out or not timed, by name, with the reason."""
        return {
            result.setting.name: result.reason
            for result in self.results
            if result.reason and (result.status == "left out" or (result.status == "measured" and not result.costs))
        }

    def document(self) -> dict[str, Any]:
        """Return all results as one JSON document."""
        marks = {error: self.marks(error) for error in NAMES}
        self._environment = self._environment or environment(self.threads or 0)
        return {
            "version": VERSION,
            "units": self.scene.unit_system.recorded,
            "scene": {"title": self.scene.title, "bodies": self.scene.count, "toml": self.scene.toml},
            "environment": self._environment,
            "noise": self.noise,
            "load": self._busy,  # largest one-minute load of the machine while costs were measured
            # s, budget; null without a limit
            "budget": finite(math.inf if self.budget.seconds is None else self.budget.seconds),
            "spent": self.budget.spent,  # s, time spent by the last command
            "left_out": self.left_out,
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
        """Return the result of a setting, which is created at the first call."""
        for result in self.results:
            if _key(result.setting) == _key(setting):
                return result
        self.results.append(SettingResult(setting))
        return self.results[-1]

    def _bound(self, result: SettingResult) -> RunBound:
        """Return the bound of a setting; the scene as written has only the time limit."""
        own = self._written
        seconds = self.budget.left if own is not None and own.complete else math.inf
        limit = (seconds, "--budget") if seconds < self.limit else (self.limit, "--limit")
        if not self.bounded or not result.setting.overrides:
            return RunBound(math.inf, *limit)
        most = max(WORK / (self.scene.count + BODIES_PER_STEP), DEARER * (own.steps if own is not None else 0))
        return RunBound(most, *limit)

    def _follow(self, result: SettingResult, tell: Teller) -> None:
        """Run a setting for its errors, and keep its trajectory."""
        run = self.runs.follow(result, self._bound(result), tell)
        if run is None:
            return
        run.save(trajectory_path(self.folder, result.setting))
        result.status, result.errors = "measured", self.reference.errors(run) if self.reference else None
        for other in self.results:
            alike = other is not result and other.errors is not None and not other.same_as
            if alike and other.digest == result.digest and _machine(other) == _machine(result):
                result.share_costs_of(other)
                return


def _key(setting: Setting) -> tuple[tuple[str, ...], int | None, str]:
    """Return the key that identifies a setting, whatever its name."""
    return setting.overrides, setting.threads, setting.engine


def _machine(result: SettingResult) -> tuple[int | None, str]:
    """Return the properties that change the cost of a run but not its bits: threads and engine."""
    return result.setting.threads, result.setting.engine


def _count(number: int, results: list[SettingResult]) -> str:
    """Describe the position of a setting among all settings, such as 3/12; empty if there is only one."""
    return f"{number}/{len(results)}  " if len(results) > 1 else ""


def _left(results: list[SettingResult], repeats: int | None) -> str:
    """Estimate the remaining time from earlier timings; empty before a timing, or without a number of repeats."""
    known = [result.cost for result in results if result.costs]
    if not known or repeats is None:
        return ""
    typical = median(known)
    runs = [result for result in results if result.status == "measured"]
    seconds = sum((repeats - len(r.costs)) * (r.cost if r.costs else typical) for r in runs if len(r.costs) < repeats)
    return f"; about {seconds:.2g} s left"
