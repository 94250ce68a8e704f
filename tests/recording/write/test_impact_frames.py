"""Frames at the instants of impacts: what a recording has there, beside its frames of steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import carom
from carom.arrays import FloatArray
from carom.physics.vector import minimum_images
from carom.recording.edit.clip import clip
from carom.recording.read.frame_rows import RecordedRows
from carom.recording.read.recorded_impacts import impacts_by_number, states_by_number
from carom.recording.read.recording import Recording
from carom.runs.replay import replay
from carom.scene.load import Scene
from small_scenes import scene_of

SINGLE = 2e-7  # relative, of rounding to float32
ROUNDING = 1e-12  # relative, of sums of a few energies
MASS, RADIUS, RESTITUTION, FRICTION, GRAVITY, HEIGHT, SPIN = 0.5, 0.1, 0.8, 0.1, 9.81, 1.0, 50.0
FALL = np.sqrt(2.0 * HEIGHT / GRAVITY)  # s
SPEED = GRAVITY * FALL  # m/s, at the first impact


@pytest.fixture(scope="module")
def bounces(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A ball with top spin that falls 1 m onto a rough floor and bounces; a frame each 0.1 s."""
    ball = {"position": [0.0, 0.0, HEIGHT + RADIUS], "angular_velocity": [0.0, SPIN, 0.0], "radius": RADIUS}
    scene = scene_of(
        [{"name": "ball", "mass": MASS, **ball}],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -GRAVITY]},
        contact={"restitution": RESTITUTION, "static_friction": FRICTION, "kinetic_friction": FRICTION},
        plane=[{"name": "floor", "point": [0.0, 0.0, 0.0]}],
        time={"duration": 1.5, "fixed_dt": 0.01},
        record={"every": 0.1, "impacts": "auto"},
    )
    return carom.run(scene, tmp_path_factory.mktemp("bounces") / "bounces.rrd")


