"""Every `--json` prints one document of valid JSON, whatever was measured."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from carom.terminal.printing import finite
from carom_command import carom

UNBOUNDED = """
title = "A promise of what a periodic box does not conserve"
[time]
duration = 0.02
fixed_dt = 0.01
[gravity]
constant = 0
[domain]
boundary = "periodic"
size = [2, 2, 2]
[expect]
angular_momentum_error = 1e-9
[[body]]
radius = 0.1
mass = 1
velocity = [1, 0, 0]
[[body]]
radius = 0.1
mass = 1
position = [0.5, 0, 0]
"""


def parsed(text: str) -> Any:
    """Read strict JSON, which has no NaN and no Infinity."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("json")
    (folder / "box.toml").write_text(UNBOUNDED, encoding="utf-8")
    assert carom("run", "box.toml", "-o", "box.rrd", cwd=folder).returncode == 1
    done = carom("sweep", "box.toml", "--seeds", "1", "--workers", "1", "-o", "sweep", cwd=folder)
    assert done.returncode == 1, done.stderr
    return folder


@pytest.mark.parametrize(
    "command",
    [
        ("run", "box.toml", "-o", "again.rrd"),
        ("inspect", "box.rrd"),
        ("sweep", "box.toml", "--seeds", "1", "-o", "sweep"),
        ("sweep", "--table", "sweep"),
    ],
    ids=" ".join,
)
def test_a_measure_without_a_bound_is_null(command: tuple[str, ...], folder: Path) -> None:
    assert parsed(carom(*command, "--json", cwd=folder).stdout)


def test_the_manifest_of_a_sweep_is_valid_json(folder: Path) -> None:
    (run,) = parsed((folder / "sweep" / "manifest.json").read_text(encoding="utf-8"))["runs"]
    assert run["results"]["expect.angular_momentum_error.measured"] is None
    assert run["results"]["expect.angular_momentum_error.met"] is False


def test_numbers_that_json_lacks_become_null_at_any_depth() -> None:
    document = {"a": math.nan, "b": [1.0, (math.inf, -math.inf)], "c": {"d": 2, "e": "NaN"}}
    assert finite(document) == {"a": None, "b": [1.0, [None, None]], "c": {"d": 2, "e": "NaN"}}


def test_a_scene_that_is_the_smallest_already_is_told_in_json(folder: Path) -> None:
    command = ("shrink", "two-spheres", "--while", "contacts.total > 0", "--workers", "1", "-o", "small.toml", "--json")
    first, again = (carom(*command, cwd=folder) for _ in range(2))
    assert first.returncode == again.returncode == 0, first.stderr + again.stderr
    found, known = parsed(first.stdout), parsed(again.stdout)
    assert {key: found[key] for key in known} == known and known["minimal"] is True
