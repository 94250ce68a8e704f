"""`carom tune`, run as a person runs it."""

from __future__ import annotations

from pathlib import Path

import pytest

from carom.scene.schema import Scene
from command import carom

QUICK = ("--vary", "time.integrator=leapfrog,yoshida4", "--vary", "step=4,1", "--repeats", "1")
SHORT = ("--set", "time.duration=1.0")


def test_the_cheapest_setting_that_keeps_the_limit_is_written_with_its_measurement(tmp_path: Path) -> None:
    # of the four only Yoshida's keep 1e-8, and a step four times as long costs a quarter
    done = carom("tune", "figure-eight", "--error", "energy=1e-8", *QUICK, *SHORT, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "integrator = yoshida4, step × 4" in done.stdout.splitlines()[-1]
    text = (tmp_path / "figure-eight-tuned.toml").read_text(encoding="utf-8")
    assert text.startswith("# carom tune: integrator = yoshida4, step × 4\n# measured: energy ")
    assert "# Three equal masses chase each other" in text, "the author's comments stay"
    scene = Scene.load(tmp_path / "figure-eight-tuned.toml")
    assert scene.time.fixed_dt == 0.008 and scene.time.integrator == "yoshida4"
    again = carom("tune", "figure-eight", "--error", "energy=1e-8", *QUICK, *SHORT, cwd=tmp_path)
    assert again.returncode == 2 and "exists; give --force" in again.stderr


def test_where_none_keeps_the_limit_it_says_so_and_which_is_nearest(tmp_path: Path) -> None:
    done = carom("tune", "figure-eight", "--error", "position=1e-12", *QUICK, *SHORT, cwd=tmp_path)
    assert done.returncode == 1
    assert "none of the settings keeps position=1e-12: the nearest is integrator = yoshida4: position" in done.stderr
    assert not (tmp_path / "figure-eight-tuned.toml").exists()


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ("energie=1", 'did you mean "energy"?'),
        ("energy", "expected a number of 0 or more, such as energy=1e-4"),
        ("energy=small", "expected a number"),
        ("energy=-1", "expected a number"),
    ],
)
def test_a_limit_that_is_none_is_one_message(limit: str, said: str, tmp_path: Path) -> None:
    done = carom("tune", "figure-eight", "--error", limit, cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr
