"""The output of a run before its first step and after its last."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from carom.terminal.progress import RunProgress
from carom_command import carom


@pytest.mark.parametrize(
    ("time", "said"),
    [
        ({"duration": 6e7}, ""),  # its default, a millionth of the duration
        ({"duration": 6e7, "max_dt": 2.0}, "time.max_dt = 2 s causes at least 3e+07 steps; for fewer steps, raise"),
        ({"duration": 6e7, "max_dt": 100.0}, ""),
        ({"duration": 6e7, "integrator": "gauss-radau15"}, ""),
        ({"duration": 6e7, "fixed_dt": 1.0}, ""),
    ],
)
def test_a_largest_step_that_makes_a_run_long_is_named_before_the_run(
    time: dict[str, Any], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with RunProgress(Scene.from_dict({"time": time, "body": [{"radius": 1.0}]})):
        pass
    shown = " ".join(capsys.readouterr().err.split())
    assert said in shown and ("max_dt" in shown) == bool(said)


def test_fewer_frames_than_were_asked_for_are_pointed_out_with_the_key_that_gives_all(tmp_path: Path) -> None:
    (tmp_path / "moon.toml").write_text(
        """
record.every = 600
time.duration = 2e5
[[body]]
mass = 6e24
radius = 6.4e6
[[body]]
position = [4e8, 0, 0]
velocity = [0, 1e3, 0]
mass = 7e22
radius = 1.7e6
""",
        encoding="utf-8",
    )
    hint = (
        "334 frames were requested, but frames are recorded only at ends of steps, and most steps are longer than "
        "record.every; time.max_dt = 600 s"
    )
    shown = " ".join(carom("run", "moon.toml", "-o", "few.rrd", cwd=tmp_path).stdout.split())
    assert hint in shown
    shown = carom("run", "moon.toml", "--set", "time.max_dt=600 s", "-o", "all.rrd", cwd=tmp_path).stdout
    assert Recording.open(tmp_path / "all.rrd").frames >= 334 and "were requested" not in shown
    given = ("run", "moon.toml", "--set", "record.every=auto")
    shown = " ".join(carom(*given, "--set", "time.max_dt=1e4", "-o", "few.rrd", "--force", cwd=tmp_path).stdout.split())
    assert "frames are recorded at ends of steps, and steps were long; time.max_dt = 333 s gives more frames" in shown
    shown = carom(*given, "--set", "time.max_dt=333 s", "-o", "all.rrd", "--force", cwd=tmp_path).stdout
    assert "and steps were long" not in shown


def test_steps_of_a_close_encounter_without_a_frame_are_pointed_out(tmp_path: Path) -> None:
    # a comet at aphelion; every step within several years of perihelion is shorter than the automatic interval
    (tmp_path / "comet.toml").write_text(
        """
units = "au, yr, solar mass"
time.duration = 1100
contact.enabled = false
[[body]]
mass = 1
radius = 0.005
[[body]]
position = [199, 0, 0]
velocity = [0, 0.0315759, 0]
mass = 0
radius = 1e-8
""",
        encoding="utf-8",
    )
    shown = " ".join(carom("run", "comet.toml", "-o", "comet.rrd", cwd=tmp_path).stdout.split())
    found = re.search(r'gives more frames, and record.every = "step" the (\d+) short steps between them', shown)
    assert found
    run = carom("run", "comet.toml", "--set", "record.every=step", "-o", "all.rrd", cwd=tmp_path).stdout
    assert "short steps" not in run
    more = Recording.open(tmp_path / "all.rrd").frames - Recording.open(tmp_path / "comet.rrd").frames
    assert more == int(found[1])