def column(recording: Recording, path: str, name: str) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return the numbers, the times (s) where there are any, and the values, a row each, of rows at impacts."""
    numbers, table = states_by_number(recording)[path]
    values: Any = table[name].combine_chunks()
    rows = [np.asarray(row.values.flatten() if hasattr(row.values, "flatten") else row.values) for row in values]
    times = np.asarray(table["sim_time"].cast("int64")) * 1e-9 if "sim_time" in table.column_names else np.empty(0)
    return numbers, times, np.array([np.ravel(row.tolist()) for row in rows])


def test_every_impact_of_a_few_is_a_frame_in_which_the_bodies_touch(bounces: Recording) -> None:
    numbers, times, centres = column(bounces, "world/bodies", "Ellipsoids3D:centers")
    impacts = bounces.impacts()
    assert numbers.tolist() == list(range(1, impacts.num_rows + 1)) and len(numbers) == 2
    assert times == pytest.approx(np.asarray(impacts["time"]), abs=1e-9), "to the nanosecond"
    assert times[0] == pytest.approx(FALL, abs=2e-9)
    assert centres[:, 2] + bounces.origin[2] == pytest.approx(RADIUS, abs=SINGLE * HEIGHT)


def test_at_an_impact_the_edge_lies_on_the_normal_and_the_impulse_is_that_of_the_impact(bounces: Recording) -> None:
    *_, edge = column(bounces, "world/contacts", "LineStrips3D:strips")
    ends = edge[0].reshape(2, 3)
    assert (ends[1] - ends[0]) / RADIUS == pytest.approx([0.0, 0.0, -1.0], abs=1e-5)
    *_, impulse = column(bounces, "world/contacts", "normal_impulse")
    assert impulse[0, 0] == pytest.approx(MASS * (1.0 + RESTITUTION) * SPEED, rel=SINGLE)


def test_energies_step_at_an_impact_by_what_it_takes_out(bounces: Recording) -> None:
    numbers, times, total = column(bounces, "energy/total", "Scalars:scalars")
    assert numbers.tolist() == [1, 1, 2, 2] and times[0] == times[1], "before and after"
    impacts, before, after = bounces.impacts(), total[::2, 0], total[1::2, 0]
    scale = MASS * GRAVITY * HEIGHT
    assert before - after == pytest.approx(np.asarray(impacts["energy_lost"]), rel=2 * SINGLE)
    assert bounces.energy()["total"][0].as_py() == pytest.approx(before[0], abs=ROUNDING * scale), "level before"
    assert after[0] == pytest.approx(before[1], abs=ROUNDING * scale), "and between two impacts"
    *_, taken = column(bounces, "energy/ledger/restitution", "Scalars:scalars")
    assert taken[:2, 0] == pytest.approx([0.0, (1.0 - RESTITUTION**2) * scale], abs=1e-9 * scale)


def test_spins_before_and_after_an_impact_obey_coulomb(bounces: Recording) -> None:
    _, _, before = column(bounces, "impacts/spins", "before")
    _, _, after = column(bounces, "impacts/spins", "after")
    change = 2.5 * FRICTION * (1.0 + RESTITUTION) * SPEED / RADIUS  # mu J r / I: it slides throughout
    assert before[0] == pytest.approx([0.0, SPIN, 0.0], rel=SINGLE, abs=1e-12)
    assert after[0] == pytest.approx([0.0, SPIN - change, 0.0], rel=1e-6, abs=1e-9)


def test_at_an_impact_nothing_has_a_torque_but_the_ball_an_angular_impulse(bounces: Recording) -> None:
    change = 2.5 * FRICTION * (1.0 + RESTITUTION) * SPEED / RADIUS
    for path, value in (("angular_impulse", 0.4 * MASS * RADIUS**2 * change), ("spin_change", change)):
        numbers, _, found = column(bounces, f"world/{path}", path)
        assert numbers.tolist() == [1, 2] and found[0] == pytest.approx([value], rel=1e-6)
        *_, vectors = column(bounces, f"world/{path}", "Arrows3D:vectors")
        assert vectors[0, 1] < -RADIUS, "against the spin, beyond the surface"
    for path in ("world/torque", "world/angular_acceleration"):
        numbers, table = states_by_number(bounces)[path]
        assert numbers.tolist() == [1, 2] and table["body"].to_pylist() == [[], []], "an empty row clears the view"


def test_a_frame_of_an_impact_shows_that_impact_only(tmp_path: Path) -> None:
    scene = Scene.load("rack-break", ["time.duration=0.0435", "time.max_dt=2e-3"])  # s; several impacts in each step
    recording = carom.run(scene, tmp_path / "rack.rrd")
    impacts, states = recording.impacts(), states_by_number(recording)
    numbers, _ = states["world/bodies"]
    assert len(numbers) > 5 and np.unique(impacts["step"].to_numpy()[numbers - 1]).size < len(numbers)
    every = [{key: impacts[key][int(k) - 1].as_py() for key in ("time", "i", "j")} for k in numbers]
    at_once = [{e for o in impacts.to_pylist() if o["time"] == one["time"] for e in (o["i"], o["j"])} for one in every]
    for path, own in (("torque", "body"), ("angular_impulse", "body"), ("contacts", "bodies")):
        rows, table = states[f"world/{path}"]
        assert rows.tolist() == numbers.tolist(), "each row replaces that of another impact"
        for ends, shown in zip(at_once, table[own].to_pylist(), strict=True):
            assert set(shown) <= ends and (path != "torque" or not shown)
    assert any(row for row in states["world/angular_impulse"][1]["body"].to_pylist())


def test_an_impact_has_the_same_numbers_whatever_the_step(tmp_path: Path) -> None:
    found = []
    for step in (5e-3, 2.5e-3, 1.25e-3):  # s
        scene = Scene.load("two-spheres", [f"time.max_dt={step}", "time.duration=1.7"])
        recording = carom.run(scene, tmp_path / f"{step}.rrd")
        paths = "angular_impulse", "spin_change"
        at_impact = [column(recording, f"world/{path}", path)[2].ravel() for path in paths]
        rows, (step_of_impact,) = RecordedRows(recording), recording.impacts()["step"].to_pylist()
        at_end = [rows.at(f"world/{path}", step_of_impact)[0].batch[path][0].as_py() for path in paths]
        found.append(np.array([at_impact, at_end]))
    assert found[0].shape == (2, 2, 2) and found[0].min() > 0.1
    for other in found[1:]:
        assert other == pytest.approx(found[0], rel=SINGLE)


def test_in_a_crowded_scene_the_largest_impacts_between_two_frames_have_frames(tmp_path: Path) -> None:
    scene = Scene.load("elastic-gas", ["group.0.count=300", "time.duration=1", "record.every=1"])
    recording = carom.run(scene, tmp_path / "gas.rrd")
    numbers, impacts = impacts_by_number(recording)[0], recording.impacts()
    with_frame, times, _ = column(recording, "world/bodies", "Ellipsoids3D:centers")
    assert 3 <= len(with_frame) < len(numbers) / 3, "a few of many"
    has = np.isin(numbers, with_frame)
    impulse = np.asarray(impacts["normal_impulse"])
    assert impulse[has].min() >= impulse[~has].max()
    assert times == pytest.approx(np.asarray(impacts["time"])[has], abs=1e-9)


def test_frames_at_impacts_are_no_rows_of_the_tables(bounces: Recording) -> None:
    assert bounces.energy().num_rows == bounces.frames == 16
    assert np.diff(np.asarray(bounces.fingerprints()["time"])) == pytest.approx(0.1, abs=1e-9)


def test_a_clip_has_the_frames_of_its_impacts_and_is_replayed_with_the_same_bits(
    bounces: Recording, tmp_path: Path
) -> None:
    clip(bounces.path, tmp_path / "clip.rrd", 1.0, 1.5)
    part = Recording.open(tmp_path / "clip.rrd")
    states = states_by_number(part)
    assert sorted(states) == sorted(states_by_number(bounces))
    assert all(set(numbers.tolist()) == {2} for numbers, _ in states.values())
    for recording in (bounces, part):
        result = replay(recording.path)
        assert result.same and not any("states at impacts" in what for what in result.not_compared)


@pytest.mark.slow
def test_spheres_that_meet_across_a_sheared_face_are_drawn_with_the_image_that_they_touch(tmp_path: Path) -> None:
    size, rate = [5.0, 4.0, 6.0], 0.8
    bodies = [  # the first passes through the face along y at 0.2 s, and meets an image of the second after that
        {"position": [0.3, 1.8, 0.1], "velocity": [1.5, 1.0, 0.0], "radius": 0.5},
        {"position": [0.2, -0.4, 0.0], "velocity": [-0.4, -0.2, 0.1], "radius": 0.5},
        {"position": [-1.8, -1.7, 2.0], "velocity": [1.2, -1.0, -1.3], "radius": 0.5},
    ]
    scene = scene_of(
        bodies,
        gravity={"constant": 0.0},
        contact={"restitution": 0.9},
        domain={"boundary": "periodic", "size": size, "shear": {"rate": rate}},
        time={"duration": 12.0},
        record={"every": 1.0, "impacts": "auto"},
    )
    recording = carom.run(scene, tmp_path / "sheared.rrd")
    numbers, times, centres = column(recording, "world/bodies", "Ellipsoids3D:centers")
    edges = column(recording, "world/contacts", "LineStrips3D:strips")[2].reshape(-1, 2, 3)
    table = recording.impacts()
    assert len(numbers) == table.num_rows > 3
    precision = 20.0 * SINGLE * 4.0  # m, of centres in single precision, with the times in nanoseconds
    crossings = 0
    for time, places, edge, i, j in zip(
        times, centres.reshape(-1, 3, 3), edges, table["i"].to_pylist(), table["j"].to_pylist(), strict=True
    ):
        cell = recording.cell(float(time))
        assert cell is not None
        apart = places[j] - places[i]
        assert np.linalg.norm(minimum_images(apart, cell)) == pytest.approx(1.0, abs=precision)
        assert edge[0] == pytest.approx(places[i], abs=precision)
        assert edge[1] - edge[0] == pytest.approx(minimum_images(apart, cell), abs=precision)
        crossings += abs(apart[1]) > 0.5 * size[1]
    assert crossings > 0, "an impact across the face"
