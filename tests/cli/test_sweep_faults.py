"""`carom sweep` when things go wrong, each for real: no finished run is lost, and the manifest says what happened."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from carom.runs.environment import SAME_PRESS
from carom_command import carom_process
from sweep_runs import (
    SLOW,
    DaskCluster,
    assert_whole,
    done,
    fingerprints,
    manifest,
    start_cluster,
    started,
    until,
    write_scene,
)

VARY = ("--vary", "contact.restitution=0.1:0.9:3", "--seeds", "3")
RUNS = 9


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    started = start_cluster(tmp_path_factory.mktemp("dask"), 3)
    yield started
    started.end()


def sweep_on(cluster: DaskCluster, folder: str) -> list[str]:
    return ["sweep", "spheres.toml", *VARY, *SLOW, "-o", folder, "--json", "--cluster", cluster.address]


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.needs("distributed")
def test_a_killed_worker_and_a_killed_client_lose_no_run(tmp_path: Path, cluster: DaskCluster) -> None:
    write_scene(tmp_path)
    undisturbed, disturbed = tmp_path / "undisturbed", tmp_path / "disturbed"
    assert carom_process(*sweep_on(cluster, "undisturbed"), cwd=tmp_path).returncode == 0
    with started(*sweep_on(cluster, "disturbed"), cwd=tmp_path) as client:
        until(lambda: done(disturbed) >= 1)
        cluster.workers[0].kill()
        until(lambda: done(disturbed) >= 4)
        client.kill()
        client.communicate()
        before = done(disturbed)
        assert 4 <= before < RUNS
    again = carom_process(*sweep_on(cluster, "disturbed"), cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    ending = json.loads(again.stdout)
    assert ending["found"] == before and ending["left"] == 0 and len(ending["entries"]) == RUNS
    assert_whole(undisturbed)
    assert_whole(disturbed)
    assert fingerprints(disturbed) == fingerprints(undisturbed)


@pytest.mark.slow
@pytest.mark.needs("distributed")
def test_a_scheduler_that_dies_leaves_the_rest_for_the_next_time(tmp_path: Path, cluster: DaskCluster) -> None:
    write_scene(tmp_path)
    with started(*sweep_on(cluster, "out"), cwd=tmp_path) as client:
        until(lambda: done(tmp_path / "out") >= 2)
        cluster.scheduler.kill()
        stdout, stderr = client.communicate(timeout=120)
    assert client.returncode == 1 and "Traceback" not in stderr, stderr
    ending = json.loads(stdout)
    assert "the scheduler is gone" in ending["stopped"] and ending["left"] > 0
    assert ending["left"] + done(tmp_path / "out") == RUNS


@pytest.mark.nightly
@pytest.mark.slow
def test_local_workers_that_are_killed_are_replaced_and_end_with_a_killed_client(tmp_path: Path) -> None:
    write_scene(tmp_path)
    out = tmp_path / "out"
    with started("sweep", "spheres.toml", *VARY, *SLOW, "--workers", "2", "-o", "out", cwd=tmp_path) as client:
        until(lambda: done(out) >= 1)
        os.kill(children_of(client.pid)[0], signal.SIGKILL)
        until(lambda: done(out) >= 4)
        orphans = children_of(client.pid)
        assert len(orphans) >= 2
        client.kill()
        client.communicate()
        until(lambda: not any(map(is_running, orphans)))
        before = done(out)
    again = carom_process("sweep", "spheres.toml", *VARY, *SLOW, "--workers", "2", "-o", "out", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert f"{RUNS} of {RUNS} runs done, {before} of them before" in again.stdout
    assert_whole(out)


@pytest.mark.slow
def test_the_interrupt_key_lets_the_runs_under_way_finish(tmp_path: Path) -> None:
    write_scene(tmp_path)
    out = tmp_path / "out"
    command = ("sweep", "spheres.toml", *VARY, *SLOW, "--workers", "2", "-o", "out")
    with started(*command, cwd=tmp_path) as client:
        until(lambda: done(out) >= 2 and len(list((out / "partial").iterdir())) == 2)
        os.killpg(client.pid, signal.SIGINT)  # workers get it, too
        _, stderr = client.communicate(timeout=120)
    assert client.returncode == 1 and "Traceback" not in stderr, stderr
    waited = re.search(r"Waiting for ([12]) runs? in progress", stderr)  # one, if a worker is between two runs
    assert waited and "run the same command again to continue" in stderr, stderr
    assert 2 + int(waited[1]) <= done(out) < RUNS
    assert {run["status"] for run in manifest(out)["runs"]} == {"done", "pending"}
    assert carom_process(*command, cwd=tmp_path).returncode == 0
    assert_whole(out)


@pytest.mark.slow
def test_the_interrupt_key_twice_ends_at_once(tmp_path: Path) -> None:
    write_scene(tmp_path)
    out = tmp_path / "out"
    endless = ("--set", "time.fixed_dt=1e-9")
    with started(
        "sweep", "spheres.toml", "--seeds", "3", *endless, "--workers", "2", "-o", "out", cwd=tmp_path
    ) as client:
        until(lambda: (out / "partial").exists() and len(list((out / "partial").iterdir())) >= 2)
        os.killpg(client.pid, signal.SIGINT)
        assert client.stderr is not None
        while "Waiting for" not in client.stderr.readline():
            assert client.poll() is None
        time.sleep(2 * SAME_PRESS)  # an earlier signal is the same press, forwarded by a wrapper
        os.killpg(client.pid, signal.SIGINT)
        _, stderr = client.communicate(timeout=60)
    assert client.returncode == 1 and "Traceback" not in stderr, stderr
    assert [run["status"] for run in manifest(out)["runs"]] == ["pending"] * 3
    assert not list((out / "partial").iterdir())


def durations(longest: float) -> tuple[str, ...]:
    """Vary the duration; each second has 1000 frames, 0.75 MB."""
    return "--vary", f"time.duration=0.1,0.2,{longest}", "--set", "record.every=step"


def assert_the_small_ones_are_there(folder: Path, ended: subprocess.CompletedProcess[str], longest: float) -> None:
    assert ended.returncode == 1 and "Traceback" not in ended.stderr, ended.stderr
    runs = {run["parameters"]["time.duration"]: run for run in manifest(folder)["runs"]}
    assert [runs[duration]["outcome"] for duration in (0.1, 0.2, longest)] == ["completed", "completed", "disk"]
    assert "no space left on the disk" in runs[longest]["reason"]
    assert len(list((folder / "runs").iterdir())) == 2 and not list((folder / "partial").iterdir())


@pytest.mark.slow
def test_a_run_too_large_for_the_disk_leaves_the_others(tmp_path: Path) -> None:
    write_scene(tmp_path)
    ended = carom_process("sweep", "spheres.toml", *durations(20.0), "-o", "out", cwd=tmp_path, limit=12_000_000)
    assert_the_small_ones_are_there(tmp_path / "out", ended, 20.0)


@pytest.mark.slow  # not for its time: mounting a disk needs root, which CI is
def test_a_full_disk_leaves_a_manifest_that_says_so(tmp_path: Path) -> None:
    write_scene(tmp_path)
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=10m", "tmpfs", disk], check=True)
    try:
        ended = carom_process(
            "sweep", "spheres.toml", *durations(16.0), "--workers", "1", "-o", "disk/out", cwd=tmp_path
        )
        assert_the_small_ones_are_there(disk / "out", ended, 16.0)
    finally:
        subprocess.run(["umount", disk], check=True)


def children_of(process: int) -> list[int]:
    """Find the workers among the processes of a sweep."""
    lists = [path.read_text(encoding="utf-8") for path in Path(f"/proc/{process}/task").glob("*/children")]
    children = [int(child) for listed in lists for child in listed.split()]
    return [child for child in children if b"carom.runs.workers" in Path(f"/proc/{child}/cmdline").read_bytes()]


def is_running(process: int) -> bool:
    stat = Path(f"/proc/{process}/stat")
    return stat.exists() and stat.read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0] != "Z"
