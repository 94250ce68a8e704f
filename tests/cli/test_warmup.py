"""`carom warmup` compiles the kernels of scenes ahead. `main_paths.py` checks that it leaves none on a new machine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from carom.runs.warmup import warm_up
from carom.scene.load import Scene


@pytest.mark.nightly
@pytest.mark.slow  # it compiles the kernels of a wall that bodies move
def test_a_scene_given_to_a_warmup_has_nothing_left_to_compile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.runs.warmup.SCENES", {})  # only what the scene itself needs
    run = "import sys; from carom.physics.jit.decorators import Compilations; from carom.runs.run import run\n"
    run += "with Compilations() as compiled: run('piston', sys.argv[1])\nprint(compiled.count)"
    warm_up([Scene.load("piston")])
    done = subprocess.run(
        [sys.executable, "-c", run, tmp_path / "a.rrd"], stdout=subprocess.PIPE, text=True, check=True
    )
    assert int(done.stdout) == 0


def test_a_warmup_names_a_scene_that_does_not_exist_before_it_compiles() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "carom", "warmup", "no-scene"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and done.stderr.startswith("carom: no-scene: no such file")
    assert "Compiling" not in done.stderr
