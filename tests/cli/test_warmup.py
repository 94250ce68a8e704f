"""`carom warmup` compiles every kernel ahead."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import carom
from carom.runs.warmup import warm_up
from carom.scene.load import Scene
from other_processor import OtherProcessor, environment_of

PLAIN = {f"taylor.{name}_one_by_one" for name in ("_attract", "_attract_bodies", "_evaluate")}  # of CAROM_PLAIN=1 only
OF_WALLS = {  # compiled for scenes with a [[wall]], as the kernels of a contact law are for scenes with that law
    *("solids._write_heights", "solids.add_arc_speeds", "wall_impacts._time_to_wall", "wall_impacts._until_path"),
    *("moving_walls.work_of_contacts", "moving_walls.work_of_impacts", "solids.add_load_of_walls"),
    *(f"translating_walls.{name}" for name in ("mean_velocities", "place", "work_at_velocities", "work_in_drift")),
}
OF_SHEAR = {  # compiled for sheared boxes
    *(f"sheared_box.{name}" for name in ("_image", "_wrap", "along_gradient", "in_axes")),
    *("sheared_box._work_of_contacts", "sheared_box._work_of_corrections", "near_pairs._find_near"),
}
OF_PACKAGES = {  # compiled for the forces and laws of each package that calls them
    *("kernel_forces._add", "kernel_forces._energy"),
    *("exponential.exponential", "exponential.logarithm", "exponential.power"),
}


def kernels() -> set[str]:
    """All functions of carom that Numba compiles separately, by module and name."""
    found = set()
    for module in pkgutil.walk_packages(carom.__path__, "carom."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Dispatcher) and value.targetoptions.get("inline") != "always":
                found.add(f"{value.py_func.__module__}.{value.py_func.__name__}")
    return found


@pytest.mark.slow
def test_after_a_warmup_nothing_is_left_to_compile(other_processor: OtherProcessor) -> None:
    warmth, cache = other_processor.warmth, other_processor.kernels
    assert warmth["compiled"] > 50 and warmth["seconds"] > 0.0
    assert Path(warmth["cache"]).is_relative_to(cache)
    cached = {path.name.split("-")[0] for path in cache.rglob("*.nbc")}
    needed = {".".join(name.split(".")[-2:]) for name in kernels()} - OF_PACKAGES - OF_WALLS - OF_SHEAR - PLAIN
    missing = needed - cached
    assert len(needed) > 50 and missing == set()
    again = [sys.executable, "-m", "carom", "warmup"]
    done = subprocess.run(again, env=environment_of(cache), stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout.startswith("0 kernels compiled in ")


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
