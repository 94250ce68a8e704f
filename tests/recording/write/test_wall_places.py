"""Planes and walls that move are drawn where the physics has them, and contacts are on them."""

from pathlib import Path

import numpy as np
import pytest

import carom
from carom.recording.layout.canvas import surroundings
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.paths import MOVING
from carom.recording.timelines import STEP
from carom.recording.write.wall_places import MovingWall, moving_walls
from carom.scene.load import Scene
from carom.scene.schema.motion import WallMotion


def floor(motion: dict[str, object]) -> Scene:
    """A ball that bounces on a floor, which moves, beside a plane at rest."""
    return Scene.from_dict(
        {
            "time": {"duration": 0.3, "max_dt": 0.005},
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            "plane": [
                {"name": "wall", "normal": [1.0, 0.0, 0.0], "point": [-3.0, 0.0, 0.0]},
                {"name": "floor", "motion": motion},
            ],
            "body": [{"position": [0.0, 0.0, 0.25], "radius": 0.1, "mass": 1.0}],
        }
    )


def drawn(recording: Recording, path: str) -> tuple[list[int], np.ndarray]:
    """Return the steps and the translations of a plane at the frames."""
    chunks = list(recording._entities.chunks(path))
    steps = [int(step) for chunk in chunks for step in chunk.batch[STEP].to_pylist()]
    rows = [row[0] for chunk in chunks for row in chunk.batch["Transform3D:translation"].to_pylist()]
    return steps, np.array(rows)


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    motion = {"velocity": [5.0, 0.0, 0.1], "amplitude": [0.0, 0.0, 0.02], "frequency": 4.0, "phase": 1.0}
    return carom.run(floor(motion), tmp_path_factory.mktemp("shaken") / "shaken.rrd")


@pytest.mark.slow
def test_a_plane_that_moves_is_drawn_where_it_is_in_every_frame(shaken: Recording) -> None:
    steps, shift = drawn(shaken, f"{MOVING}/plane-1")
    table = shaken.fingerprints()
    assert steps == table[STEP].to_pylist()
    times = table["time"].to_numpy()
    expected = 0.1 * times + 0.02 * np.sin(2.0 * np.pi * 4.0 * times + 1.0)
    np.testing.assert_allclose(shift[:, 2], expected, atol=1e-8)  # float32
    assert not shift[:, :2].any(), "an infinite plane is where it was if it slides along itself"
    assert not list(shaken._entities.chunks(f"{MOVING}/plane-0")), "one at rest has no transforms"


@pytest.mark.slow
def test_at_an_impact_the_plane_is_at_the_contact_point(shaken: Recording) -> None:
    impact = shaken.impacts().to_pylist()[0]
    entries = [e for e in shaken.store.entries if e.entity_path == f"{MOVING}/plane-1" and e.is_within_steps]
    (chunk,) = shaken.chunks(entries)
    (first,) = chunk.batch["Transform3D:translation"][0].as_py()
    assert first[2] == pytest.approx(impact["z"], abs=1e-7)


@pytest.mark.slow
def test_views_show_the_planes_that_move_in_place_of_those_at_rest(shaken: Recording) -> None:
    header = header_of_recording(shaken)
    assert surroundings(header) == [f"{MOVING}/**"]


def test_scenes_without_moving_walls_have_no_further_entities(tmp_path: Path) -> None:
    recording = carom.run(Scene.load("bouncing-ball", ["time.duration=0.01"]), tmp_path / "still.rrd")
    assert not any(entry.entity_path.startswith(MOVING) for entry in recording.store.entries)
    assert surroundings(header_of_recording(recording)) == [paths.PLANES]
    assert not moving_walls(header_of_recording(recording))


@pytest.mark.slow
def test_a_replay_of_a_run_with_a_moving_plane_has_the_same_bits(shaken: Recording) -> None:
    assert carom.replay(shaken.path).same


def test_a_wall_rotates_about_its_axis_by_its_angular_velocity() -> None:
    axis = np.array([0.3, 0.2, 0.1]), np.array([0.0, 1.0, 0.0])
    wall = MovingWall(WallMotion(rotation=2.0), axis=axis)
    times = np.array([0.0, 0.4, 7.0])
    turns = wall.turns(times)
    np.testing.assert_allclose(np.sum(turns * turns, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(turns[:, 1], np.sin(times), atol=1e-12)
    np.testing.assert_allclose(turns[:, 3], np.cos(times), atol=1e-12)


def test_a_wall_is_drawn_where_velocities_that_change_at_given_times_have_moved_it() -> None:
    changing = WallMotion(times=(0.1, 0.5, 0.9), velocities=((1.0, 0.0, 0.0), (0.0, 0.0, 2.0), (0.0, 0.0, 0.0)))
    time = np.linspace(0.0, 1.3, 14)
    begun = np.maximum(time - 0.1, 0.0), np.maximum(time - 0.5, 0.0), np.maximum(time - 0.9, 0.0)
    expected = np.stack((begun[0] - begun[1], np.zeros(14), 2.0 * (begun[1] - begun[2])), axis=1)
    assert changing.displacement(time) == pytest.approx(expected, abs=1e-12)
    assert changing.displacement(0.7) == pytest.approx([0.4, 0.0, 0.4], abs=1e-12)
    along_x = changing.displacement(time, np.array([1.0, 0.0, 0.0]))  # a drawn plane moves only along its normal
    assert along_x == pytest.approx(expected * [1.0, 0.0, 0.0], abs=1e-12)
