"""`carom warmup` compiles every kernel ahead."""

from __future__ import annotations

import importlib
import json
import pkgutil
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import carom
from other_processor import OtherProcessor, environment_of

PLAIN = {f"taylor.{name}_one_by_one" for name in ("_attract", "_attract_bodies", "_evaluate")}  # of CAROM_PLAIN=1 only
OF_WALLS = {  # compiled for scenes with a [[wall]], as the kernels of a contact law are for scenes with that law
    *("solids._write_heights", "solids.add_arc_speeds", "wall_impacts._time_to_wall", "wall_impacts._until_path"),
    *("moving_walls.set_velocities_in_drift", "moving_walls.work_of_contacts", "moving_walls.work_of_impacts"),
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


def warmup(cache: Path, *options: str) -> str:
    """Compile what is missing in a folder; return what the command says."""
    command = [sys.executable, "-m", "carom", "warmup", *options]
    return subprocess.run(command, env=environment_of(cache), stdout=subprocess.PIPE, text=True, check=True).stdout


@pytest.mark.slow
def test_after_a_warmup_nothing_is_left_to_compile_but_what_is_damaged(
    other_processor: OtherProcessor, tmp_path: Path
) -> None:
    warmth, cache = other_processor.warmth, other_processor.kernels
    assert warmth["compiled"] > 50 and warmth["seconds"] > 0.0
    assert Path(warmth["cache"]).is_relative_to(cache)
    cached = {path.name.split("-")[0] for path in cache.rglob("*.nbc")}
    needed = {".".join(name.split(".")[-2:]) for name in kernels()} - OF_PACKAGES - OF_WALLS - OF_SHEAR - PLAIN
    missing = needed - cached
    assert len(needed) > 50 and missing == set()
    assert warmup(cache).startswith("0 kernels compiled in ")
    cache = Path(shutil.copytree(cache, tmp_path / "damaged"))
    files = sorted(cache.rglob("*.nbc"))
    damaged = files[:: len(files) // 10]
    for file, other in zip(damaged[::2], damaged[1::2], strict=False):
        contents = file.read_bytes()
        file.write_bytes(other.read_bytes())
        other.write_bytes(contents[: len(contents) // 2])
    # a damaged kernel that is called only by intact ones is not loaded: 4 to 8 of 11 were compiled again, and with them
    # functions without a file of their own, one for every five files
    assert 1 <= json.loads(warmup(cache, "--json"))["compiled"] <= 2 * len(damaged)
