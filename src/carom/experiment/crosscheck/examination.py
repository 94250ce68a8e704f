"""What is found by following a run step by step: criteria, broken laws, and where it leaves the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carom.experiment.engines.watched import COMPLETED, Watched
from carom.experiment.expectation import Verdict, judge
from carom.experiment.json_numbers import finite
from carom.experiment.run import Outcome
from carom.scene.schema import Scene


@dataclass(frozen=True, slots=True)
class Examination:
    """One run, looked at step by step."""

    name: str
    criteria: list[dict[str, Any]]  # of [expect]: name, bound, limit, measured, judged, met (None if not judged)
    laws: dict[str, dict[str, Any]]  # those broken: the first frame, and how many
    parting: dict[str, Any] | None  # see `Parting`; None if it stays with the reference as far as that is compared
    recording: str  # its file, in the folder


def examined_own(name: str, outcome: Outcome, parting: dict[str, Any] | None) -> Examination:
    """Return what a run of carom shows; its warnings are the laws that it breaks."""
    warned = {event.kind: event for event in reversed(outcome.warnings)}
    laws = {
        kind: {"step": event.step, "time": event.time, "text": event.text.splitlines()[0], "frames": 1}
        for kind, event in warned.items()
    }
    return Examination(name, [_entry(v) for v in outcome.verdicts], laws, parting, outcome.path.name)


def examined_other(
    name: str, scene: Scene, seen: Watched, parting: dict[str, Any] | None, recording: str
) -> Examination:
    """Return what a run of another engine shows. Criteria that only carom's own account can judge are left out."""
    whole, touched = seen.outcome == COMPLETED, seen.extremes.total_contacts > 0
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
    return Examination(name, criteria, laws, parting, recording)


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
