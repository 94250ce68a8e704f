"""Processes that run tasks: their results, their deaths, and attacks by other users of the machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from operator import itemgetter
from pathlib import Path
from typing import Any

import psutil
import pytest

from carom.errors import ExperimentError
from carom.runs.workers import Ended, LocalWorkers, WorkerDiedError

NOBODY = 65534
HOLD = """
import signal, sys, time
from carom.runs.workers import LocalWorkers
with LocalWorkers(2) as workers:
    workers.send(time.sleep, {key: 600.0 for key in range(3)})
    print("started", flush=True)
    while True:
        workers.ended(600.0)
"""


def results(workers: LocalWorkers, function: Callable[[Any], Any], tasks: dict[Any, Any]) -> dict[Any, Ended]:
    workers.send(function, tasks)
    ended: dict[Any, Ended] = {}
    while len(ended) < len(tasks):
        ended |= {each.key: each for each in workers.ended(60.0)}
    return ended


def test_tasks_have_their_results_and_their_exceptions_and_a_death_costs_only_the_task_that_causes_it() -> None:
    """``os._exit`` ends its worker each time, as an allocation that the system ends would; the others are unharmed."""
    with LocalWorkers(2) as workers:
        assert {key: each.result for key, each in results(workers, abs, {k: -k for k in range(5)}).items()} == {
            k: k for k in range(5)
        }
        wrong = results(workers, itemgetter(1), {"fits": [0, 1], "short": [0]})
        assert wrong["fits"].result == 1 and isinstance(wrong["short"].error, IndexError)
        ended = results(workers, os._exit, {"dies": 3})
        assert isinstance(ended["dies"].error, WorkerDiedError) and "exit code 3" in str(ended["dies"].error)
        assert results(workers, abs, {"after": -1})["after"].result == 1


def test_a_killed_worker_is_replaced_and_its_task_is_repeated() -> None:
    with LocalWorkers(1) as workers:
        first = results(workers, eval, {"id": "__import__('os').getpid()"})["id"].result
        workers.send(time.sleep, {"sleeps": 1.0})
        os.kill(first, signal.SIGKILL)
        ended: list[Ended] = []
        while not ended:
            ended = workers.ended(60.0)
        assert [each.key for each in ended] == ["sleeps"] and ended[0].result is None
        assert results(workers, eval, {"id": "__import__('os').getpid()"})["id"].result != first


def test_what_waits_can_be_dropped_and_nobody_hears_of_what_was_dropped_under_way() -> None:
    with LocalWorkers(1) as workers:
        workers.send(abs, {"first": -1, "second": -2, "third": -3})
        assert workers.drop_waiting() == ["second", "third"]
        workers.drop()
        assert set(results(workers, abs, {"fourth": -4})) == {"fourth"}


def test_workers_that_cannot_start_end_the_wait_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.runs.workers._START", "import os; os._exit(9)")
    with LocalWorkers(1) as workers, pytest.raises(ExperimentError, match="end while starting, with exit code 9"):
        results(workers, abs, {"never": 1})


def started_with_two_workers(**options: Any) -> tuple[subprocess.Popen[str], list[psutil.Process]]:
    command = subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True, **options)
    assert command.stdout is not None and command.stdout.readline() == "started\n"
    return command, psutil.Process(command.pid).children()


def test_workers_ignore_the_signals_to_the_command_and_end_with_it_however_it_ends() -> None:
    command, workers = started_with_two_workers()
    assert len(workers) == 2
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # also while they start
            for worker in workers:
                worker.send_signal(number)
        time.sleep(0.5)
        assert all(worker.is_running() and worker.status() != psutil.STATUS_ZOMBIE for worker in workers)
    finally:
        command.kill()
        command.wait()
    assert not psutil.wait_procs(workers, timeout=60)[1]


def test_nothing_listens_and_no_name_in_a_file_system_leads_to_a_worker(tmp_path: Path) -> None:
    """Without a port or a socket with a name, another user of the machine has nothing to connect to."""
    command, workers = started_with_two_workers(env=os.environ | {"TMPDIR": str(tmp_path)})
    try:
        for process in (psutil.Process(command.pid), *workers):
            assert not process.net_connections("inet")
            assert not [each for each in process.net_connections("unix") if each.laddr]
    finally:
        command.kill()
        command.wait()


@pytest.mark.slow
def test_nothing_that_another_user_has_planted_is_imported(tmp_path: Path) -> None:
    """Dask took modules from `dask-scratch-space` in the temporary folder, and `python -c` from the current one."""
    temporary, evidence = tmp_path / "temporary", tmp_path / "evidence"
    planted = temporary / "dask-scratch-space"
    planted.mkdir(parents=True)
    temporary.chmod(0o1777)
    for folder in (temporary, planted):
        for name in ("carom", "distributed", "multiprocessing", "numpy", "pickle", "queue", "sitecustomize"):
            (folder / f"{name}.py").write_text(f"open({str(evidence)!r}, 'a').write(__name__)", encoding="utf-8")
    if os.geteuid() == 0:
        for path in (planted, *planted.iterdir(), *temporary.glob("*.py")):
            os.chown(path, NOBODY, NOBODY)
    ran = subprocess.run(
        [Path(sys.executable).with_name("carom"), "sweep", "two-spheres", "--seeds", "2", "-o", tmp_path / "out"],
        cwd=temporary,
        env=os.environ | {"TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0 and "2 of 2 runs done" in ran.stdout, ran.stderr
    assert not evidence.exists(), evidence.read_text(encoding="utf-8")
