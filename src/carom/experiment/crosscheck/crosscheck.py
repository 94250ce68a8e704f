"""Runs a scene in other engines, and says where each parts from the reference and which law it breaks there.

`Study` measures errors and costs, in turns. Each run is examined: the audit of `carom.record` follows it step by step,
its criteria are those of the scene's [expect], and it is recorded.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from carom.experiment.crosscheck.examination import Examination, examined_other, examined_own
from carom.experiment.crosscheck.parting import parting_of
from carom.experiment.engines.engine import Engine
from carom.experiment.engines.watched import COMPLETED, Watched, watch
from carom.experiment.error import ExperimentError
from carom.experiment.run import recording_space, simulate
from carom.experiment.whole_file import write_whole
from carom.experiment.work_precision.reference import BUDGET
from carom.experiment.work_precision.settings_grid import Setting
from carom.experiment.work_precision.tradeoff import Result, Study
from carom.experiment.work_precision.trajectory import FloatArray, Trajectory
from carom.physics.error import PhysicsError
from carom.recording.errors import RecordingError
from carom.scene.half_space import half_spaces
from carom.scene.names import Names
from carom.scene.placement import place
from carom.scene.schema import Scene

DOCUMENT = "crosscheck.json"
FIGURE = "crosscheck.png"
OVERLAY = "crosscheck.rrd"
VERSION = 1  # of the document
OWN = Setting("carom", ())

Teller = Callable[[str], None]


@dataclass
class Crosscheck:
    """A scene in several engines, measured and examined.

    Parameters
    ----------
    scene
        The scene.
    engines
        To compare carom with.
    folder
        Of the results. What an earlier, interrupted check of the same scene left there is not measured again.
    threads
        For carom's kernels.
    force
        Whether to start over.
    limit
        s of CPU time for following each run of an engine, and s for the reference; what takes longer is stopped.

    Raises
    ------
    ExperimentError
        If an engine is not installed, none can represent the scene, or the folder holds another study.
    """

    scene: Scene
    engines: list[Engine]
    folder: Path
    threads: int | None = None
    force: bool = False
    limit: float = math.inf
    refused: dict[str, str] = field(default_factory=dict)  # engine → why it cannot run the scene
    examinations: dict[str, Examination] = field(default_factory=dict)  # by the names of the settings
    _seen: dict[str, Watched] = field(default_factory=dict)  # likewise, of runs that are not examined yet

    def __post_init__(self) -> None:
        for engine in self.engines:
            engine.ensure_installed()
        able = []
        for engine in self.engines:
            try:
                engine.check(self.scene)
                able.append(engine)
            except ExperimentError as error:
                self.refused[engine.name] = str(error)
        if not able:
            raise ExperimentError("; ".join(self.refused.values()))
        self.engines = able
        self.study = Study(self.scene, self.folder, threads=self.threads, force=self.force)
        self.study.follow_engine, self.study.budget = self._follow, min(BUDGET, self.limit)
        if not self.force:
            self._load()

    @property
    def results(self) -> list[Result]:
        """The measured runs, carom's first."""
        return self.study.results

    def run(self, repeats: int, tell: Teller) -> None:
        """Measure and examine what is not yet."""
        settings = [OWN, *(setting for engine in self.engines for setting in engine.examined(self.scene))]
        self.study.measure(settings, repeats, tell)
        asked = {engine.name for engine in self.engines} | {OWN.engine}
        for result in self.results:
            name = result.setting.name
            if name in self.examinations or result.setting.engine not in asked:
                continue
            tell(f"{name}: laws")
            self.examinations[name] = self._examined(result)
            self._save()

    def document(self) -> dict[str, Any]:
        """Return all results as one JSON document."""
        notes = {engine.name: engine.notes(self.scene) for engine in self.engines}
        reference = self.study.document()["reference"]
        runs = []
        for result in self.results:
            examined = self.examinations.get(result.setting.name)
            runs.append({**self.study.entry(result), **({} if examined is None else asdict(examined))})
        return {
            "version": VERSION,
            "scene": {"title": self.scene.title, "bodies": self.scene.count, "toml": self.scene.toml},
            "reference": reference,
            "refused": self.refused,
            "notes": notes,
            "runs": runs,
        }

    def _follow(self, setting: Setting, times: FloatArray) -> Trajectory:
        """Run a setting of an engine, and examine it on the way if its samples are taken from its steps, too."""
        engine = self._engine(setting)
        if not engine.samples_steps(self.scene):
            return engine.follow(self.scene, setting, times)
        seen = self._watched(setting, times)
        if seen.outcome != COMPLETED:
            raise ExperimentError(seen.outcome.removeprefix("failed: "))
        return seen.trajectory

    def _watched(self, setting: Setting, times: FloatArray) -> Watched:
        """Follow a run step by step, and record it."""
        simulation = self._engine(setting).begin(self.scene, setting)
        seen = watch(simulation, self.scene, times, self._recording(setting), self.limit)
        self._seen[setting.name] = seen
        return seen

    def _examined(self, result: Result) -> Examination:
        """Look at a run that is measured."""
        setting = result.setting
        if not setting.engine:
            return self._own(result)
        assert self.study.reference is not None, "it is measured first"
        seen = self._seen.pop(setting.name, None) or self._watched(setting, self.study.reference.trajectory.time)
        parting = self._parting(result, seen.broken, seen.dt)
        return examined_other(setting.name, self.scene, seen, parting, self._recording(setting).name)

    def _own(self, result: Result) -> Examination:
        """Run carom and record it."""
        try:
            path = self.folder / f"{OWN.name}.rrd"
            outcome = simulate(recording_space(self.scene, self.threads), path, force=True)
        except (PhysicsError, RecordingError) as error:
            raise ExperimentError(f"carom: {error}") from error
        broken = [(event.time, event.kind) for event in outcome.warnings]
        return examined_own(OWN.name, outcome, self._parting(result, broken, 0.0))

    def _engine(self, setting: Setting) -> Engine:
        return next(engine for engine in self.engines if engine.name == setting.engine)

    def _recording(self, setting: Setting) -> Path:
        return self.folder / f"{_file_name(setting.name)}.rrd"

    def _parting(self, result: Result, broken: list[tuple[float, str]], dt: float) -> dict[str, Any] | None:
        """Compare a measured run with the reference."""
        reference = self.study.reference
        if reference is None or result.status != "measured":
            return None
        found = parting_of(self.study.trajectory(result), reference, broken, dt, self._names())
        return None if found is None else asdict(found)

    def _names(self) -> Names:
        return Names(place(self.scene).name, half_spaces(self.scene).name)

    def _save(self) -> None:
        write_whole(self.folder / DOCUMENT, json.dumps(self.document(), indent=1, ensure_ascii=False))

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
            raise ExperimentError(f"{path}: cannot be resumed ({error}); give --force to begin anew") from None


def _file_name(name: str) -> str:
    """Make a name of a file of the name of a setting."""
    kept = "".join(letter if letter.isalnum() or letter == "." else "-" for letter in name)
    return "-".join(part for part in kept.split("-") if part)
