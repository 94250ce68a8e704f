"""Results and references as entries of the document ``tradeoff.json``, written and read."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from carom.lab.tradeoff.error_measures import NAMES, Errors
from carom.lab.tradeoff.reference import Reference, scale_of
from carom.lab.tradeoff.result import Result
from carom.lab.tradeoff.settings_grid import Setting
from carom.lab.tradeoff.trajectory import Trajectory
from carom.runs.json_numbers import finite
from carom.scene.schema import Scene


def result_entry(result: Result) -> dict[str, Any]:
    """Return the results of one setting."""
    return {
        "name": result.setting.name,
        "overrides": list(result.setting.overrides),
        "threads": result.setting.threads,
        "engine": result.setting.engine,
        "status": result.status,
        "reason": result.reason,
        "steps": result.steps,
        "frames": result.frames,
        "costs": result.costs,
        "spent": result.spent,
        "cost": finite(result.cost),
        "spread": result.spread,
        "errors": result.errors and finite(asdict(result.errors)),
    }


def result_of(entry: dict[str, Any]) -> Result:
    """Read the results of one setting, without its errors."""
    overrides = tuple(entry["overrides"])
    setting = Setting(entry["name"], overrides, entry.get("threads"), entry.get("engine", ""))
    result = Result(setting, entry["status"], entry["reason"], entry["costs"], entry["steps"], entry["frames"])
    result.spent = entry.get("spent", 0.0)
    return result


def reference_entry(reference: Reference) -> dict[str, Any]:
    """Return a reference without its trajectory."""
    return {
        "kind": reference.kind,
        "text": reference.text,
        "fineness": finite(reference.fineness),
        "samples": reference.samples,
        "horizon": reference.horizon,
        "duration": float(reference.trajectory.time[-1]),
        "whole": reference.whole,
        "complete": reference.is_complete,
        "uncertainty": finite(asdict(reference.uncertainty)),
    }


def reference_of(entry: dict[str, Any], scene: Scene, trajectory: Trajectory) -> Reference:
    """Read a reference; its trajectory is given."""
    return Reference(
        trajectory,
        scale_of(scene, trajectory),
        entry["kind"],
        math.inf if entry["fineness"] is None else entry["fineness"],
        entry["samples"],
        entry["whole"],
        Errors(**{e: math.nan if entry["uncertainty"][e] is None else entry["uncertainty"][e] for e in NAMES}),
        entry["text"],
    )
