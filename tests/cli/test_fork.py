"""`carom fork`: what it prints, writes and refuses."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from carom.lab.fork import fork as forking
from carom.runs.run import simulate
from carom_command import carom, carom_process

SEEDED = ("--at", "0.5", "--perturb", "1ulp", "--seeds", "2")


def test_a_fork_writes_both_courses_and_prints_their_difference(folder: Path) -> None:
    done = carom("fork", "run.rrd", "--at", "0.5", "--set", "contact.restitution=0", "--force", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "Forked at step 5, t = 0.5 s with contact.restitution = 0" in done.stdout
    assert (folder / "run-fork.rrd").exists()
    default = carom("fork", "run.rrd", "--at", "0.5", "--set", "contact.sweeps=20", "--force", cwd=folder)
    assert "with contact.sweeps = 20, before auto by default" in default.stdout
    options = ("--set", "contact.restitution=0", "-o", "other.rrd", "--json")
    told = json.loads(carom("fork", "run.rrd", "--at", "0.5", *options, cwd=folder).stdout)
    assert told["step"] == 5 and told["rms"] == pytest.approx(0.5, rel=0.15)  # 0.5 m/s for about a second
    assert [path.name for path in folder.iterdir() if path.name.startswith(".carom")] == []


def test_a_fork_that_is_stopped_says_so_in_its_file_and_exits_1(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    presses = iter([signal.SIGINT])

    def interrupt(status: object) -> None:
        for number in presses:
            signal.raise_signal(number)

    monkeypatch.setattr(forking, "simulate", lambda space, path: simulate(space, path, watch=interrupt))
    made = ("--set", "time.duration=1e7", "--set", "record.every=1e3", "-o", "stopped.rrd")
    done = carom("fork", "run.rrd", "--at", "0.5", *made, cwd=folder)
    assert done.returncode == 1, done.stderr
    shown = json.loads(carom("inspect", "stopped.rrd", "--json", cwd=folder).stdout)
    for text in (done.stdout, shown["verdict"]):
        assert "The fork ended early, interrupted: stopped by the user at t = " in text
    assert shown["a"] == "run.rrd" and shown["verdict"].startswith("Forked at step 5, t = 0.5 s")


@pytest.mark.slow
def test_many_forks_run_on_workers_and_give_a_band(folder: Path) -> None:
    options = ("--perturb", "1ulp", "--seeds", "3", "--outcome", "x_0 < 0", "--inevitable", "-o", "many.rrd", "--json")
    done = carom_process("fork", "run.rrd", "--at", "0.5", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["seeds"] == 3 and len(told["median"]) == len(told["time"]) == 201 and told["time"][-1] == 2.0
    assert None not in told["median"]
    assert [chance["probability"] for chance in told["outcome"]["chances"]] == [1.0] * 8
    assert told["outcome"]["hits"] == 3 and told["outcome"]["unperturbed"]


@pytest.mark.slow
def test_distances_of_many_forks_are_told_with_their_time(folder: Path) -> None:
    options = ("--perturb", "1ulp", "--seeds", "2", "--set", "time.duration=1.997", "-o", "two.rrd")
    done = carom_process("fork", "run.rrd", "--at", "0.5", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "2 forks at step 5, t = 0.5 s, up to t = 1.997 s." in done.stdout
    assert "At t = 1.997 s bodies are" in done.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--at", "0.5"), "nothing to change: give --set KEY=VALUE or --perturb 1ulp"),
        (("--at", "7", "--perturb", "1ulp"), "covers 0 to 2 s; 7 s is outside"),
        (("--at", "0.5", "--set", "body.0.radius=2"), "a fork uses the bodies of the checkpoint"),
        (("--at", "0.5", "--set", "contact.restitutio=0"), 'did you mean "restitution"'),
        (("--at", "0.5", "--set", "contact.restitution=0", "--seeds", "3"), "add --perturb 1ulp"),
        (("--at", "0.5", "--perturb", "1ulp", "--outcome", "x_0 < 0"), "--seeds 100"),
        (("--at", "0.5", "--perturb", "1ulp", "--seeds", "9", "--inevitable"), "needs an --outcome"),
        (("--at", "0.5", "--perturb", "1ulp", "--seeds", "9", "--times", "3"), "--times needs an --outcome"),
        ((*SEEDED, "--outcome", ""), "--outcome : expected a condition"),
        ((*SEEDED, "--outcome", "x_9 < 0"), "--outcome x_9 < 0: there is no body 9 for x_9; the last is 1"),
        (
            (*SEEDED, "--outcome", "energy.finl < 0"),
            "--outcome energy.finl < 0: the summary has no energy.finl; did you",
        ),
        (("--at", "0.5", "--perturb", "1ulp", "-o", "run.rrd", "--force"), "is the recording itself"),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_2(folder: Path, options: tuple[str, ...], message: str) -> None:
    before = (folder / "run.rrd").read_bytes()
    target = () if "-o" in options else ("-o", "new.rrd")
    done = carom("fork", "run.rrd", *options, *target, cwd=folder)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert (folder / "run.rrd").read_bytes() == before
