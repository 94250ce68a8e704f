"""Runs a scene in other engines, and finds where each engine leaves the reference, and which law it violates there.

Each run is first recorded and examined: `carom.record` audits every step, and the scene's [expect] states the criteria.
`Study` then measures the costs of all runs, in rotation.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from carom.arrays import FloatArray
from carom.engines.crosscheck.parting import NumberedImpacts, parting_of
from carom.engines.engine import COMPLETED, Engine, Watched, engine_called, watch
from carom.engines.source import named_version
from carom.errors import ExperimentError, PhysicsError, RecordingError
from carom.lab.compared_run import Setting, Trajectory, sample_times, write_document
from carom.lab.tradeoff.settings_grid import SettingResult
from carom.lab.tradeoff.study_document import REFERENCE, result_entry
from carom.lab.tradeoff.tradeoff import Study
from carom.physics.jit import cores
from carom.physics.placement import place
from carom.recording.read.recording import Recording
from carom.runs.outcome import Verdict, judge
from carom.runs.run import recording_space, simulate
from carom.runs.workers import Ended, LocalWorkers, WorkerDiedError
from carom.scene.load import Scene
from carom.scene.start import names_of_solids
from carom.scene.wording import Names
from carom.terminal.printing import finite


@dataclass(frozen=True, slots=True)
class Examination:
    """The result of following one run step by step: criteria, violated laws, divergence from the reference."""

    name: str
    # criteria of [expect]: name, bound, limit, measured, judged, met (None if not judged)
    criteria: list[dict[str, Any]]
    laws: dict[str, dict[str, Any]]  # violated laws, with the first violating frame and the number of such frames
    parting: dict[str, Any] | None  # see `Parting`; None without a divergence in the compared time
    recording: str  # name of the recording in the results' folder
    energy: dict[str, float | None]  # energy changes over the energy scale; see `energy_changes`


# prefixes of criteria that only runs of carom can meet or miss, since samples have no spins
_OF_CAROM = ("contact_audit", "dissipation_error", "warned_", "angular_velocity_")


@dataclass(frozen=True, slots=True)
class _LastSample:
    """The state of the bodies at the end of a trajectory."""

    trajectory: Trajectory

    @property
    def position(self) -> FloatArray | None:
        return self.trajectory.position[-1] if len(self.trajectory) else None

    @property
    def velocity(self) -> FloatArray | None:
        return self.trajectory.velocity[-1] if len(self.trajectory) else None

    @property
    def angular_velocity(self) -> FloatArray | None:
        return None


def energy_changes(path: Path) -> dict[str, float | None]:
    """Return the changes of the energy in a recording, over the energy scale.

    ``change`` is the change of the total energy. For another engine, ``in_contact`` is the change while bodies touched,
    caused by contacts and errors together; ``without_contact`` is the remaining change, which is an error.
    """
    energy = Recording.open(path).summary()["energy"]
    found = {"change": energy["final"] - energy["initial"]}
    names = {"in_contact": "change_in_contact", "without_contact": "change_without_contact"}
    found |= {name: energy[key] for name, key in names.items() if key in energy}
    scale = energy.get("reference", 0.0)
    return {name: finite(change / scale) if scale else None for name, change in found.items()}


def _entry(verdict: Verdict, judged: bool = True) -> dict[str, Any]:
    judged = judged and verdict.judged
    return {
        "name": verdict.name,
        "bound": verdict.bound,
        "limit": verdict.limit,
        "measured": finite(verdict.measured),
        "judged": judged,
        "met": verdict.met if judged else None,
    }


# Several processes follow runs of engines at the same time; nothing is timed meanwhile.
MIN_RUNS_FOR_PROCESSES = 8  # with fewer runs, starting processes costs more time than they save
_TICK = 60.0  # s, the longest single wait for results


@dataclass(frozen=True, slots=True)
class CrosscheckTask:
    """A run of an engine to follow."""

    scene: Scene
    setting: Setting
    path: Path  # path of its recording
    limit: float  # s, limit of CPU time


@dataclass(frozen=True, slots=True)
class Followed:
    """The result of a task."""

    watched: Watched
    trajectory: Trajectory | None  # None if the run failed
    reason: str  # why it failed


def execute(task: CrosscheckTask) -> Followed:
    """Follow a run step by step and record it; repeat it for samples between steps if the engine supports them."""
    engine = engine_called(task.setting.engine)
    engine.ensure_installed()
    times = sample_times(task.scene)
    seen = watch(engine.begin(task.scene, task.setting), task.scene, times, task.path, task.limit)
    if engine.samples_steps(task.scene):
        done = seen.outcome == COMPLETED
        return Followed(seen, seen.trajectory if done else None, "" if done else seen.outcome.removeprefix("failed: "))
    try:
        return Followed(seen, engine.follow(task.scene, task.setting, times), "")
    except ExperimentError as error:
        return Followed(seen, None, str(error))


class Runs(ExitStack):
    """Follows runs in some processes; as a context, it ends the processes of unfinished runs.

    ``workers`` is the number of processes; 1 is this process alone. None means one per core if there are at least
    `MIN_RUNS_FOR_PROCESSES` runs.
    """

    def __init__(self, workers: int | None) -> None:
        super().__init__()
        self._workers = workers
        self._tasks: dict[Path, CrosscheckTask] = {}
        self._pool: LocalWorkers | None = None
        self._begun: set[Path] = set()
        self._ended: dict[Path, Ended] = {}

    def announce(self, task: CrosscheckTask) -> None:
        """Register a run whose result will be requested."""
        self._tasks[task.path] = task

    def begin(self) -> None:
        """Start processes for all registered runs, unless there are too few of them."""
        workers = self._workers or (cores() if len(self._tasks) >= MIN_RUNS_FOR_PROCESSES else 1)
        if workers == 1 or len(self._tasks) < 2:
            return
        self._pool = self.enter_context(LocalWorkers(min(workers, len(self._tasks)), attempts=1))
        self._begun = set(self._tasks)
        self._pool.send(execute, self._tasks)

    def result(self, task: CrosscheckTask) -> Followed:
        """Return the result of a run: wait for it, or follow it in this process."""
        if task.path not in self._begun:
            return execute(task)
        self._begun.remove(task.path)
        assert self._pool is not None
        while task.path not in self._ended:
            self._ended |= {ended.key: ended for ended in self._pool.ended(_TICK)}
        try:
            followed: Followed = self._ended.pop(task.path).result
        except WorkerDiedError:
            raise ExperimentError(
                f"{task.setting.name} ended its process; run the same command again to continue, or with --workers 1 "
                "to use a single process"
            ) from None
        return followed


DOCUMENT = "crosscheck.json"
FIGURE = "crosscheck.png"
OVERLAY = "crosscheck.rrd"
VERSION = 2  # version of the document; in version 1, unjudged criteria counted as met, and energies were missing
OWN = Setting("carom", ())

Teller = Callable[[str], None]


@dataclass
class Crosscheck:
    """A scene in several engines, measured and examined.

    ExperimentError if an engine is not installed, none can represent the scene, or the folder holds another study.
    """

    scene: Scene
    engines: list[Engine]  # engines to compare carom with
    folder: Path  # folder of the results, perhaps with results of an interrupted crosscheck of the same scene
    threads: int | None = None  # number of threads for carom's kernels
    force: bool = False  # whether to start over
    limit: float = math.inf  # time limit: s of CPU time for an engine, s for the reference; a longer run is stopped
    runs: Runs = field(default_factory=lambda: Runs(1))
    refused: dict[str, str] = field(default_factory=dict)  # engine → why it cannot run the scene
    examinations: dict[str, Examination] = field(default_factory=dict)  # examinations by the names of their settings
    _seen: dict[str, Watched] = field(default_factory=dict)  # observations of runs that are not examined yet

    def __post_init__(self) -> None:
        for engine in self.engines:
            engine.ensure_installed()
            try:
                engine.check(self.scene)
            except ExperimentError as error:
                self.refused[engine.name] = str(error)
        self.engines = [engine for engine in self.engines if engine.name not in self.refused]
        if not self.engines:
            raise ExperimentError("; ".join(self.refused.values()))
        own = (DOCUMENT, FIGURE, OVERLAY, REFERENCE, *(self._recording(setting).name for setting in self._settings()))
        self.study = Study(self.scene, self.folder, threads=self.threads, force=self.force, limit=self.limit, files=own)
        self.study.runs.follow_engine, self.study.examine = self._follow, self._examine
        if not self.force:
            self._load()

    @property
    def results(self) -> list[SettingResult]:
        """The measured runs, starting with carom's."""
        return self.study.results

    def announce(self) -> None:
        """Register the runs that are not yet followed."""
        for setting in self._settings():
            name, known = setting.name, {result.setting.name: result.status for result in self.results}
            if setting.engine and (name not in self.examinations or known.get(name, "pending") == "pending"):
                self.runs.announce(self._task(setting))

    def follow(self, tell: Teller) -> None:
        """Follow and examine the remaining runs; nothing is timed."""
        for result in self.study.measure(self._settings(), 0, tell):
            self._examine(result, tell)  # an interruption left these runs unexamined

    def time(self, repeats: int, tell: Teller) -> None:
        """Time all runs in rotation, a number of times."""
        self.study.measure(self._settings(), repeats, tell)
        write_document(self.folder / DOCUMENT, self.document())

    def _settings(self) -> list[Setting]:
        return [OWN, *(setting for engine in self.engines for setting in engine.examined(self.scene))]

    def _task(self, setting: Setting) -> CrosscheckTask:
        return CrosscheckTask(self.scene, setting, self._recording(setting), self.limit)

    def document(self) -> dict[str, Any]:
        """Return all results as one JSON document."""
        runs = []
        for result in self.results:
            examined = self.examinations.get(result.setting.name)
            runs.append({**result_entry(result), **({} if examined is None else asdict(examined))})
        engines = self.engines
        return {
            "version": VERSION,
            "units": self.scene.unit_system.recorded,
            "scene": {"title": self.scene.title, "bodies": self.scene.count, "toml": self.scene.toml},
            "reference": self.study.document()["reference"],
            "refused": self.refused,
            "notes": {engine.name: engine.notes(self.scene) for engine in engines},
            "versions": {each.name: named_version(each.name, getattr(each, "package", None)) for each in engines},
            "runs": runs,
        }

    def _follow(self, setting: Setting, times: FloatArray) -> Trajectory:
        """Follow a setting of an engine; return its samples, and store its observations for the examination."""
        followed = self.runs.result(self._task(setting))
        self._seen[setting.name] = followed.watched
        if followed.trajectory is None:
            raise ExperimentError(followed.reason)
        return followed.trajectory

    def _examine(self, result: SettingResult, tell: Teller) -> None:
        """Examine a run that was followed, unless it is already examined, and save the result."""
        name = result.setting.name
        if name not in self.examinations:
            tell(f"{name}: laws")
            self.examinations[name] = self._examined(result)
            write_document(self.folder / DOCUMENT, self.document())

    def _examined(self, result: SettingResult) -> Examination:
        """Return the examination of a measured run."""
        setting, scene = result.setting, self.scene
        path = self._recording(setting)
        if not setting.engine:  # the warnings of carom are the violated laws
            try:
                outcome = simulate(recording_space(scene, self.threads), path, force=True)
            except (PhysicsError, RecordingError) as error:
                raise ExperimentError(f"carom: {error}") from error
            broken, dt = [(event.time, event.kind) for event in outcome.warnings], 0.0
            laws = {
                event.kind: {"step": event.step, "time": event.time, "text": event.text.splitlines()[0], "frames": 1}
                for event in reversed(outcome.warnings)
            }
            criteria = [_entry(v) for v in outcome.verdicts]
        else:
            seen = self._seen.pop(setting.name, None) or self.runs.result(self._task(setting)).watched
            broken, dt = seen.broken, seen.dt
            laws = {
                fault.law: {
                    "step": fault.step,
                    "time": fault.time,
                    "text": fault.text,
                    "frames": seen.counts[fault.law],
                }
                for fault in seen.faults
            }
            whole, touched = seen.outcome == COMPLETED, math.isnan(seen.trajectory.energy_error)
            end = scene.time.duration if whole else seen.extremes.kinetic.time
            verdicts = judge(scene, seen.extremes, end, _LastSample(seen.trajectory))
            criteria = [
                # A run that ended early might have exceeded a limit later. If bodies touched, only a lower bound of the
                # integrator's error is known: the energy that contacts absorbed cannot be separated from it.
                _entry(v, judged=not v.met) if not whole or (v.name == "energy_error" and touched) else _entry(v)
                for v in verdicts
                if not v.name.startswith(_OF_CAROM)
            ]
        parting = self._parting(result, broken, dt)
        return Examination(setting.name, criteria, laws, parting, path.name, energy_changes(path))

    def _recording(self, setting: Setting) -> Path:
        kept = "".join(letter if letter.isalnum() or letter == "." else "-" for letter in setting.name)
        return self.folder / f"{'-'.join(part for part in kept.split('-') if part)}.rrd"

    def _parting(self, result: SettingResult, broken: list[tuple[float, str]], dt: float) -> dict[str, Any] | None:
        """Compare a measured run with the reference."""
        reference = self.study.reference
        if reference is None or result.status != "measured":
            return None
        numbered = NumberedImpacts.of(self._recording(OWN))
        names = Names(place(self.scene).name, names_of_solids(self.scene))
        found = parting_of(self.study.trajectory(result), reference, broken, dt, names, numbered)
        return None if found is None else asdict(found)

    def _load(self) -> None:
        path = self.folder / DOCUMENT
        if not path.exists():
            return
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            if kept["version"] != VERSION or kept["scene"]["toml"] != self.scene.toml:
                return
            for run in kept["runs"]:
                if "laws" in run and (self.folder / run["recording"]).exists():
                    names = Examination.__dataclass_fields__
                    self.examinations[run["name"]] = Examination(**{name: run[name] for name in names})
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ExperimentError(f"{path}: cannot be resumed ({error}); start over with --force") from None
