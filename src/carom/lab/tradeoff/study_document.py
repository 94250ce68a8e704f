"""The files of a study: ``tradeoff.json``, a trajectory for each setting, and the trajectory of the reference."""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from carom.errors import ExperimentError
from carom.lab.compared_run import Setting, Trajectory
from carom.lab.tradeoff.reference import NAMES, Errors, Reference, scale_of
from carom.lab.tradeoff.settings_grid import SettingResult
from carom.lab.tradeoff.settled_pile import Pile
from carom.scene.load import Scene
from carom.terminal.printing import finite

DOCUMENT = "tradeoff.json"
REFERENCE = "reference.npz"
VERSION = 7  # version of the document


def trajectory_path(folder: Path, setting: Setting) -> Path:
    """Return the file of a setting's trajectory."""
    threads = [f"threads={setting.threads}"] if setting.threads else []
    engine = [f"engine={setting.engine}"] if setting.engine else []
    name = hashlib.sha256("\n".join([*setting.overrides, *threads, *engine]).encode()).hexdigest()[:12]
    return folder / f"{name}.npz"


def read_document(folder: Path, scene: Scene, advice: str) -> tuple[Reference | None, list[SettingResult], float]:
    """Read the study of a scene: its reference, its settings, and the largest load of the machine.

    Raises
    ------
    ExperimentError
        With advice, if the folder contains a study of another scene, or a study that cannot be read.
    """
    path = folder / DOCUMENT
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        theirs, known = kept["scene"]["toml"], kept["reference"]
        if kept["version"] == VERSION and theirs == scene.toml:
            reference = None
            if known is not None:
                reference = reference_of(known, scene, Trajectory.load(folder / REFERENCE))
            results = [result_of(entry) for entry in kept["settings"]]
            by_name = {result.setting.name: result for result in results}
            for result in results:
                if result.status == "measured" and reference is not None:
                    result.errors = reference.errors(Trajectory.load(trajectory_path(folder, result.setting)))
                # another version of carom may be able to run the setting
                elif result.status in ("refused", "measured", "left out"):
                    result.status = "pending"
                if result.same_as:
                    result.share_costs_of(by_name[result.same_as])
            return reference, results, kept.get("load", 0.0)
        if kept["version"] != VERSION and theirs == scene.toml:
            raise ValueError("another version of carom measured it")
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise ExperimentError(f"{path}: cannot be resumed ({error}); {advice}") from None
    raise ExperimentError(f"{folder}: holds a study of another scene or of an earlier version of this scene; {advice}")


def result_entry(result: SettingResult) -> dict[str, Any]:
    """Return the results of one setting."""
    return {
        "name": result.setting.name,
        "overrides": list(result.setting.overrides),
        "threads": result.setting.threads,
        "engine": result.setting.engine,
        "status": result.status,
        "reason": result.reason,
        "same_as": result.same_as,
        "steps": result.steps,
        "frames": result.frames,
        "costs": result.costs,
        "spent": result.spent,
        "cost": finite(result.cost),
        "spread": result.spread,
        "digest": result.digest,
        "errors": result.errors and finite(asdict(result.errors)),
    }


def result_of(entry: dict[str, Any]) -> SettingResult:
    """Read the results of one setting, without its errors."""
    setting = Setting(entry["name"], tuple(entry["overrides"]), entry.get("threads"), entry.get("engine", ""))
    kept = {key: entry[key] for key in ("status", "reason", "costs", "steps", "frames")}
    known = {"spent": entry.get("spent", 0.0), "digest": entry.get("digest", "")}
    return SettingResult(setting, **kept, **known, same_as=entry["same_as"])


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
    """Read a reference from its entry and its trajectory."""
    return Reference(
        trajectory,
        scale_of(scene, trajectory),
        entry["kind"],
        math.inf if entry["fineness"] is None else entry["fineness"],
        entry["samples"],
        entry["whole"],
        Errors(**{e: math.nan if entry["uncertainty"][e] is None else entry["uncertainty"][e] for e in NAMES}),
        entry["text"],
        Pile.of(scene) if entry["uncertainty"]["height"] is not None else None,
    )
