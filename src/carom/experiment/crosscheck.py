"""Runs a scene in other engines, and says where each parts from the reference and which law it breaks there.

`Study` measures errors and costs, in turns. Each run is then examined: the audit of `carom.record` follows it step by
step, its criteria are those of the scene's [expect], and it is recorded.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from carom.experiment.engines.engine import Engine
from carom.experiment.engines.watched import watch
from carom.experiment.error import ExperimentError
from carom.experiment.expectation import Verdict, judge
from carom.experiment.run import recording_space, simulate
from carom.experiment.whole_file import write_whole
from carom.experiment.work_precision.reference import Reference
from carom.experiment.work_precision.settings_grid import Setting
from carom.experiment.work_precision.tradeoff import Result, Study
from carom.experiment.work_precision.trajectory import Trajectory
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
PARTED = 0.01  # of the size of the system; runs farther apart have parted
EARLIER = 2.0  # steps, by which an engine may see an impact before the reference does
LATER = 40.0  # steps after it, in which a soft contact ends

Teller = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Parting:
    """Where a run leaves the reference."""

    time: float  # s, of the first sample that is too far away
    impact: int  # the number of the last pair that met before, from 1 on; 0 if none had
    between: str  # its names
    impact_time: float  # s
    laws: list[str]  # that were broken from that impact on


@dataclass(frozen=True, slots=True)
class Examination:
    """One run, looked at step by step."""

    name: str
    criteria: list[dict[str, Any]]  # of [expect]: name, bound, limit, measured, met
    laws: dict[str, dict[str, Any]]  # those broken: the first frame, and how many
    parting: dict[str, Any] | None  # see `Parting`; None if it stays with the reference up to the horizon
    recording: str  # its file, in the folder


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
    refused: dict[str, str] = field(default_factory=dict)  # engine → why it cannot run the scene
    examinations: dict[str, Examination] = field(default_factory=dict)  # by the names of the settings

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
        by_name = {engine.name: engine for engine in self.engines}
        for result in self.results:
            name = result.setting.name
            if name in self.examinations:
                continue
            tell(f"{name}: laws")
            engine = by_name.get(result.setting.engine)
            self.examinations[name] = self._own(result) if engine is None else self._other(result, engine)
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

    def _own(self, result: Result) -> Examination:
        """Run carom and record it."""
        path = self.folder / "carom.rrd"
        try:
            outcome = simulate(recording_space(self.scene, self.threads), path, force=True)
        except (PhysicsError, RecordingError) as error:
            raise ExperimentError(f"carom: {error}") from error
        warned = {event.kind: event for event in reversed(outcome.warnings)}
        laws = {
            kind: {"step": event.step, "time": event.time, "text": event.text.splitlines()[0], "frames": 1}
            for kind, event in warned.items()
        }
        broken = [(event.time, event.kind) for event in outcome.warnings]
        return Examination(
            OWN.name, [_entry(v) for v in outcome.verdicts], laws, self._parting(result, broken, 0.0), path.name
        )

    def _other(self, result: Result, engine: Engine) -> Examination:
        """Follow another engine step by step, and record it."""
        setting = result.setting
        path = self.folder / f"{_file_name(setting.name)}.rrd"
        reference = self.study.reference
        assert reference is not None, "it is measured first"
        simulation = engine.begin(self.scene, setting)
        seen = watch(simulation, self.scene, reference.trajectory.time, path)
        verdicts = judge(self.scene, seen.extremes, self.scene.time.duration)
        laws = {
            fault.law: {
                "step": fault.step,
                "time": fault.time,
                "text": fault.text,
                "frames": seen.counts[fault.law],
            }
            for fault in seen.faults
        }
        criteria = [_entry(v) for v in verdicts if v.name != "contact_audit" and not v.name.startswith("warned_")]
        parting = self._parting(result, seen.broken, simulation.dt)
        return Examination(setting.name, criteria, laws, parting, path.name)

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


def parting_of(
    run: Trajectory, reference: Reference, broken: list[tuple[float, str]], dt: float, names: Names
) -> Parting | None:
    """Find where a run leaves a reference.

    Parameters
    ----------
    run
        The run.
    reference
        Its samples up to the horizon are compared.
    broken
        Times in s and laws of the frames that broke one, in order.
    dt
        s, the step of the run.
    names
        Of bodies and planes.

    Returns
    -------
    parting
        None if the run stays with the reference.
    """
    best = reference.trajectory.until(reference.samples)
    apart, _ = reference.scale.apart(run.until(reference.samples), best)
    away = np.flatnonzero(~(apart <= PARTED))
    if len(away) == 0 and len(run) >= reference.samples:
        return None
    time = float(best.time[away[0]]) if len(away) else float(run.time[-1])
    earlier = [k for k in np.argsort(best.met, kind="stable").tolist() if best.met[k] <= time]
    last = earlier[-1] if earlier else None
    met = float(best.met[last]) if last is not None else 0.0
    laws = dict.fromkeys(law for at, law in broken if met - EARLIER * dt <= at <= max(time, met + LATER * dt))
    return Parting(
        time=time,
        impact=len(earlier),
        between=names.pair(best.pair[last].tolist()) if last is not None else "",
        impact_time=met,
        laws=list(laws),
    )


def _entry(verdict: Verdict) -> dict[str, Any]:
    measured = verdict.measured if math.isfinite(verdict.measured) else None
    return {
        "name": verdict.name,
        "bound": verdict.bound,
        "limit": verdict.limit,
        "measured": measured,
        "met": verdict.met,
    }


def _file_name(name: str) -> str:
    """Make a name of a file of the name of a setting."""
    kept = "".join(letter if letter.isalnum() or letter == "." else "-" for letter in name)
    return "-".join(part for part in kept.split("-") if part)
