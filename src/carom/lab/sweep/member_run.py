"""One run of a sweep, with the same bits in any worker process on any machine."""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carom import Recording, Scene
from carom.errors import PhysicsError, RecordingError, SceneError
from carom.extend import DataFiles, SweepMember, finite, recording_space, scene_from_text, simulate, versions
from carom.lab.sweep.manifest import DONE, FAILED, Folder, move
from carom.lab.sweep.plan import SEED, SweepPoint, digest

Report = dict[str, Any]  # fields of `SweepRun`

_WHOLE = ("completed", "expectation missed")
_NOT_RESULTS = ("scene", "outcome", "versions", "profile")  # of a recording's summary


@dataclass(frozen=True, slots=True)
class SweepTask:
    """The data for a worker; the scene is in the folder."""

    root: str  # the sweep's folder on the client
    scene: str  # digest of the scene's text
    version: str  # of carom
    command: str
    point: SweepPoint


def execute(task: SweepTask) -> Report:
    """Run a member, or find its recording; return a report, which contains any error."""
    began = time.perf_counter()
    folder = Folder(Path(task.root))
    try:
        report = _made(task, folder)
    except SceneError as error:
        report = _failure("refused", str(error))
    except PhysicsError as error:
        report = _failure("failed", str(error))
    except (OSError, RecordingError) as error:
        report = _failure("disk", str(error))
    except Exception as error:  # of one run: the others continue
        report = _failure("error", f"{type(error).__name__}: {error}")
    return {"wall_time": time.perf_counter() - began, **report, "worker": socket.gethostname()}


def unfit(root: str, scene: str, version: str) -> str:
    """Explain why this process cannot make the runs of a sweep; empty if it can."""
    ours = versions()["carom"]
    if ours != version:
        return f"has carom {ours}, but the sweep is of {version}; results depend on the version"
    path = Folder(Path(root)).scene
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        return f"cannot read {path} ({error.strerror}); the folder must be the same on all machines"
    return "" if digest(text) == scene else f"has a different {path}; the folder must be the same on all machines"


def _made(task: SweepTask, folder: Folder) -> Report:
    if why := unfit(task.root, task.scene, task.version):
        return _failure("error", f"this worker {why}")
    point = task.point
    text, files = folder.scene.read_text(encoding="utf-8"), DataFiles(folder.data)
    scene = scene_from_text(text, folder.scene.name, point.overrides, files)
    whole = folder.whole(point.name)
    found = _found(whole, scene)
    if found:
        return {**found, "file": str(whole.relative_to(folder.root))}
    member = SweepMember(point.name, _recordable({**point.parameters, SEED: point.seed}), task.command)
    attempt = folder.attempt(point.name)
    try:
        outcome = simulate(recording_space(scene, threads=1), attempt, member=member)
        if outcome.status in _WHOLE:
            return _kept(attempt, whole, folder)
        if outcome.status == "failed":  # keep the recording; other outcomes do not depend on the scene
            return _kept(attempt, folder.failed(point.name), folder)
        return _failure(outcome.status, outcome.reason)
    finally:
        attempt.unlink(missing_ok=True)


def _kept(attempt: Path, place: Path, folder: Folder) -> Report:
    """Rename a complete recording to its final name, and report its results."""
    report = _report(Recording.open(attempt))
    move(attempt, place)
    return {**report, "file": str(place.relative_to(folder.root))}


def _found(path: Path, scene: Scene) -> Report | None:
    """Return the report of a run made by an earlier attempt; its client may have died before it received the report."""
    if not path.exists():
        return None
    try:
        recording = Recording.open(path)
        report = _report(recording) if recording.finished and recording.scene_toml == scene.toml else None
    except RecordingError:
        return None
    return report if report and report["outcome"] in _WHOLE else None


def _report(recording: Recording) -> Report:
    outcome, _, reason = recording.outcome.partition(": ")
    last = recording.fingerprints()["fingerprint"][-1].as_py()
    return {
        "status": DONE if outcome in _WHOLE else FAILED,
        "outcome": outcome,
        "reason": reason,
        "wall_time": recording.closing["wall_time"],
        "fingerprint": f"{last:016x}",
        "size": recording.path.stat().st_size,
        "results": _results(recording.summary()),
    }


def _failure(outcome: str, reason: str) -> Report:
    return {"status": FAILED, "outcome": outcome, "reason": reason}


def _results(summary: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Return the numbers of a summary under dotted keys."""
    found: dict[str, Any] = {}
    for key, value in summary.items():
        if isinstance(value, Mapping):
            found |= {} if key in _NOT_RESULTS else _results(value, f"{above}{key}.")
        elif value is None or isinstance(value, (bool, int, float)):
            found[f"{above}{key}"] = finite(value)
    return found


def _recordable(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Convert values without a Rerun component to text."""
    kept = (bool, int, float, str)
    return {key: value if isinstance(value, kept) else str(value) for key, value in parameters.items()}
