"""A small scene to sweep, and a Dask cluster of real processes to do it on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carom.recording.read.recording import Recording

SCENE = """
title = "Two spheres"
seed = 5
[time]
duration = 0.2
fixed_dt = 1e-3
[gravity]
constant = 0.0
[record]
every = 0.01
[[body]]
position = [-1.05, 0.0, 0.0]
velocity = [1.0, 0.0, 0.0]
[[body]]
position = [1.05, 0.3, 0.0]
velocity = [-1.0, 0.0, 0.0]
"""
SLOW = ("--set", "time.fixed_dt=4e-6", "--set", "time.duration=0.15")  # 37 500 steps: about a second a run


def write_scene(folder: Path) -> Path:
    path = folder / "spheres.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def manifest(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    return document


def done(folder: Path) -> int:
    """Count the runs that the manifest calls done, and hold it to what it says."""
    if not (folder / "manifest.json").exists():
        return 0
    finished = [run for run in manifest(folder)["runs"] if run["status"] == "done"]
    for run in finished:
        assert (folder / run["file"]).stat().st_size == run["size"]
    return len(finished)


def fingerprints(folder: Path) -> dict[str, str]:
    return {run["name"]: run["fingerprint"] for run in manifest(folder)["runs"]}


def assert_whole(folder: Path) -> None:
    """Every run is there once, whole, and as its manifest says."""
    runs = manifest(folder)["runs"]
    assert {run["outcome"] for run in runs} == {"completed"}
    assert sorted(path.name for path in (folder / "runs").iterdir()) == sorted(f"{run['name']}.rrd" for run in runs)
    assert not list((folder / "partial").iterdir())
    for run in runs:
        recording = Recording.open(folder / run["file"])
        assert recording.finished and recording.outcome == "completed"
        assert f"{recording.fingerprints()['fingerprint'][-1].as_py():016x}" == run["fingerprint"]
        assert recording.parameters["name"] == run["name"] and recording.parameters["seed"] == run["seed"]


@contextmanager
def started(*arguments: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """Start the command and let it run; kill it and its workers when the test is done with it, or has failed."""
    client = subprocess.Popen(
        [sys.executable, "-m", "carom", *arguments],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # as a shell does: its interrupt key reaches the whole group
    )
    try:
        yield client
    finally:
        with suppress(ProcessLookupError):
            os.killpg(client.pid, signal.SIGKILL)
        client.communicate()


def until(reached: Callable[[], bool], limit: float = 120.0) -> None:
    """Wait until a condition holds; fail if it never does."""
    end = time.monotonic() + limit
    while not reached():
        assert time.monotonic() < end, "it did not come to be"
        time.sleep(0.02)


@dataclass
class DaskCluster:
    """A scheduler and its workers, each a process of its own on the loopback interface."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def start_cluster(folder: Path, workers: int) -> DaskCluster:
    file = folder / "scheduler.json"
    where = ("--scheduler-file", str(file), "--host", "127.0.0.1", "--no-dashboard")
    scheduler = _dask(folder, "scheduler", *where, "--port", "0")
    until(file.exists)
    processes = [_dask(folder, "worker", *where, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
    return DaskCluster(json.loads(file.read_text(encoding="utf-8"))["address"], scheduler, processes)


def _dask(folder: Path, *arguments: str) -> subprocess.Popen[bytes]:
    with (folder / "dask.log").open("ab") as log:
        return subprocess.Popen([sys.executable, "-m", "dask", *arguments], cwd=folder, stdout=log, stderr=log)
