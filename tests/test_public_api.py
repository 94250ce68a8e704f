"""What `import carom` offers."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import carom
from carom import extend
from carom.physics.simulation import StepStatus

ROOT = Path(__file__).parents[1]


def test_a_person_who_explores_the_package_finds_what_it_offers() -> None:
    classes, functions = ["Frame", "Recording", "Scene", "Space"], ["replay", "rerun", "resume", "run", "show", "view"]
    assert dir(carom) == [*classes, "__version__", "errors", "fields", "record", *functions]
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


@pytest.mark.slow
def test_a_run_is_continued_and_replayed_by_its_path(tmp_path: Path) -> None:
    whole = carom.run("two-spheres", tmp_path / "whole.rrd")
    half = carom.run(carom.Scene.load("two-spheres", ["time.duration=2.0"]), tmp_path / "half.rrd")
    seen: list[StepStatus] = []
    resumed = carom.resume(str(half.path), 4.0, tmp_path / "longer.rrd", watch=seen.append)
    assert resumed.path == tmp_path / "longer.rrd" and resumed.outcome == "completed" and seen[-1].step == 800
    assert resumed.fingerprints().equals(whole.fingerprints())
    result = carom.replay(tmp_path / "longer.rrd", dense=str(tmp_path / "dense.rrd"))
    assert result.same and result.compared == resumed.frames
    assert carom.Recording.open(tmp_path / "dense.rrd").frames == 801
    with pytest.raises(carom.errors.RecordingError, match=r"has been simulated to 4 s already"):
        carom.resume(resumed)
    assert carom.resume(half, 3.0).path == half.path, "by default the recording is replaced by the longer one"


def test_a_run_finds_a_place_for_its_recording_and_shows_a_progress_bar_when_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = carom.run("two-spheres", progress=True)
    assert recording.path == Path("recordings/two-spheres.rrd")
    printed = capsys.readouterr().out
    assert "100%" in printed and "t = 4 s, step 800" in printed
    with pytest.raises(carom.errors.RecordingError, match=r"exists; give force=True to replace it$"):
        carom.run("two-spheres")
    with pytest.raises(carom.errors.SceneError, match=r"^the override time\.duratio=3: unknown key"):
        carom.Scene.load("two-spheres", ["time.duratio=3"])


def documented_names() -> list[str]:
    """Return the names of `carom.extend` that docs/extending.md gives a meaning."""
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    page = page.partition("## What `carom.extend` has")[2].partition("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \| \S.* \|$", page, re.M)


def test_every_name_for_extensions_can_be_imported_and_has_one_line_of_meaning() -> None:
    names = dir(extend)
    assert len(names) <= 90, "too many names hide those that an author needs"
    assert sorted(documented_names()) == names
    assert all(getattr(extend, name) is not None for name in names)


def test_type_checkers_see_the_names_that_extend_has() -> None:
    source = Path(extend.__file__).read_text(encoding="utf-8")
    imported = re.findall(r"^    from ([\w.]+) import (\w+) as \w+$", source, re.M)
    assert {name: home for home, name in imported} == extend._HOMES


@pytest.mark.parametrize("layer", ["scene", "plan", "physics", "recording"])
def test_exceptions_of_scenes_spaces_and_recordings_name_no_option_of_a_command(layer: str) -> None:
    named = []
    for file in sorted((Path(carom.__file__).parent / layer).rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        if not re.search(r"\W--[a-z]", source):
            continue
        for raised in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Raise)):
            texts = (str(node.value) for node in ast.walk(raised) if isinstance(node, ast.Constant))
            named += [f"{file.name}: {text}" for text in texts if re.search(r"(^|(?<!rerun)\W)--[a-z]", text)]
    assert named == []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> carom.Recording:
    return carom.run("two-spheres", tmp_path_factory.mktemp("recorded") / "<b>.rrd")


def test_tables_of_a_recording_convert_to_pandas(recorded: carom.Recording) -> None:
    pytest.importorskip("pandas")
    frame = recorded.trajectory("left").to_pandas()
    assert len(frame) == 801 and frame["x"].iloc[0] == -2.0


def test_a_notebook_shows_the_summary_of_a_recording(recorded: carom.Recording) -> None:
    table = recorded._repr_html_()
    assert "<caption>&lt;b&gt;.rrd</caption>" in table and "<td>completed</td>" in table
    assert "801 frames, 800 steps, 4 s" in table


def test_a_recording_is_printed_with_its_file_its_size_and_its_end(recorded: carom.Recording) -> None:
    assert repr(recorded) == f"<Recording {recorded.path}: 2 bodies, 801 frames, completed>"


def test_a_space_of_a_name_is_told_how_to_load_the_scene() -> None:
    name: Any = "two-spheres"
    with pytest.raises(TypeError, match=r"Space: a Scene is needed, not str; make one by Scene\.load"):
        carom.Space(name)


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        (lambda: carom.run({}), TypeError, r"not dict; Scene\.from_dict makes one from a dict"),  # type: ignore[arg-type]
        (lambda: carom.Scene.load("two-spheres", "time.duration=3"), TypeError, r'such as \["time\.duration=3"\]'),  # type: ignore[arg-type]
        (lambda: carom.Scene.from_dict([1]), TypeError, "a dict of sections is needed, not list"),  # type: ignore[arg-type]
        (lambda: carom.Space(carom.Scene.load("two-spheres"), threads=0), ValueError, "a whole number from 1 on"),
        (lambda: carom.Space(carom.Scene.load("two-spheres"), threads="2"), ValueError, "threads = '2'"),  # type: ignore[arg-type]
    ],
)
def test_a_wrong_argument_is_named_with_what_would_be_right(
    call: Callable[[], Any], error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        call()
