"""`Recording.trajectory` and `Recording.bodies`, on short runs of a real scene."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import carom
from carom.errors import RecordingError
from carom.physics.space import Space
from carom.recording.edit.clip import clip
from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from carom.state.frame import Frame
from small_scenes import scene_of

FLOAT32 = 2.0**-23  # rounding of a float32, relative


def scene() -> Scene:
    balls = [
        {"name": "left", "position": [-2.0, 0.1, 0.0], "velocity": [1.0, 0.0, 0.0], "angular_velocity": [0, 0, 3.0]},
        {"name": "right", "position": [2.0, 0.0, 0.0], "velocity": [-1.0, 0.0, 0.0]},
        {"name": "far", "position": [0.0, 9.0, 0.0]},
        {"name": "far", "position": [0.0, -9.0, 0.0]},
    ]
    return scene_of(
        [{"radius": 0.5, "mass": 1.0, **ball} for ball in balls],
        gravity={"constant": 0.0},
        time={"duration": 4.0, "fixed_dt": 0.01},
        record={"every": 0.1},
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A run of 400 steps, of which every tenth is recorded."""
    return carom.run(scene(), tmp_path_factory.mktemp("run") / "run.rrd")


@pytest.fixture(scope="module")
def steps() -> list[Frame]:
    """All steps of it."""

    def every_step() -> Iterator[Frame]:
        yield from Space(scene()).run(schedule=lambda step, before, time: True)

    return list(every_step())


def vectors(table: pa.Table, names: str) -> np.ndarray:
    return np.stack([table[name].to_numpy() for name in names.split()], axis=1)


def test_a_trajectory_has_each_frames_position_within_the_rounding_of_float32(
    recording: Recording, steps: list[Frame]
) -> None:
    path = recording.trajectory("left")
    exact = np.array([steps[step].position[0] for step in path["step"].to_pylist()])
    assert path.num_rows == recording.frames
    assert np.abs(vectors(path, "x y z") - exact).max() <= 2.0 * FLOAT32 * 10.0  # coordinates up to 10 m


def test_the_trajectories_of_all_bodies_are_those_of_each(recording: Recording) -> None:
    paths = recording.trajectories()
    assert paths.position.shape == (recording.frames, 4, 3) and paths.body.tolist() == [0, 1, 2, 3]
    for body in range(4):
        path = recording.trajectory(body)
        assert np.array_equal(vectors(path, "x y z"), paths.position[:, body])
        assert np.array_equal(vectors(path, "vx vy vz"), paths.vectors["velocity"][:, body], equal_nan=True)
    assert np.array_equal(path["exact"].to_numpy(), paths.exact) and np.array_equal(path["time"], paths.time)
    some = recording.trajectories(["right", 0], 1.0, 2.0)
    inside = (paths.time >= 1.0 - 1e-9) & (paths.time <= 2.0 + 1e-9)
    assert np.array_equal(some.position, paths.position[inside][:, [1, 0]]) and some.body.tolist() == [1, 0]


def test_the_trajectories_of_a_rerun_have_all_quantities_at_every_frame(
    recording: Recording, steps: list[Frame]
) -> None:
    paths = carom.rerun(recording, 0.0).trajectories()
    assert paths.exact.all() and len(paths.step) == recording.frames
    frames = [steps[step] for step in paths.step.tolist()]
    for name in ("position", "velocity", "angular_velocity", "torque", "angular_acceleration"):
        assert np.array_equal(paths.vectors[name], [getattr(frame, name) for frame in frames]), name
    kinetic = [frame.energy.translational for frame in frames]
    assert np.allclose(paths.vectors["kinetic_energy"].sum(axis=(1, 2)), kinetic, rtol=1e-14), "order of the sum"
    rotational = [frame.energy.rotational for frame in frames]
    assert np.allclose(paths.vectors["rotational_energy"].sum(axis=(1, 2)), rotational, rtol=1e-14)


def test_a_trajectory_has_the_exact_state_at_checkpoints_and_nulls_elsewhere(
    recording: Recording, steps: list[Frame]
) -> None:
    path = recording.trajectory(1)
    at = np.flatnonzero(path["exact"].to_numpy())
    assert [path["step"][int(k)].as_py() for k in at] == recording.checkpoint_steps
    for row in path.take(at).to_pylist():
        frame = steps[row["step"]]
        assert [row["x"], row["y"], row["z"]] == frame.position[1].tolist()
        assert [row["vx"], row["vy"], row["vz"]] == frame.velocity[1].tolist()
    others = path.filter(pa.array(~path["exact"].to_numpy()))
    assert others.num_rows
    assert others["vx"].null_count == others.num_rows


