"""The conductor records the state of a run; a run whose report is lost is left to the next sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from carom.lab.sweep.manifest import FAILED, PENDING, Folder, Manifest
from carom.lab.sweep.plan import plan
from carom.lab.sweep.sweep import GONE, INTERRUPTED, Conductor
from carom.runs.environment import Interrupts
from carom.runs.workers import Ended, TaskDroppedError, WorkerDiedError
from sweep_runs import write_scene


class Processes:
    """Workers on which the first task is under way for ever, or all end with an error."""

    are_there = True

    def __init__(self, error: Exception | None) -> None:
        self.error = error
        self.sent: list[Any] = []
        self.dropped = False

    def send(self, function: Any, tasks: Any) -> None:
        self.sent = list(tasks)

    def ended(self, seconds: float) -> list[Ended]:
        return [Ended(key, error=self.error) for key in self.sent] if self.error else []

    def drop_waiting(self) -> list[Any]:
        return self.sent[1:]

    def drop(self) -> None:
        self.dropped = True


class Silent:
    def __init__(self) -> None:
        self.said: list[str] = []

    def say(self, text: str) -> None:
        self.said.append(text)

    def begin(self, found: int) -> None: ...
    def ended(self, run: Any) -> None: ...
    def tick(self) -> None: ...


def manifest_of(folder: Path) -> Manifest:
    return Manifest.begin(Folder(folder / "out"), plan(write_scene(folder), seeds=3), "carom sweep")


@pytest.mark.parametrize(
    ("error", "stopped", "outcome"),
    [
        (TaskDroppedError("the scheduler is gone"), GONE, (PENDING, "")),
        (ValueError("no such scene"), "", (FAILED, "error")),
        (WorkerDiedError("the workers died"), "", (FAILED, "lost")),
    ],
)
def test_a_run_that_raised_or_whose_workers_died_has_failed_and_one_whose_report_is_lost_has_not(
    error: Exception, stopped: str, outcome: tuple[str, str], tmp_path: Path
) -> None:
    manifest = manifest_of(tmp_path)
    assert Conductor(Processes(error), manifest, Silent()).conduct(manifest.todo, Interrupts()) == stopped
    assert {(run.status, run.outcome) for run in manifest.runs.values()} == {outcome}


def test_the_first_interrupt_waits_for_the_runs_under_way_and_the_second_drops_them(tmp_path: Path) -> None:
    manifest, processes, watch, interrupts = manifest_of(tmp_path), Processes(None), Silent(), Interrupts()
    waits: list[int] = []

    def ended(seconds: float) -> list[Ended]:
        waits.append(interrupts.count)
        interrupts.count = len(waits) // 2  # pressed while it waits for the second time, and for the fourth
        return []

    processes.ended = ended  # type: ignore[method-assign]
    assert Conductor(processes, manifest, watch).conduct(manifest.todo, interrupts) == INTERRUPTED
    assert waits == [0, 0, 1, 1] and processes.dropped
    assert [line for line in watch.said if "Waiting for 1 run in progress" in line]
    assert {run.status for run in manifest.runs.values()} == {PENDING}
