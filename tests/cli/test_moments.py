"""A moment that is asked for must be in the recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from carom.recording.read.recording import Recording
from carom_command import carom


@pytest.mark.parametrize("command", ["picture", "view", "report"])
def test_a_moment_outside_the_recording_is_refused_with_what_it_covers(
    run_file: Path, tmp_path: Path, command: str
) -> None:
    done = carom(command, "run.rrd", "--at", "5.2", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr == "carom: run.rrd covers 0 to 4.95 s; 5.2 s is outside\n"
    assert list(tmp_path.iterdir()) == [run_file]


@pytest.mark.parametrize(
    "arguments",
    [
        ["picture", "--at", "nan"],
        ["report", "--at", "soon"],
        ["clip", "--around", "nan", "--window", "1"],
        ["replay", "--from", "nan"],
        ["resume", "--until", "nan"],
    ],
)
def test_an_argument_that_is_not_a_time_is_refused(run_file: Path, tmp_path: Path, arguments: list[str]) -> None:
    command, *options = arguments
    done = carom(command, "run.rrd", *options, cwd=tmp_path)
    assert done.returncode == 2 and "expected a time" in " ".join(done.stderr.split())
    assert list(tmp_path.iterdir()) == [run_file]


ROLLING = """
[time]
duration = 0.2
fixed_dt = 0.01
[gravity]
constant = 0
uniform = [0, 0, -9.81]
[[plane]]
[[body]]
position = [0, 0, 1]
velocity = [1, 0, 0]
"""
TOUCHING = """
[time]
duration = 0.5
[gravity]
constant = 0
[[body]]
radius = 0.05
position = [0.2, 0, 0]
[[body]]
radius = 0.05
position = [0.3, 0, 0]
"""
APART = """
[time]
duration = 0.5
[contact]
enabled = false
[[body]]
[[body]]
position = [9, 0, 0]
"""


@pytest.mark.parametrize(
    ("scene", "absent", "present"),
    [
        (ROLLING, ["ardest impact"], ["ost contacts"]),
        (TOUCHING, ["eepest overlap", "integration error, ", "0.00e+00"], ["integration error at most 0 of"]),
        (APART, ["contact"], ["momentum"]),
    ],
    ids=["rolling", "touching", "apart"],
)
def test_nothing_is_called_the_largest_that_is_no_more_than_rounding_or_rest(
    scene: str, absent: list[str], present: list[str], tmp_path: Path
) -> None:
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    said = carom("run", "scene.toml", "-o", "run.rrd", cwd=tmp_path).stdout
    shown = carom("inspect", "run.rrd", cwd=tmp_path).stdout
    assert all(each in shown for each in present)
    assert not [each for each in absent if each in shown.partition("time of the steps")[0] or each in said]
    texts = " ".join(Recording.open(tmp_path / "run.rrd").events()["text"].to_pylist())
    assert not [each for each in absent if each in texts]
