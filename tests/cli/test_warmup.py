"""`carom warmup` compiles every kernel ahead."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import carom
from command import carom as command
from command import carom_process


def kernels() -> set[str]:
    """All functions of carom that Numba compiles on their own, by module and name."""
    found = set()
    for module in pkgutil.walk_packages(carom.__path__, "carom."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Dispatcher) and value.targetoptions.get("inline") != "always":
                found.add(f"{value.py_func.__module__}.{value.py_func.__name__}")
    return found


@pytest.mark.slow
def test_warmup_says_where_the_kernels_are(tmp_path: Path) -> None:
    warmth = json.loads(command("warmup", "--json", cwd=tmp_path).stdout)
    assert warmth["seconds"] > 0.0 and list(Path(warmth["cache"]).glob("*.nbc"))
    again = carom_process("warmup", cwd=tmp_path)
    assert again.returncode == 0 and again.stdout.startswith("0 kernels compiled in ")


@pytest.mark.slow
def test_after_a_warmup_nothing_is_left_to_compile_but_what_was_damaged(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    subprocess.run([sys.executable, "-m", "carom", "warmup"], cwd=tmp_path, env=environment, check=True)
    cached = {path.name.split("-")[0] for path in (tmp_path / "cache").rglob("*.nbc")}
    needed = {".".join(name.split(".")[-2:]) for name in kernels()}
    assert len(needed) > 50 and not needed - cached
    files = sorted((tmp_path / "cache").rglob("*.nbc"))
    damaged = files[:: len(files) // 10]
    for file, other in zip(damaged[::2], damaged[1::2], strict=False):
        contents = file.read_bytes()
        file.write_bytes(other.read_bytes())
        other.write_bytes(contents[: len(contents) // 2])
    again = [sys.executable, "-m", "carom", "warmup", "--json"]
    warmth = json.loads(subprocess.run(again, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, check=True).stdout)
    # a damaged kernel that only others call is not loaded while they are whole: 4 to 8 of 11 were compiled again, with
    # the functions that have no file of their own, of which there is one for every five files
    assert 1 <= warmth["compiled"] <= 2 * len(damaged)
