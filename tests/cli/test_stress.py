"""`carom stress`, run as a person runs it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from carom.recording.read.recording import Recording
from carom.scene.scene_file import extreme_scenes
from carom_command import carom

# impacts at exact times do not overlap
TOO_DEEP = ("--set", "contact.timing=end-of-step", "--set", "expect.max_overlap=1e-9")


def test_an_extreme_is_shown_with_criterion_measurement_and_recording(tmp_path: Path) -> None:
    done = carom("stress", "mass-ratio", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in ("Masses 1 : 10⁹", "max_overlap ≤ 0.05", "impacts ≥ 2", "yes", "recordings/stress/mass-ratio.rrd"):
        assert part in done.stdout
    assert "1 of 1 extremes met their criteria." in done.stdout and "NO" not in done.stdout
    assert "1/1  mass-ratio: Masses 1 : 10⁹" in done.stderr
    assert Recording.open(tmp_path / "recordings" / "stress" / "mass-ratio.rrd").outcome == "completed"


def test_a_missed_criterion_exits_1_with_its_worst_moment_and_where_to_look(tmp_path: Path) -> None:
    done = carom("stress", "mass-ratio", *TOO_DEEP, "-o", "out", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert "NO" in done.stdout and "0 of 1 extremes met their criteria." in done.stdout
    worst = next(line for line in done.stdout.splitlines() if line.startswith("  max_overlap"))
    for part in ("step", "body 0 ", " and body 2 ", "carom view out/mass-ratio.rrd --at"):
        assert part in worst
    at = float(worst.split()[-1])
    assert 0.0 < at < 10.0


def test_json_is_one_document_that_a_script_can_use(tmp_path: Path) -> None:
    done = carom("stress", "mass-ratio", "--json", *TOO_DEEP, cwd=tmp_path)
    assert done.returncode == 1 and done.stderr == ""
    document = json.loads(done.stdout)
    assert document["met"] == 0 and document["asked"] == 1 and document["versions"]["carom"]
    (entry,) = document["extremes"]
    assert entry["name"] == "mass-ratio" and entry["status"] == "expectation missed" and entry["wall_time"] > 0
    criteria = {criterion["name"]: criterion for criterion in entry["criteria"]}
    assert criteria["impacts"]["bound"] == "at least" and criteria["impacts"]["met"] is True
    assert criteria["max_overlap"]["limit"] == 1e-9 and criteria["max_overlap"]["met"] is False
    assert entry["worst"]["max_overlap"]["bodies"] == [0, 2]
    assert (tmp_path / entry["recording"]).exists()


def test_a_refused_extreme_is_a_row_with_the_reason(tmp_path: Path) -> None:
    backwards = ("--set", "contact.timing=time-of-impact", "--set", "time.integrator=yoshida4")
    done = carom("stress", "hub-25", *backwards, cwd=tmp_path)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "hub-25: refused: the override contact.timing=time-of-impact: contact.timing" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["mass-ration"], 'no extreme of that name; did you mean "mass-ratio"?'),
        (["mass-ratio", "--set", "contact.restitution=2"], "must be at most 1"),
        (["mass-ratio", "-o", "taken"], "is not a folder"),
    ],
)
def test_a_mistake_is_one_message_and_exit_code_2(arguments: list[str], said: str, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("not a folder", encoding="utf-8")
    done = carom("stress", *arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr and "Traceback" not in done.stderr


@pytest.mark.slow
def test_ctrl_c_ends_with_what_is_done_so_far(tmp_path: Path) -> None:
    run = subprocess.Popen(
        [sys.executable, "-m", "carom", "stress", "-o", "out"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while not (tmp_path / "out" / "dense-gas.rrd").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    run.send_signal(signal.SIGINT)
    stdout, stderr = run.communicate(timeout=120)
    assert run.returncode == 1 and "Traceback" not in stderr
    assert "Inelastic collapse of ten beads" in stdout and "were not run" in stdout


def test_an_extreme_is_a_scene_like_any_other(tmp_path: Path) -> None:
    assert carom("run", "extremes/just-touching", cwd=tmp_path).returncode == 0
    assert (tmp_path / "recordings" / "just-touching.rrd").exists()
    assert carom("new", "mine", "--from", "extremes/just-touching", cwd=tmp_path).returncode == 0
    assert "extremes/just-touching" in carom("scenes", cwd=tmp_path).stdout
    assert 'did you mean the bundled scene "extremes/mass-ratio"' in carom("run", "mass-rato", cwd=tmp_path).stderr


def test_without_a_name_all_extremes_are_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: path for name, path in extreme_scenes().items() if name.endswith(("touching", "never-meet"))}
    monkeypatch.setattr("carom.cli.stress.extreme_scenes", lambda: few)  # tests/runs/test_stress.py runs each
    done = carom("stress", cwd=tmp_path)
    assert "2 of 2 extremes met their criteria." in done.stdout
