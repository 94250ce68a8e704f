"""One run of a sweep, as a worker makes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from carom.lab.sweep import sweep as made
from carom.lab.sweep.manifest import Folder, put
from carom.lab.sweep.plan import plan
from carom.lab.sweep.sweep import SweepTask, execute
from carom.recording.read.recording import Recording
from carom.runs.environment import versions
from sweep_runs import write_scene


def task_in(folder: Path, *overrides: str) -> tuple[SweepTask, Folder]:
    planned = plan(write_scene(folder), list(overrides), seeds=1)
    place = Folder(folder / "out")
    place.make()
    put(place.scene, planned.scene)
    return SweepTask(str(place.root), planned.digest, versions()["carom"], "carom sweep", planned.points[0]), place


def test_a_run_that_was_made_is_found_and_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task, folder = task_in(tmp_path)
    first = execute(task)
    assert first["status"] == "done" and not list(folder.partial.iterdir())
    monkeypatch.delattr(made, "simulate")
    assert execute(task) == first


@pytest.mark.parametrize("spoil", ["cut", "another scene"])
def test_a_file_in_its_place_that_is_not_the_run_is_replaced(tmp_path: Path, spoil: str) -> None:
    task, folder = task_in(tmp_path)
    first = execute(task)
    path = folder.whole(task.point.name)
    if spoil == "cut":
        path.write_bytes(path.read_bytes()[:-3000])
    else:
        other, _ = task_in(tmp_path, "contact.restitution=0.9")
        path.unlink()
        assert execute(other)["fingerprint"] != first["fingerprint"]
        task_in(tmp_path)
    assert execute(task)["fingerprint"] == first["fingerprint"]


def test_a_run_that_fails_keeps_what_it_recorded_apart_from_the_whole_ones(tmp_path: Path) -> None:
    task, folder = task_in(tmp_path, "gravity.constant=1e90", "body.0.mass=1e99", "body.1.mass=1e99")
    report = execute(task)
    assert report["status"] == report["outcome"] == "failed" and "no longer finite" in report["reason"]
    assert Recording.open(folder.root / report["file"]).frames > 0 and report["file"].startswith("failed/")
    assert not list((folder.root / "runs").iterdir()) and not list(folder.partial.iterdir())


def test_a_missed_promise_is_a_whole_run(tmp_path: Path) -> None:
    task, folder = task_in(tmp_path, "expect.impacts=9")
    report = execute(task)
    assert report["status"] == "done" and report["outcome"] == "expectation missed" and "impacts" in report["reason"]
    assert folder.whole(task.point.name).exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": "0.0.1"}, "results depend on the version"),
        ({"root": "/nowhere"}, "must be the same on all machines"),
        ({"scene": "0" * 64}, "has a different"),
    ],
)
def test_a_worker_that_does_not_fit_says_why(tmp_path: Path, change: dict[str, str], said: str) -> None:
    task, _ = task_in(tmp_path)
    report = execute(replace(task, **change))  # type: ignore[arg-type]
    assert report["outcome"] == "error" and said in report["reason"]


def test_whatever_goes_wrong_with_a_run_is_in_its_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task, folder = task_in(tmp_path)
    monkeypatch.setattr(made, "simulate", lambda *_, **__: 1 / 0)
    report = execute(task)
    assert report["outcome"] == "error" and "ZeroDivisionError" in report["reason"]
    assert not list(folder.partial.iterdir())
