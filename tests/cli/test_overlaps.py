"""The deepest overlap of a run is named where something overlapped, and only there."""

from __future__ import annotations

from pathlib import Path

import pytest

import carom as library
from carom.errors import SceneError
from carom.recording.read.recording import Recording
from carom.runs.outcome import overview
from carom.sharing.report import worst_moment
from carom_command import carom
from small_scenes import pair

TIMINGS = {"exact": "time-of-impact", "late": "end-of-step"}  # of an impact within a step


def words(folder: Path, run: str) -> dict[str, str]:
    """Return all texts about a run, by output."""
    offset = 9.0 if run == "missed" else 0.0
    contact = {"timing": TIMINGS.get(run, "auto")}
    scene = pair(offset=offset, contact=contact, time={"duration": 2.0, "fixed_dt": 0.15})
    (folder / f"{run}.toml").write_text(scene.toml, encoding="utf-8")
    said = {}
    for command in (("run", f"{run}.toml", "-o", f"{run}.rrd"), ("inspect", f"{run}.rrd")):
        done = carom(*command, cwd=folder)
        assert done.returncode == 0, done.stderr
        said[command[0]] = " ".join(done.stdout.split())
    recording = Recording.open(folder / f"{run}.rrd")
    report = f"{overview(recording)} {worst_moment(recording)}"
    return said | {"report": report, "notebook": recording._repr_html_()}


@pytest.mark.parametrize("run", ["missed", "exact"])
def test_no_overlap_is_named_where_nothing_overlapped(tmp_path: Path, run: str) -> None:
    assert [command for command, said in words(tmp_path, run).items() if "overlap" in said] == []


def test_the_deepest_overlap_is_named_where_two_bodies_overlapped(tmp_path: Path) -> None:
    said = words(tmp_path, "late")
    assert [command for command, text in said.items() if "deepest overlap" in text] == list(said)
    assert "deepest overlap, 10% of the smaller radius, body 0 and body 1" in said["inspect"]


def test_a_small_overlap_keeps_its_digits(tmp_path: Path) -> None:
    late = 1e-7  # s, after the impact at 1 s, so that the bodies overlap by 2e-7 of their radius
    scene = pair(time={"duration": 2.0, "fixed_dt": 1.0 + late}, contact={"timing": "end-of-step"})
    library.run(scene, tmp_path / "run.rrd")
    assert "deepest overlap 2e-05% of the smaller radius" in carom("inspect", "run.rrd", cwd=tmp_path).stdout


def at_distance(overlap: float, place: float) -> list[dict[str, object]]:
    """Return two balls of 0.03 m that overlap, at a place along x (m)."""
    return [{"radius": 0.03, "position": [x, 0, 0]} for x in (place, place + 0.06 - overlap)]


@pytest.mark.parametrize(("overlap", "place", "refused"), [(3e-9, 0.05, False), (1e-6, 0.05, True), (1e-3, 1e6, True)])
def test_an_overlap_below_seven_digits_of_the_coordinates_is_none(overlap: float, place: float, refused: bool) -> None:
    scene = library.Scene.from_dict({"body": at_distance(overlap, place), "time": {"duration": 1e-3}})
    if refused:
        with pytest.raises(SceneError, match="overlap by"):
            library.Space(scene)
    else:
        library.Space(scene)
