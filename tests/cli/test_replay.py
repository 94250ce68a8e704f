"""`carom replay`, `resume` and `report`, as a person runs them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carom.errors import PhysicsError
from carom.recording.read.recording import Recording
from carom_command import carom


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `ts.rrd`, half of the run of two spheres."""
    folder = tmp_path_factory.mktemp("replay")
    done = carom("run", "two-spheres", "-o", "ts.rrd", "--set", "time.duration=2", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_a_replay_says_that_the_bits_are_the_same(folder: Path) -> None:
    frames = Recording.open(folder / "ts.rrd").frames
    done = carom("replay", "ts.rrd", cwd=folder)
    assert done.returncode == 0 and done.stdout.startswith(f"{frames} of {frames} frames, same bits, from step 0 on")
    assert "Traceback" not in done.stderr


def test_a_window_as_json_and_with_every_step(folder: Path) -> None:
    done = carom("replay", "ts.rrd", "--from", "1", "--to", "1.5", "--every", "step", "--json", cwd=folder)
    told = json.loads(done.stdout)
    assert told["same"] and told["begin"] > 0 and told["dense"] == "ts-dense.rrd"
    assert carom("inspect", "ts-dense.rrd", cwd=folder).returncode == 0
    again = carom("replay", "ts.rrd", "--every", "step", cwd=folder)
    assert again.returncode == 2 and "exists; give --force" in again.stderr


def test_shorter_steps_tell_the_same_story_or_another(folder: Path) -> None:
    done = carom("replay", "ts.rrd", "--refine", "4", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Steps 4 times as short tell the same story from t = 0 to 2 s"), done.stdout
    late = ["--set", "contact.timing=end-of-step", "--set", "time.fixed_dt=0.2", "--set", "time.duration=2"]
    assert carom("run", "two-spheres", "-o", "late.rrd", *late, cwd=folder).returncode in (0, 1)
    done = carom("replay", "late.rrd", "--refine", "4", cwd=folder)
    assert done.returncode == 1 and "tell another story" in done.stdout and "- t = " in done.stdout
    done = carom("replay", "late.rrd", "--refine", "2", "--json", cwd=folder)
    told = json.loads(done.stdout)
    assert done.returncode == 1 and not told["same"] and told["factor"] == 2.0
    assert {"observable", "begin", "time", "bodies", "run", "refined", "allowed"} <= set(told["moved"][0])
    for wrong in (["--refine", "1"], ["--refine", "4", "--every", "step"]):
        done = carom("replay", "ts.rrd", *wrong, cwd=folder)
        assert done.returncode == 2 and "--refine" in done.stderr


def test_a_replay_that_fails_tells_a_script_why(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise PhysicsError("the state is no longer finite")

    monkeypatch.setattr("carom.runs.replay.replay", fails)
    done = carom("replay", "ts.rrd", "--json", cwd=folder)
    assert done.returncode == 1 and "the replay failed: the state is no longer finite" in done.stderr
    assert json.loads(done.stdout) == {"same": False, "ended": "the state is no longer finite"}


@pytest.mark.slow
def test_a_resumed_run_is_the_file_itself_or_another(folder: Path) -> None:
    done = carom("resume", "ts.rrd", "--until", "3", "-o", "longer.rrd", "--json", cwd=folder)
    told = json.loads(done.stdout)
    assert done.returncode == 0 and told["sim_time"] == 3.0 and told["path"] == "longer.rrd"
    longer = Recording.open(folder / "longer.rrd")
    assert longer.frames > Recording.open(folder / "ts.rrd").frames
    done = carom("resume", "longer.rrd", "--until", "4", cwd=folder)
    assert done.returncode == 0 and Recording.open(folder / "longer.rrd").frames > longer.frames
    assert "1 of 1" not in carom("replay", "longer.rrd", cwd=folder).stdout


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["replay", "nowhere.rrd"], "there is no recording at nowhere.rrd"),
        (["replay", "ts.rrd", "--every", "day"], 'the only possible value is "step"'),
        (["replay", "ts.rrd", "--from", "2", "--to", "1"], "before --from 2 s"),
        (["resume", "ts.rrd"], "simulated to 2 s already; give a later --until"),
        (["resume", "ts.rrd", "--until", "-1"], "expected a time later than the start"),
        (["report", "ts.rrd", "-o", "nowhere/x.zip"], "there is no folder nowhere"),
        (["report", "nowhere.rrd"], "there is no recording at nowhere.rrd"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_a_mistake_is_one_message(command: list[str], said: str, folder: Path) -> None:
    done = carom(*command, cwd=folder)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert said in " ".join(done.stderr.replace("│", "").split())


@pytest.mark.slow
def test_a_bundle_is_made_and_replayed_and_inspected(folder: Path) -> None:
    done = carom("report", "ts.rrd", "--json", cwd=folder)
    told = json.loads(done.stdout)
    assert done.returncode == 0 and told["size"] < 10_000_000 and "same bits" in told["replayed"], done.stderr
    assert "same bits" in carom("replay", "ts-report.zip", cwd=folder).stdout
    assert "clip of" in carom("inspect", "ts-report.zip", cwd=folder).stdout
