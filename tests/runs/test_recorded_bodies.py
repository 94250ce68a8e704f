"""Bodies from data files are in the recording: it replays, resumes, clips, reports and exports without the files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.errors import RecordingError, SceneError
from carom.lab.diff.diff import diff
from carom.lab.sweep.manifest import Folder, Manifest
from carom.lab.sweep.plan import plan
from carom.lab.sweep.sweep import SweepTask, execute
from carom.recording.edit.bundle import opened
from carom.recording.edit.clip import clip
from carom.recording.export import write
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.runs.environment import versions
from carom.runs.recomputed import snapshots
from carom.runs.replay import replay
from carom.runs.resume import continue_run, resumable_run
from carom.scene.load import Scene
from carom.scene.wording import literal
from carom.sharing.report import report
from carom_command import carom as carom_command

SCENE = """
title = "From a file"
[gravity]
constant = 0.0
[time]
duration = 0.02
fixed_dt = 0.01
[record]
every = "step"
[[body]]
name = "sun"
position = [0, 0, 50]
[[bodies]]
file = "a.npz"
name = "grain"
[[bodies]]
file = "b.npz"
[[group]]
count = 2
"""


def grains(count: int, height: float, **others: Any) -> dict[str, Any]:
    rng = np.random.default_rng(count)
    position = np.stack([3.0 * np.arange(count), np.zeros(count), np.full(count, height)], axis=1)
    velocity, spin = rng.standard_normal((2, count, 3))
    radius = 0.5 + rng.random(count)
    return {
        "position": position,
        "velocity": velocity,
        "angular_velocity": spin,
        "mass": 1.0 + radius,
        "r": radius,
        **others,
    }


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    """A recording whose data files are gone."""
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    fixed = np.arange(7) == 3
    still = {name: np.where(fixed[:, None], 0.0, grains(7, 9.0)[name]) for name in ("velocity", "angular_velocity")}
    np.savez(folder / "a.npz", **grains(7, 9.0, fixed=fixed, mu=np.ones(7), **still))
    np.savez(folder / "b.npz", **grains(3, 20.0, name=["p", "q", "r"], inertia=[0.3, 0.4, 0.5]))
    found = carom.run(folder / "scene.toml", tmp_path / "run.rrd")
    for file in ("a.npz", "b.npz"):
        (folder / file).unlink()
    return found


def test_a_recording_replays_resumes_clips_and_reports_without_the_data_files(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.sharing.report.try_to_render", lambda *_: "not of interest here")
    assert replay(recording).same
    clip(recording.path, tmp_path / "clip.rrd", 0.01, 0.02, bodies=[0, 8])
    assert replay(Recording.open(tmp_path / "clip.rrd")).same
    report(recording, tmp_path / "x.zip")
    with opened(tmp_path / "x.zip") as path:
        assert replay(Recording.open(path)).same
    run = resumable_run(recording, until=0.04)
    assert continue_run(run, run.space(), tmp_path / "longer.rrd").status == "completed"
    longer = Recording.open(tmp_path / "longer.rrd")
    assert replay(longer).same
    assert diff(recording, longer).verdict.kind == "same"


def test_a_recording_and_what_is_made_of_it_list_the_columns_that_were_not_used(
    recording: Recording, tmp_path: Path
) -> None:
    run = resumable_run(recording, until=0.03)
    continue_run(run, run.space(), tmp_path / "longer.rrd")
    clip(recording.path, tmp_path / "clip.rrd", 0.01, 0.02)
    for path in (recording.path, tmp_path / "longer.rrd", tmp_path / "clip.rrd"):
        found = Recording.open(path)
        used, note, *_ = found.summary()["data_notes"]
        assert used.startswith("a.npz: position from position (") and "mass from mass (" in used
        assert note.startswith("a.npz: columns that are not used: mu (")
        document = str(found._entities.static(paths.SCENE)["TextDocument:text"][0])
        assert f"- {literal(used)}\n- {literal(note)}" in document


def test_the_commands_list_the_columns_that_are_not_used_before_the_run(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **grains(1, 9.0, mu=np.ones(1)))
    (tmp_path / "scene.toml").write_text('time.duration = 0.01\n[[bodies]]\nfile = "a.npz"', encoding="utf-8")
    note = "a.npz: columns that are not used: mu ([contact] or a [[material]] gives coefficients)"
    assert note in " ".join(carom_command("explain", "scene.toml", cwd=tmp_path).stdout.split())
    assert json.loads(carom_command("explain", "scene.toml", "--json", cwd=tmp_path).stdout)["notes"][1:] == [note]
    assert note in carom_command("run", "scene.toml", "-o", "a.rrd", cwd=tmp_path).stderr.splitlines()
    assert note in " ".join(carom_command("inspect", "a.rrd", cwd=tmp_path).stdout.split())


def test_the_scene_of_a_recording_has_the_bodies_of_the_files(recording: Recording) -> None:
    scene = recorded_scene(recording)
    first, second = scene.data
    assert len(scene.toml) < 2 * len(SCENE)
    assert np.array_equal(first.position, grains(7, 9.0)["position"])
    assert first.fixed.tolist() == [False, False, False, True, False, False, False]
    assert np.array_equal(second.radius, grains(3, 20.0)["r"])
    assert second.name == ["p", "q", "r"]
    names = ["sun", *(f"grain {k}" for k in range(7)), "p", "q", "r", "group 0 0", "group 0 1"]
    assert list(recording.bodies.name) == names
    assert scene.count == 13


def test_exported_bodies_can_be_read_as_bodies_of_a_scene(recording: Recording, tmp_path: Path) -> None:
    for ending in ("csv", "parquet", "npz"):
        file = tmp_path / f"out.{ending}"
        write(file, snapshots(recording, None, everything=True), series=True)
        (tmp_path / "again.toml").write_text(f'[[bodies]]\nfile = "out.{ending}"\n', encoding="utf-8")
        again = Scene.load(tmp_path / "again.toml").data[0]
        last = recording.bodies(0.02)
        assert np.array_equal(again.position[:, 0], last["x"].to_numpy())
        assert np.array_equal(again.angular_velocity[:, 2], last["wz"].to_numpy())
        assert np.array_equal(again.radius, recording.bodies.radius)


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_exported_bodies_are_as_fixed_as_inert_and_called_as_in_the_run(
    recording: Recording, tmp_path: Path, ending: str
) -> None:
    write(tmp_path / f"out.{ending}", snapshots(recording, None, everything=True), series=True)
    (tmp_path / "again.toml").write_text(f'[[bodies]]\nfile = "out.{ending}"\n', encoding="utf-8")
    again = Scene.load(tmp_path / "again.toml").data[0]
    assert np.flatnonzero(again.fixed).tolist() == [4]
    assert np.array_equal(again.inertia, recording.bodies.inertia)
    assert again.name == list(recording.bodies.name)


def test_a_recording_that_lacks_bodies_of_its_scene_is_damaged(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recording, "scene_toml", recording.scene_toml.replace("count = 7", "count = 700"))
    stated = recording.info["scene_sha256"]
    monkeypatch.setattr(
        "carom.recording.read.recorded_scene.scene_digest", lambda text: stated
    )  # as a stranger could have made it
    with pytest.raises(RecordingError, match="its scene has more bodies than it"):
        recorded_scene(Recording.open(recording.path))


def test_arrays_are_recorded_like_files(tmp_path: Path) -> None:
    scene = Scene.from_arrays(
        position=[[0, 0, 0], [9, 0, 0]],
        velocity=np.eye(3)[:2],
        radius=1.0,
        mass=2.0,
        gravity={"constant": 0.0},
        time={"duration": 0.02, "fixed_dt": 0.01},
    )
    recording = carom.run(scene, tmp_path / "x.rrd")
    assert replay(recording).same
    assert recorded_scene(recording) == scene


def test_a_sweep_copies_the_data_files_of_its_scene(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "scene.toml").write_text(SCENE.replace('[[bodies]]\nfile = "b.npz"\n', ""), encoding="utf-8")
    for name in ("a.npz", "c.npz"):
        np.savez(folder / name, **grains(4, 9.0))
    made = plan(folder / "scene.toml", vary=["bodies.0.file=a.npz,c.npz"])
    root = Folder(tmp_path / "sweep")
    Manifest.begin(root, made, "carom sweep")
    for name in ("a.npz", "c.npz"):
        (folder / name).unlink()
    for point in made.points:
        result = execute(SweepTask(str(root.root), made.digest, versions()["carom"], "carom sweep", point))
        assert result["status"] == "done", result["reason"]


def test_a_replay_names_a_data_file_that_has_changed(recording: Recording) -> None:
    np.savez(recording.path.with_name("a.npz"), **grains(7, 10.0))
    result = replay(recording)
    assert result.same
    assert result.changed_files == ["a.npz"]


def test_a_report_on_too_many_bodies_has_those_around_the_moment_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 3000
    rng = np.random.default_rng(3)
    scene = Scene.from_arrays(
        position=300.0 * rng.random((count, 3)),
        velocity=rng.standard_normal((count, 3)),
        radius=0.1,
        mass=1.0,
        name="grain",
        gravity={"constant": 0.0},
        time={"duration": 0.02, "fixed_dt": 0.01},
    )
    recording = carom.run(scene, tmp_path / "run.rrd")
    monkeypatch.setattr("carom.sharing.report.try_to_render", lambda *_: "not of interest here")
    monkeypatch.setattr("carom.sharing.report.ROOM", 450_000)
    made = report(recording, tmp_path / "x.zip")
    assert not made.replays
    assert "of 3000 bodies, the nearest" in made.replayed
    with opened(tmp_path / "x.zip") as path:
        small = Recording.open(path)
        assert 1 < len(small.shown) < count
        assert path.stat().st_size <= 450_000
        body = small.shown[-1]
        assert small.bodies.name[body] == f"grain {body}"
        assert small.bodies.mass[body] == 1.0
        assert np.isnan(np.delete(small.bodies.mass, small.shown)).all()
        drawn, all_drawn = small.drawn_positions(0), recording.drawn_positions(0)
        assert drawn is not None
        assert all_drawn is not None
        assert np.array_equal(drawn, all_drawn[small.shown])
        assert small.summary()["clip"]["partial"]
        with pytest.raises(RecordingError, match="of 3000 bodies without exact states: it cannot be rerun"):
            replay(small)
        clip(path, tmp_path / "again.rrd", bodies=small.shown[:3])
    again = Recording.open(tmp_path / "again.rrd")
    assert again.shown == small.shown[:3]
    assert again.bodies.name[again.shown[2]] == f"grain {again.shown[2]}"


def test_recorded_bodies_cannot_be_changed_without_their_file(recording: Recording) -> None:
    assert recorded_scene(recording, ["time.duration=3"]).time.duration == 3.0
    with pytest.raises(SceneError, match=r"bodies\.0: only its name can be changed, because its file is not available"):
        recorded_scene(recording, ["bodies.0.radius=2"])
