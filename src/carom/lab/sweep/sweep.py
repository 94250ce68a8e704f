"""A sweep from its plan to its table."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from carom.errors import ExperimentError
from carom.lab.sweep import table
from carom.lab.sweep.conductor import Conductor, Watcher
from carom.lab.sweep.folder import Folder
from carom.lab.sweep.manifest import FAILED, PENDING, Manifest, Run, read
from carom.lab.sweep.plan import Plan, Point
from carom.physics.parallel.cores import cores
from carom.runs.environment import versions
from carom.runs.interrupts import Interrupts
from carom.runs.output import output_folder
from carom.runs.workers import LocalWorkers, Workers


@dataclass(frozen=True, slots=True)
class Ending:
    """How a sweep ended."""

    manifest: Manifest
    found: int  # runs that already existed
    stopped: str  # why it ended early; empty if it did not
    untabled: str = ""  # why the table could not be written

    @property
    def failed(self) -> list[Run]:
        """The runs that did not complete."""
        return [run for run in self.manifest.asked if run.status == FAILED]

    @property
    def missed(self) -> list[Run]:
        """The runs that completed and missed a promise of their scene."""
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
) -> Ending:
    """Make all missing runs of a plan.

    Parameters
    ----------
    plan
        From `carom.lab.sweep.plan.plan`.
    root
        The folder of the sweep; the same on all machines that compute.
    watch
        Receives the progress.
    address
        A Dask scheduler, such as ``tcp://10.0.0.1:8786``; None for processes on this machine.
    workers
        Number of these processes; by default one per core.
    force
        Whether to remove an existing sweep in the folder instead of continuing it.
    command
        The command line, for the recordings.

    Raises
    ------
    ExperimentError
        If the folder holds another sweep, or the cluster cannot be used.
    OSError
        If the manifest cannot be written.
    """
    folder = Folder(root.resolve())
    output_folder(folder.root)
    with folder.claimed(), _nothing_left_of_a_mistake(folder):
        folder.refuse_links()
        if force and folder.manifest.exists():
            stored = read(folder)
            folder.clear([run["name"] for run in stored["runs"]], stored["files"])
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
            path = error.filename or folder.table
            untabled = f"{path}: cannot be written: {error.strerror}; the same command writes it again"
    return Ending(manifest, found, stopped, untabled)


@contextlib.contextmanager
def _nothing_left_of_a_mistake(folder: Folder) -> Iterator[None]:
    """Remove a new folder if its sweep cannot begin, for example since no cluster is at the address."""
    fresh = folder.is_fresh
    try:
        yield
    except ExperimentError:
        if fresh:
            if folder.manifest.exists():
                stored = read(folder)
                folder.clear([run["name"] for run in stored["runs"]], stored["files"])
            folder.leave()
        raise


def _make(manifest: Manifest, todo: list[Point], watch: Watcher, address: str | None, workers: int | None) -> str:
    with contextlib.ExitStack() as stack:
        made: Workers
        if address is None:
            made = stack.enter_context(LocalWorkers(min(workers or cores(), len(todo))))
        else:
            from carom.lab.sweep.cluster import DaskWorkers  # noqa: PLC0415 - an extra

            made = cluster = stack.enter_context(DaskWorkers(address))
            cluster.refuse_unfit(str(manifest.folder.root), manifest.plan.digest, versions()["carom"])
        interrupts = stack.enter_context(Interrupts(patience=2))
        return Conductor(made, manifest, watch).conduct(todo, interrupts)
