"""Warnings of a run reach the terminal and scripts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carom.event import Event
from carom.recording.read.recording import Recording
from carom.scene.units.system import SI
from carom.terminal.printing import warning_lines
from carom_command import carom

# Two spheres that overlap at rest: Baumgarte's bias throws them apart, which is a rise of the energy.
THROWN_APART = """
time = { duration = 0.1, fixed_dt = 0.01 }
gravity = { constant = 0.0 }
record = { check_every = 1 }
contact = { stabilisation = "baumgarte", allow_overlap = true, timing = "end-of-step" }

[[body]]
radius = 1.0

[[body]]
radius = 1.0
position = [1.5, 0.0, 0.0]
"""


def rises(count: int) -> list[Event]:
    return [
        Event(k, 0.5 * k, "WARN", f"Energy rose by {k} J.\nColliding: a and b", "energy-rise") for k in range(count)
    ]


def test_the_first_warnings_of_a_kind_are_shown_with_their_times_and_the_others_counted() -> None:
    lines = list(warning_lines([*rises(100), Event(7, 3.5, "WARN", "Too few sweeps.", "limit")], SI))
    assert lines == [
        "step 0, t = 0 s: Energy rose by 0 J.",
        "step 1, t = 0.5 s: Energy rose by 1 J.",
        "step 2, t = 1 s: Energy rose by 2 J.",
        "… and 97 similar ones, the last at step 99, t = 49.5 s",
        "step 7, t = 3.5 s: Too few sweeps.",
    ]


def test_only_the_first_warning_of_a_kind_is_shown_with_what_it_names() -> None:
    lines = list(warning_lines(rises(2), SI, in_full=True))
    assert [line for line in lines if "Colliding" in line] == ["    Colliding: a and b"]


@pytest.fixture(scope="module")
def warned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("warned")
    (folder / "apart.toml").write_text(THROWN_APART, encoding="utf-8")
    return folder


def test_a_run_prints_its_warnings_and_gives_them_to_scripts(warned: Path) -> None:
    shown = carom("run", "apart.toml", "-o", "shown.rrd", cwd=warned)
    assert shown.returncode == 0, shown.stderr
    assert "warning" in shown.stdout and "Energy rose by" in shown.stdout
    document = json.loads(carom("run", "apart.toml", "-o", "script.rrd", "--json", cwd=warned).stdout)
    kinds = {warning["kind"] for warning in document["warnings"]}
    assert kinds == {"energy-rise"}
    recorded = [event.text for event in Recording.open(warned / "script.rrd").warnings()]
    assert [warning["text"] for warning in document["warnings"]] == recorded


def test_inspect_prints_the_warnings_and_gives_them_to_scripts(run_file: Path, tmp_path: Path) -> None:
    shown = carom("inspect", "run.rrd", cwd=tmp_path).stdout
    assert "Warnings: 2" in shown and "step 30, t = 1.5 s: something at step 30" in shown
    summary = json.loads(carom("inspect", "run.rrd", "--json", cwd=tmp_path).stdout)
    assert [(warning["step"], warning["level"]) for warning in summary["warnings"]] == [(30, "WARN"), (70, "WARN")]
    assert set(summary["warnings"][0]) == {"step", "time", "level", "text", "kind"}
