"""What is found by following a run step by step: criteria, broken laws, and where it leaves the reference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carom.lab.engines.watched import COMPLETED, Watched
from carom.recording.read.recording import Recording
from carom.runs.expectation import Verdict, judge
from carom.runs.json_numbers import finite
from carom.runs.run import Outcome
from carom.scene.schema import Scene


@dataclass(frozen=True, slots=True)
class Examination:
    """One run, looked at step by step."""

    name: str
    criteria: list[dict[str, Any]]  # of [expect]: name, bound, limit, measured, judged, met (None if not judged)
    laws: dict[str, dict[str, Any]]  # those broken: the first frame, and how many
    parting: dict[str, Any] | None  # see `Parting`; None if it stays with the reference as far as that is compared
    recording: str  # its file, in the folder
    energy: dict[str, float | None]  # changes over the energy scale; see `energy_changes`


def examined_own(name: str, outcome: Outcome, parting: dict[str, Any] | None) -> Examination:
    """Return what a run of carom shows; its warnings are the laws that it breaks."""
    warned = {event.kind: event for event in reversed(outcome.warnings)}
    laws = {
        kind: {"step": event.step, "time": event.time, "text": event.text.splitlines()[0], "frames": 1}
        for kind, event in warned.items()
    }
    criteria = [_entry(v) for v in outcome.verdicts]
    return Examination(name, criteria, laws, parting, outcome.path.name, energy_changes(outcome.path))


def examined_other(
    name: str, scene: Scene, seen: Watched, parting: dict[str, Any] | None, recording: Path
) -> Examination:
    """Return what a run of another engine shows. Criteria that only carom's own account can judge are left out."""
    whole, touched = seen.outcome == COMPLETED, math.isnan(seen.trajectory.energy_error)
    verdicts = judge(scene, seen.extremes, scene.time.duration if whole else seen.extremes.kinetic.time)
    laws = {
        fault.law: {"step": fault.step, "time": fault.time, "text": fault.text, "frames": seen.counts[fault.law]}
        for fault in seen.faults
    }
    criteria = [
        # a limit that a run kept until it ended early may be exceeded later; and what an engine's contacts take cannot
        # be separated from the error of its integrator, so that only a lower bound of that is measured
        _entry(v, judged=not v.met) if not whole or (v.name == "energy_error" and touched) else _entry(v)
        for v in verdicts
        if v.name != "contact_audit" and not v.name.startswith("warned_")
    ]
    return Examination(name, criteria, laws, parting, recording.name, energy_changes(recording))


def energy_changes(path: Path) -> dict[str, float | None]:
    """Return the changes of the energy in a recording, over the energy scale.

    ``change`` is that of the total. Of another engine ``in_contact`` is what changed while bodies touched, to contacts
    and by errors of the engine together, and ``without_contact`` the others, which are errors.
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