def test_a_replayed_trajectory_has_the_bits_of_the_run(recording: Recording, steps: list[Frame]) -> None:
    with pytest.raises(RecordingError, match="the rerun begins at step"):
        carom.rerun(recording, 4.1).trajectory("left", 1.0, 2.0)
    path = carom.rerun(recording, 1.0).trajectory("left", 1.0, 2.0)
    own = [steps[step] for step in path["step"].to_pylist()]
    assert path.num_rows == 11
    assert np.array_equal(vectors(path, "x y z"), [frame.position[0] for frame in own])
    assert np.array_equal(vectors(path, "wx wy wz"), [frame.angular_velocity[0] for frame in own])
    assert path["exact"].to_numpy().all()
    assert b"with the same bits" in path.schema.metadata[b"source"]


@pytest.mark.parametrize(("at", "step"), [(0.0, 0), (1.504, 151), (1.5, 150), (4.0, 400)])
def test_bodies_have_the_exact_state_at_the_end_of_the_step_that_a_time_is_in(
    recording: Recording, steps: list[Frame], at: float, step: int
) -> None:
    states = carom.rerun(recording, at).bodies(at)
    assert states.schema.metadata[b"step"] == str(step).encode()
    assert np.array_equal(vectors(states, "x y z"), steps[step].position)
    assert np.array_equal(vectors(states, "vx vy vz"), steps[step].velocity)
    assert states["name"].to_pylist() == ["left", "right", "far", "far"]


def test_bodies_say_whether_they_are_from_a_checkpoint_or_a_replay(recording: Recording) -> None:
    assert recording.bodies(4.0).schema.metadata[b"source"] == b"checkpoint"
    with pytest.raises(RecordingError, match=r"does not hold the exact state .* 1\.504 s; carom.rerun computes it"):
        recording.bodies(1.504)
    assert b"replayed from step" in carom.rerun(recording, 1.504).bodies(1.504).schema.metadata[b"source"]


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("lfet", r'has no body "lfet"; did you mean "left"\? Its bodies are 0 to 3'),
        ("far", r'2 bodies called "far"; give a number'),
        (4, r'has no body "4"; its bodies are 0 to 3, called "left", "right", "far", "far"'),
        (-1, r'has no body "-1"'),
    ],
)
def test_a_body_that_is_not_there_is_named_beside_those_that_are(
    recording: Recording, body: int | str, message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        recording.trajectory(body)


def test_a_moment_outside_the_recording_is_refused(recording: Recording, tmp_path: Path) -> None:
    for at in (7.0, 4.05, -0.05):
        with pytest.raises(RecordingError, match=rf"covers 0 to 4 s; {at:g} s is outside"):
            recording.bodies(at)
    clip(recording.path, tmp_path / "one.rrd", 2.0, 2.0)
    one = Recording.open(tmp_path / "one.rrd")
    assert one.frames == 1 and one.moment(1.995) == 1.995, "the step to the frame"
    for at in (1.98, 2.01, 1e9):
        with pytest.raises(RecordingError, match="is outside"):
            one.moment(at)


def test_a_number_is_a_body_even_where_another_has_it_as_its_name(tmp_path: Path) -> None:
    balls = [{"name": name, "position": [3.0 * k, 0.0, 0.0]} for k, name in enumerate(("two", "1", "0"))]
    named = carom.run(scene_of(balls, gravity={"constant": 0.0}, time={"duration": 0.1}), tmp_path / "named.rrd")
    assert [named.trajectory(body)["x"][0].as_py() for body in ("0", "#0", 0, "1", "#2")] == [6.0, 0.0, 0.0, 3.0, 6.0]


def test_a_clip_has_the_trajectories_of_the_bodies_that_it_shows(recording: Recording, tmp_path: Path) -> None:
    clip(recording.path, tmp_path / "clip.rrd", 0.95, 2.05, bodies=[1])
    piece = Recording.open(tmp_path / "clip.rrd")
    whole = recording.trajectory("right", 0.95, 2.05)
    assert piece.trajectory("right")["step"].to_pylist() == whole["step"].to_pylist()
    with pytest.raises(RecordingError, match="does not contain body 0"):
        piece.trajectory("left")
