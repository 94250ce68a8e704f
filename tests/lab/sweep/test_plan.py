"""The plan of a sweep."""

from __future__ import annotations

from pathlib import Path

import pytest

from carom.errors import ExperimentError, SceneError
from carom.lab.sweep.plan import plan
from sweep_runs import SCENE, write_scene


def names(folder: Path, *vary: str, seeds: int | None = None, zipped: bool | None = None) -> list[str]:
    return [point.name for point in plan(write_scene(folder), [], vary, seeds, zipped).points]


def test_runs_are_named_by_what_varies(tmp_path: Path) -> None:
    assert names(tmp_path, "contact.restitution=0.2,0.8", seeds=2) == [
        "restitution=0.2,seed=5",
        "restitution=0.2,seed=6",
        "restitution=0.8,seed=5",
        "restitution=0.8,seed=6",
    ]
    assert names(tmp_path, "body.0.radius=1,1.01", "body.1.radius=1")[1] == "body.0.radius=1.01,body.1.radius=1"
    assert names(tmp_path, "gravity.uniform=[0,0,-9.8],[0,0,-1.6]") == ["uniform=0_0_-9.8", "uniform=0_0_-1.6"]


def test_names_are_safe_as_files_and_tell_runs_apart(tmp_path: Path) -> None:
    found = names(tmp_path, 'title="a/b","a b"', "description=" + "x" * 300)
    assert len(set(found)) == 2
    assert all("/" not in name and " " not in name and len(name) < 140 for name in found)


def test_values_go_side_by_side_and_seeds_with_each(tmp_path: Path) -> None:
    vary = ("contact.restitution=0.2,0.8", "contact.static_friction=0.5,0.6")
    assert names(tmp_path, *vary, seeds=2, zipped=True) == [
        "restitution=0.2,static_friction=0.5,seed=5",
        "restitution=0.2,static_friction=0.5,seed=6",
        "restitution=0.8,static_friction=0.6,seed=5",
        "restitution=0.8,static_friction=0.6,seed=6",
    ]
    with pytest.raises(ExperimentError, match="zipped keys need equally many values"):
        names(tmp_path, *vary, "time.duration=1,2,3", zipped=True)


def test_the_section_of_the_scene_holds_where_nothing_else_is_said(tmp_path: Path) -> None:
    path = tmp_path / "swept.toml"
    path.write_text(
        f'{SCENE}\n[sweep]\nseeds = 2\n[sweep.vary]\n"contact.restitution" = "0.2:0.8:3"\n', encoding="utf-8"
    )
    planned = plan(path)
    assert len(planned.points) == 6 and planned.varied == ("contact.restitution", "seed")
    assert len(plan(path, vary=["contact.restitution=0.5"], seeds=1).points) == 1
    assert "sweep" not in planned.scene and planned.digest == plan(write_scene(tmp_path), seeds=1).digest


def test_a_scene_that_no_run_can_use_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="must be at most 1"):
        names(tmp_path, "contact.restitution=2,3")
    assert len(names(tmp_path, "contact.restitution=2,0.5")) == 2
