"""A sweep from its plan to its table: workers make the runs, and their reports go into the manifest.

A run has the same bits in any worker process on any machine.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from carom import registry
from carom.errors import ExperimentError, PhysicsError, RecordingError, SceneError, status_of
from carom.lab.sweep import sweep_table as table
from carom.lab.sweep.manifest import DONE, FAILED, PENDING, Folder, Manifest, SweepRun, clear, move
from carom.lab.sweep.plan import SEED, Plan, SweepPoint, digest
from carom.physics.jit import cores
from carom.recording.read.recording import Recording
from carom.recording.schema.header import SweepMember
from carom.recording.write.whole_file import output_folder
from carom.registry import ExtensionError
from carom.runs.environment import Interrupts, versions
from carom.runs.run import recording_space, simulate
from carom.runs.workers import Ended, LocalWorkers, TaskDroppedError, WorkerDiedError, Workers
from carom.scene.data.body_sources import DataFiles
from carom.scene.load import scene_from_text
from carom.scene.wording import counted
from carom.terminal.printing import finite

Report = dict[str, Any]  # fields of `SweepRun`

_WHOLE = ("completed", "expectation missed")  # outcomes of complete runs
_NOT_RESULTS = ("scene", "outcome", "versions", "profile")  # sections of a recording's summary that are not results
INTERRUPTED = "interrupted"
GONE = "the scheduler is gone, or has dropped runs"
_TICK = 0.2  # s between two updates of a running sweep


@dataclass(frozen=True, slots=True)
class SweepTask:
    """The data that a worker needs besides the scene, which is in the folder."""

    root: str  # the sweep's folder on the client
    scene: str  # digest of the scene's text
    version: str  # version of carom
    command: str
    point: SweepPoint


def execute(task: SweepTask) -> Report:
    """Make a run of a sweep, or find its recording; return a report, which contains any error."""
    began = time.perf_counter()
    folder = Folder(Path(task.root))
    try:
        report = _made(task, folder)
    except SceneError as error:
        report = _failure("refused", str(error))
    except PhysicsError as error:
        report = _failure("failed", str(error))
    except RecordingError as error:
        report = _failure(status_of(error), str(error))
    except OSError as error:
        report = _failure("disk", str(error))
    except Exception as error:  # the other runs continue after an error of one run
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
    # an earlier attempt may have made this run, if its client died before it received the report
    with contextlib.suppress(RecordingError):
        recording = Recording.open(whole) if whole.exists() else None
        if recording and recording.finished and recording.scene_toml == scene.toml:
            found = _report(recording)
            if found["outcome"] in _WHOLE:
                return {**found, "file": str(whole.relative_to(folder.root))}
    # values without a Rerun component become text
    parameters = {**point.parameters, SEED: point.seed}
    kept = {k: value if isinstance(value, bool | int | float | str) else str(value) for k, value in parameters.items()}
    member = SweepMember(point.name, kept, task.command)
    attempt = folder.attempt(point.name)
    try:
        outcome = simulate(recording_space(scene, threads=1), attempt, member=member)
        if outcome.status in _WHOLE:
            return _kept(attempt, whole, folder)
        if outcome.status == "failed":  # the run failed for a reason in the scene, so its recording is worth keeping
            return _kept(attempt, folder.failed(point.name), folder)
        return _failure(outcome.status, outcome.reason)
    finally:
        attempt.unlink(missing_ok=True)


def _kept(attempt: Path, place: Path, folder: Folder) -> Report:
    """Rename a complete recording to its final name, and report its results."""
    report = _report(Recording.open(attempt))
    move(attempt, place)
    return {**report, "file": str(place.relative_to(folder.root))}


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
        "results": _results(recording.summary()) | _granular(recording),
    }


def _granular(recording: Recording) -> dict[str, float]:
    """Return the granular temperature and the stress of the second half of a run, if the recording has them."""
    try:
        late_means = registry.imported("carom.lab.statistics.late_means:late_means")
    except ExtensionError:  # the statistics, a removable part of carom, are missing
        return {}
    try:
        return {key: finite(value) for key, value in late_means(recording).items()}
    except RecordingError:  # the states of a failed run may not be finite
        return {}


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


class Watcher(Protocol):
    """Receives the progress of a sweep."""

    def say(self, text: str) -> None:
        """Receive a message that concerns all runs."""

    def begin(self, found: int) -> None:
        """Receive the number of runs that already exist."""

    def ended(self, run: SweepRun) -> None:
        """Receive a run that ended."""

    def tick(self) -> None:
        """Update the display; called a few times a second."""


class Conductor:
    """Makes runs on workers."""

    def __init__(self, workers: Workers, manifest: Manifest, watch: Watcher) -> None:
        self._workers = workers
        self._manifest = manifest
        self._watch = watch
        self._left: set[str] = set()  # names of the runs that have not ended
        self._dropped = 0  # number of runs that the scheduler dropped, or whose report it lost
        self._unsaved = ""  # the error that kept the manifest from being written; empty if there was none

    def conduct(self, points: list[SweepPoint], interrupts: Interrupts) -> str:
        """Make the runs; return why the sweep ended early, or an empty text.

        The first interrupt lets current runs finish, the second drops them. Raises OSError if the final manifest could
        not be written.
        """
        plan, folder, version = self._manifest.plan, self._manifest.folder, versions()["carom"]
        self._left = {point.name for point in points}
        root, command = str(folder.root), self._manifest.command
        self._workers.send(
            execute, {point.name: SweepTask(root, plan.digest, version, command, point) for point in points}
        )
        stopping = False
        while self._left and interrupts.count < 2:
            entered = [self._enter(ended) for ended in self._workers.ended(_TICK)]
            if any(entered):
                # keeps an error for later, since a full disk may have space again
                try:
                    self._manifest.save()
                    self._unsaved = ""
                except OSError as error:
                    if not self._unsaved:
                        self._watch.say(f"{self._manifest.folder.manifest} cannot be written: {error.strerror}")
                    self._unsaved = str(error)
            self._watch.tick()
            if not self._workers.are_there:
                break
            if interrupts.count and not stopping:
                stopping = True
                self._left.difference_update(self._workers.drop_waiting())
                left = counted(len(self._left), "run")
                self._watch.say(f"Interrupted. Waiting for {left} in progress; interrupt again to drop them.")
        stopped = INTERRUPTED if interrupts.count else GONE if self._left or self._dropped else ""
        self._workers.drop()
        if self._unsaved:
            self._manifest.save()
        return stopped

    def _enter(self, ended: Ended) -> bool:
        """Enter one run; return whether it has ended."""
        self._left.discard(ended.key)
        if isinstance(ended.error, TaskDroppedError):
            self._dropped += 1
            return False
        report: Report = ended.value
        if isinstance(ended.error, WorkerDiedError):
            report = _failure("lost", str(ended.error))
        elif ended.error is not None:
            report = _failure("error", f"{type(ended.error).__name__}: {ended.error}")
        self._watch.ended(self._manifest.enter(ended.key, report))
        return True


@dataclass(frozen=True, slots=True)
class SweepEnding:
    """The result of a sweep."""

    manifest: Manifest
    found: int  # number of runs that already existed
    stopped: str  # the reason for an early end; empty if there was none
    untabled: str = ""  # why the table could not be written; empty if it was written

    @property
    def failed(self) -> list[SweepRun]:
        """The runs that did not complete."""
        return [run for run in self.manifest.asked if run.status == FAILED]

    @property
    def missed(self) -> list[SweepRun]:
        """The completed runs that missed a promise of their scene."""
        return [run for run in self.manifest.asked if run.status not in (FAILED, PENDING) and not run.ok]

    @property
    def left(self) -> int:
        """The number of runs that have not been made."""
        return sum(run.status == PENDING for run in self.manifest.asked)

    @property
    def ok(self) -> bool:
        """Whether every run completed and kept its promises, and the table was written."""
        return not self.untabled and all(run.ok for run in self.manifest.asked)


def sweep(
    plan: Plan,
    root: Path,
    watch: Watcher,
    *,
    address: str | None = None,
    workers: int | None = None,
    force: bool = False,
    command: str = "",
) -> SweepEnding:
    """Make all missing runs of a plan.

    The runs are made by the Dask scheduler at an address, such as ``tcp://10.0.0.1:8786``, or by processes on this
    machine: as many as ``workers``, by default one per core. All machines must have the folder ``root`` under the same
    path. With ``force``, an existing sweep in the folder is removed instead of continued. Recordings contain the
    ``command`` line. Raises ExperimentError if the folder holds another sweep or the cluster cannot be used, and
    OSError if the manifest cannot be written.
    """
    folder = Folder(root.resolve())
    output_folder(folder.root)
    with folder.claimed(), _removed_if_refused(folder):
        folder.refuse_links()
        if force and folder.manifest.exists():
            clear(folder)
        manifest = Manifest.begin(folder, plan, command)
        todo = manifest.todo
        folder.clear_partial(manifest.runs)
        manifest.reset(todo)
        manifest.hold_room()
        manifest.save()
        found = len(plan.points) - len(todo)
        watch.begin(found)
        stopped = _make(manifest, todo, watch, address, workers) if todo else ""
        folder.clear_partial(manifest.runs)
        manifest.save()
        untabled = ""
        try:
            manifest.list_tables()
            table.write(folder, list(manifest.runs.values()))
        except OSError as error:
            path = error.filename or folder.tables[0]
            untabled = f"{path}: cannot be written: {error.strerror}; the same command writes it again"
    return SweepEnding(manifest, found, stopped, untabled)


@contextlib.contextmanager
def _removed_if_refused(folder: Folder) -> Iterator[None]:
    """Remove a new folder if its sweep cannot begin, for example without a cluster at the address."""
    fresh = folder.is_fresh
    try:
        yield
    except ExperimentError:
        if fresh:
            if folder.manifest.exists():
                clear(folder)
            folder.leave()
        raise


def _make(manifest: Manifest, todo: list[SweepPoint], watch: Watcher, address: str | None, workers: int | None) -> str:
    with contextlib.ExitStack() as stack:
        made: Workers
        if address is None:
            made = stack.enter_context(LocalWorkers(min(workers or cores(), len(todo))))
        else:
            from carom.lab.sweep.cluster import DaskWorkers  # noqa: PLC0415 - an extra

            made = cluster = stack.enter_context(DaskWorkers(address))
            cluster.refuse_unfit(partial(unfit, str(manifest.folder.root), manifest.plan.digest, versions()["carom"]))
        interrupts = stack.enter_context(Interrupts(patience=2))
        return Conductor(made, manifest, watch).conduct(todo, interrupts)
