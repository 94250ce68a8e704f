"""Torques and impulses that are rounding noise beside the largest of the run have no arrows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.arrays import FloatArray
from carom.recording.read.frame_rows import RecordedRows
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.runs.recomputed import impacts_of
from carom.runs.replay import replay
from carom.runs.resume import resume
from carom.scene.load import Scene
from small_scenes import scene_of

NOISE = 1e-12  # m, by which the second pair meets off centre: its angular impulses are 1e-12 of those of the first
OF_LARGEST = 1e-9
FIRST, SECOND = 0.5, 1.5  # s, of the impacts


def two_pairs(duration: float = 2.0) -> Scene:
    """Two pairs of rough spheres; the first meets off centre, the second as good as head on."""
    bodies = []
    for row, (offset, time) in enumerate(((0.5, FIRST), (NOISE, SECOND))):
        apart = float(np.sqrt(1.0 - offset**2)) / 2.0  # of the centres along x when they touch, halved
        for side in (-1.0, 1.0):
            position = [side * (apart + time), side * offset / 2.0, 10.0 * row]
            bodies.append({"position": position, "velocity": [-side, 0.0, 0.0], "radius": 0.5, "mass": 1.0})
    return scene_of(
        bodies,
        gravity={"constant": 0.0},
        contact={"restitution": 1.0, "static_friction": 0.3, "kinetic_friction": 0.3},
        time={"duration": duration, "fixed_dt": 0.05},
        record={"every": "step", "check_every": 1, "impacts": "all"},
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return carom.run(two_pairs(), tmp_path_factory.mktemp("pairs") / "pairs.rrd")


def lengths(recording: Recording, path: str) -> dict[int, FloatArray]:
    """Return the lengths (m) of the arrows of an entity, by the step of each frame that has some."""
    rows, found = RecordedRows(recording), {}
    for step in recording.fingerprints()["step"].to_pylist():
        vectors: Any = rows.at(path, step)[0].batch["Arrows3D:vectors"][0].values
        if len(vectors):
            found[step] = np.linalg.norm(np.array(vectors.to_pylist()), axis=1)
    return found


def test_angular_impulses_of_rounding_have_no_arrows_once_a_larger_one_was_recorded(recording: Recording) -> None:
    for path in (paths.ANGULAR_IMPULSE, paths.SPIN_CHANGE):
        assert [len(each) for each in lengths(recording, path).values()] == [2], "of the first pair only"
    assert not lengths(recording, paths.TORQUE), "no contact lasts"
    friction = lengths(recording, paths.FORCE_FRICTION)
    assert len(friction) == 2, "both impacts have friction"
    first, second = friction.values()
    assert first.min() > 0.0 and second.max() == 0.0


def test_each_frame_holds_the_floor_of_its_arrows(recording: Recording) -> None:
    rows, steps = RecordedRows(recording), recording.fingerprints()["step"].to_pylist()
    floors = np.array([rows.at(paths.FORCE_NORMAL, step)[0].batch["floor"][0].values[0].as_py() for step in steps])
    largest = np.zeros(len(steps))
    for impact in impacts_of(recording, replay=True).to_pylist():
        at = np.searchsorted(recording.fingerprints()["time"].to_numpy(), impact["time"] - 1e-12)
        largest[at] = max(largest[at], impact["normal_impulse"])
    assert floors == pytest.approx(OF_LARGEST * np.maximum.accumulate(largest), rel=1e-15)


def test_a_replay_from_any_time_and_a_resumed_run_have_the_same_arrows(recording: Recording, tmp_path: Path) -> None:
    whole = replay(recording)
    assert whole.same and whole.not_compared == []
    assert replay(recording, 1.0).same, "the largest angular impulse is before the window"
    short = carom.run(two_pairs(1.0), tmp_path / "short.rrd")
    longer = resume(short, 2.0)
    for path in (paths.ANGULAR_IMPULSE, paths.FORCE_FRICTION):
        one, other = lengths(recording, path), lengths(longer, path)
        assert one.keys() == other.keys() and all(one[step].tolist() == other[step].tolist() for step in one)
    assert replay(longer).same


def test_arrows_of_few_bodies_have_both_magnitudes_beside_them(recording: Recording) -> None:
    rows = RecordedRows(recording)
    (step,) = lengths(recording, paths.ANGULAR_IMPULSE)
    own, other = (rows.at(path, step)[0].batch for path in (paths.ANGULAR_IMPULSE, paths.SPIN_CHANGE))
    sizes, turns = own["angular_impulse"][0].values.to_pylist(), other["spin_change"][0].values.to_pylist()
    texts = [f"{size:.3g} N m s, {turn:.3g} rad/s" for size, turn in zip(sizes, turns, strict=True)]
    assert own[paths.NUMBERS][0].values.to_pylist() == texts
    origin, vector, place = (
        np.array(own[name][0].values.to_pylist()) for name in ("Arrows3D:origins", "Arrows3D:vectors", paths.NUMBERS_AT)
    )
    assert np.all(np.linalg.norm(place - origin, axis=1) > np.linalg.norm(vector, axis=1)), "beyond the tip"
    assert paths.NUMBERS not in other.schema.names


def test_of_many_arrows_the_largest_have_numbers_and_crowds_have_none(tmp_path: Path) -> None:
    for count, labelled in ((12, 6), (41, None)):
        bodies = [
            {"position": [3.0 * k, 0.0, 0.5], "velocity": [1.0 + k, 0.0, 0.0], "radius": 0.5, "mass": 1.0 + 0.1 * k}
            for k in range(count)
        ]
        scene = scene_of(
            bodies,
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
            contact={"restitution": 0.0, "static_friction": 0.3, "kinetic_friction": 0.3},
            plane=[{"normal": [0.0, 0.0, 1.0]}],
            time={"duration": 0.02, "fixed_dt": 0.01},
            record={"every": "step"},
        )
        recording = carom.run(scene, tmp_path / f"{count}.rrd")
        batch = RecordedRows(recording).at(paths.TORQUE, 2)[0].batch
        torques = batch["torque"][0].values.to_numpy()
        assert len(torques) == count, "all of them slide"
        if labelled is None:
            assert paths.NUMBERS not in batch.schema.names
            continue
        texts = batch[paths.NUMBERS][0].values.to_pylist()
        assert {k for k, text in enumerate(texts) if text} == set(np.argsort(-torques)[:labelled].tolist())
