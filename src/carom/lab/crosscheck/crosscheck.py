"""Runs a scene in other engines, and says where each diverges from the reference and which law it breaks there.

Each run is first followed: the audit of `carom.record` looks at every step, the criteria are those of the scene's
[expect], and it is recorded. `Study` then measures costs, in turns.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from carom.errors import ExperimentError, PhysicsError, RecordingError
from carom.lab.crosscheck.examination import Examination, examined_other, examined_own
from carom.lab.crosscheck.parting import NumberedImpacts, parting_of
from carom.lab.crosscheck.runs import Runs, Task
from carom.lab.engines.engine import Engine
from carom.lab.engines.watched import Watched
from carom.lab.tradeoff.result import Result
from carom.lab.tradeoff.settings_grid import Setting
from carom.lab.tradeoff.stored_study import result_entry
from carom.lab.tradeoff.tradeoff import REFERENCE, Study
from carom.lab.tradeoff.trajectory import FloatArray, Trajectory
from carom.physics.placement import place
from carom.recording.write.whole_file import write_whole
from carom.runs.run import recording_space, simulate
from carom.scene.schema import Scene
from carom.scene.start import half_spaces
from carom.scene.wording import Names

DOCUMENT = "crosscheck.json"
FIGURE = "crosscheck.png"
OVERLAY = "crosscheck.rrd"
VERSION = 2  # of the document; 1 counted criteria that were not judged as met, and had no energies
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
    runs
        Follows the runs of engines.

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
    runs: Runs = field(default_factory=lambda: Runs(1))
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
        own = (DOCUMENT, FIGURE, OVERLAY, REFERENCE, *(self._recording(setting).name for setting in self._settings()))
        self.study = Study(self.scene, self.folder, threads=self.threads, force=self.force, limit=self.limit, files=own)
        self.study.follow_engine, self.study.examine = self._follow, self._examine
        if not self.force:
            self._load()

    @property
    def results(self) -> list[Result]:
        """The measured runs, carom's first."""
        return self.study.results

    def announce(self) -> None:
        """Tell what follows the runs which of them are not followed yet."""
        for setting in self._settings():
            name, known = setting.name, {result.setting.name: result.status for result in self.results}
            if setting.engine and (name not in self.examinations or known.get(name, "pending") == "pending"):
                self.runs.announce(self._task(setting))

    def follow(self, tell: Teller) -> None:
        """Follow and examine the runs that are not yet; nothing is timed."""
        for result in self.study.measure(self._settings(), 0, tell):
            self._examine(result, tell)  # what an interruption kept from it

    def time(self, repeats: int, tell: Teller) -> None:
        """Time each run so many times, in turns."""
        self.study.measure(self._settings(), repeats, tell)
        self._save()

    def _settings(self) -> list[Setting]:
        return [OWN, *(setting for engine in self.engines for setting in engine.examined(self.scene))]

    def _task(self, setting: Setting) -> Task:
        return Task(self.scene, setting, self._recording(setting), self.limit)

    def document(self) -> dict[str, Any]:
        """Return all results as one JSON document."""
        notes = {engine.name: engine.notes(self.scene) for engine in self.engines}
        reference = self.study.document()["reference"]
        runs = []
        for result in self.results:
            examined = self.examinations.get(result.setting.name)
            runs.append({**result_entry(result), **({} if examined is None else asdict(examined))})
        return {
            "version": VERSION,
            "units": self.scene.unit_system.recorded,
            "scene": {"title": self.scene.title, "bodies": self.scene.count, "toml": self.scene.toml},
            "reference": reference,
            "refused": self.refused,
            "notes": notes,
            "runs": runs,
        }

    def _follow(self, setting: Setting, times: FloatArray) -> Trajectory:
        """Return the samples of a setting of an engine, which is examined on the way."""
        followed = self.runs.result(self._task(setting))
        self._seen[setting.name] = followed.watched
        if followed.trajectory is None:
            raise ExperimentError(followed.reason)
        return followed.trajectory

    def _examine(self, result: Result, tell: Teller) -> None:
        """Examine a run that was followed, unless it has been, and save the result."""
        name = result.setting.name
        if name not in self.examinations:
            tell(f"{name}: laws")
            self.examinations[name] = self._examined(result)
            self._save()

    def _examined(self, result: Result) -> Examination:
        """Look at a run that is measured."""
        setting = result.setting
        if not setting.engine:
            return self._own(result)
        seen = self._seen.pop(setting.name, None) or self.runs.result(self._task(setting)).watched
        parting = self._parting(result, seen.broken, seen.dt)
        return examined_other(setting.name, self.scene, seen, parting, self._recording(setting))

    def _own(self, result: Result) -> Examination:
        """Run carom and record it."""
        try:
            outcome = simulate(recording_space(self.scene, self.threads), self._recording(OWN), force=True)
        except (PhysicsError, RecordingError) as error:
            raise ExperimentError(f"carom: {error}") from error
        broken = [(event.time, event.kind) for event in outcome.warnings]
        return examined_own(OWN.name, outcome, self._parting(result, broken, 0.0))

    def _recording(self, setting: Setting) -> Path:
        return self.folder / f"{_file_name(setting.name)}.rrd"

    def _parting(self, result: Result, broken: list[tuple[float, str]], dt: float) -> dict[str, Any] | None:
        """Compare a measured run with the reference."""
        reference = self.study.reference
        if reference is None or result.status != "measured":
            return None
        numbered = NumberedImpacts.of(self._recording(OWN))
        found = parting_of(self.study.trajectory(result), reference, broken, dt, self._names(), numbered)
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
