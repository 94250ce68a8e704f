"""Every text names its body, plane or wall, by its own name if it has one."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest
import rerun.blueprint as rrb

from carom.display.presentation import presentation
from carom.recording.read.recording import Recording
from carom_command import carom

FALLS = """
title = "Names"
[time]
duration = 0.5
fixed_dt = 0.01
[gravity]
method = "none"
uniform = [0.0, 0.0, -10.0]
"""
BALL = """
[[body]]
{name}
radius = 0.1
mass = 1.0
position = [0.0, 0.0, 0.5]
velocity = [{speed}, 0.0, 0.0]
[[body]]
name = "far away"
radius = 0.1
mass = 1.0
position = [0.0, 30.0, 40.0]
"""
PLANE = """
[[plane]]
point = [0.0, 0.0, -50.0]
[[plane]]
{name}
point = [0.0, 0.0, 0.0]
"""
OTHER = """
[[body]]
radius = 0.1
mass = 1.0
position = [0.0, 0.0, 0.2]
velocity = [0.0, 0.0, 5.0]
"""
GROUP = """
[[group]]
name = "gravel"
count = 1
radius = {min = 0.1, max = 0.1}
density = 1000.0
region = {shape = "box", centre = [0.0, 0.0, 0.0], size = [0.3, 0.3, 0.3]}
velocity = {mean = [0.0, 0.0, 5.0]}
"""
WALLS = """
[domain]
boundary = "walls"
size = [2.0, 100.0, 100.0]
"""
SCENES = {
    "named body, named plane": (
        FALLS + BALL.format(name='name = "ball"', speed=0) + PLANE.format(name='name = "floor"'),
        'body 0 "ball" and floor',
    ),
    "unnamed body, unnamed plane": (
        FALLS + BALL.format(name="", speed=0) + PLANE.format(name=""),
        "body 0 and plane 1",
    ),
    "a wall": (
        FALLS + WALLS + BALL.format(name='name = "ball"', speed=8.0),
        'body 0 "ball" and wall at +x',
    ),
    "two bodies": (FALLS + BALL.format(name='name = "ball"', speed=0) + OTHER, 'body 0 "ball" and body 2'),
    "a body of a group": (
        FALLS + BALL.format(name='name = "ball"', speed=0) + GROUP,
        'body 0 "ball" and body 2 "gravel 0"',
    ),
}


@pytest.fixture(scope="module", params=SCENES)
def collided(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Record a scene; return the recording and the name of its only pair."""
    folder = tmp_path_factory.mktemp("names")
    scene, pair = SCENES[request.param]
    (folder / "names.toml").write_text(scene)
    run = carom("run", "names.toml", "-o", "run.rrd", cwd=folder)
    assert run.returncode == 0, run.stderr
    return folder / "run.rrd", pair


def test_events_name_what_touched(collided: tuple[Path, str]) -> None:
    path, pair = collided
    texts = Recording.open(path).events()["text"].to_pylist()
    assert f"First contact: {pair}." in texts
    assert any(
        text.startswith("Hardest impact of the run, ") and text.endswith(f" J of approach (½ μ v_n²): {pair}.")
        for text in texts
    )


def test_inspect_names_what_touched_and_says_which_energy_that_is(collided: tuple[Path, str]) -> None:
    path, pair = collided
    text = carom("inspect", str(path), cwd=path.parent).stdout
    assert f" J of approach (½ μ v_n²), {pair}, in step" in text
    moment = json.loads(carom("inspect", str(path), "--json", cwd=path.parent).stdout)["moments"]["impact"]
    assert moment["between"] == pair
    assert len(moment["bodies"]) + len(moment["planes"]) == 2


def test_a_report_names_what_touched(collided: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    path, pair = collided
    monkeypatch.setattr("carom.sharing.report.try_to_render", lambda *_: "not now")
    made = carom("report", str(path), "-o", "report.zip", "--force", cwd=path.parent)
    assert made.returncode == 0, made.stderr
    with zipfile.ZipFile(path.parent / "report.zip") as bundle:
        shown = bundle.read("README.md").decode().replace("\\", "")  # Markdown's escapes
    assert f"J of approach (½ μ v_n²), {pair}**" in shown


def titles(part: Any) -> list[str]:
    """The titles of all views of a layout."""
    inside = getattr(part, "contents", None)
    if isinstance(part, rrb.View):
        return [str(part.name)]
    return [title for each in inside or () for title in titles(each)]


def test_the_close_up_view_names_both_ends(collided: tuple[Path, str]) -> None:
    path, pair = collided
    recording = Recording.open(path)
    layout = presentation(recording, recording.moment()).supplement.layout
    short = re.sub(r'body \d+ "([^"]*)"', r"\1", pair)  # a short title contains only names
    assert f"Close-up: {short}" in titles(layout.root_container)


def test_the_text_of_the_scene_names_its_planes(collided: tuple[Path, str]) -> None:
    path, pair = collided
    recording = Recording.open(path)
    chunks = recording.chunks([entry for entry in recording.store.entries if entry.entity_path == "scene"])
    text = next(chunk.batch["TextDocument:text"][0].as_py()[0] for chunk in chunks)
    if "floor" in pair:
        assert "Static planes, drawn as grids: plane 0 and floor." in text
    assert ("Static planes" in text) == ("[[plane]]" in recording.scene_toml)


def test_a_clip_of_some_bodies_names_them(collided: tuple[Path, str]) -> None:
    path, _ = collided
    cut = carom(
        "clip", str(path), "--bodies", "far away,0", "--from", "0", "-o", "clip.rrd", "--force", cwd=path.parent
    )
    assert cut.returncode == 0, cut.stderr
    ball = "body 0" if Recording.open(path).bodies.name[0] == "body 0" else 'body 0 "ball"'
    few = f'{ball} and body 1 "far away"'
    shows_all = len(Recording.open(path).bodies.name) == 2
    assert shows_all or few in cut.stdout
    shown = carom("inspect", "clip.rrd", cwd=path.parent).stdout
    assert shows_all or few in shown
    assert json.loads(carom("inspect", "clip.rrd", "--json", cwd=path.parent).stdout)["clip"]["names"] == few.split(
        " and "
    )


def test_a_clip_of_an_unknown_body_lists_the_bodies(collided: tuple[Path, str]) -> None:
    path, _ = collided
    cut = carom("clip", str(path), "--bodies", "far awy", "--from", "0", "-o", "no.rrd", cwd=path.parent)
    assert cut.returncode == 2
    assert 'did you mean "far away"?' in cut.stderr and "Traceback" not in cut.stderr
