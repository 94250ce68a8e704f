"""What `import carom` offers."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import carom
from carom.physics.status import StepStatus


def test_a_person_who_explores_the_package_finds_what_it_offers() -> None:
    assert dir(carom) == ["Recording", "Scene", "Space", "__version__", "errors", "record", "run"]
    assert carom.__version__ == version("carom")
    assert carom.errors.SceneError.__doc__


def test_importing_the_package_loads_neither_the_compiler_nor_the_viewer() -> None:
    program = "import sys, carom; print({'numba', 'rerun', 'pyarrow', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_a_scene_runs_by_its_name_and_says_where_it_stands(tmp_path: Path) -> None:
    seen: list[StepStatus] = []
    recording = carom.run("two-spheres", tmp_path / "run.rrd", watch=seen.append)
    assert recording.outcome == "completed" and seen[-1].step == 800
    with pytest.raises(carom.errors.SceneError, match="two-sphers"):
        carom.run("two-sphers", tmp_path / "other.rrd")


def test_a_notebook_shows_the_summary_of_a_recording(tmp_path: Path) -> None:
    recording = carom.run("two-spheres", tmp_path / "<b>.rrd")
    table = recording._repr_html_()
    assert "<caption>&lt;b&gt;.rrd</caption>" in table and "<td>completed</td>" in table
    assert "801 frames, 800 steps, 4 s" in table
