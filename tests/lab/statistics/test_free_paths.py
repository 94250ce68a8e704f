"""Free times and free paths of bodies whose paths are known in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Recording
from carom.errors import RecordingError
from carom.lab.statistics import Interval
from carom.lab.statistics.motion_statistics import measure_free_paths, measure_impacts, measure_stress, paths_of
from carom.scene.schema import Scene
from small_scenes import scene_of

FLIGHT = {"gravity": {"constant": 0.0}, "contact": {"restitution": 1.0, "static_friction": 0.0}}
SINGLE = 1e-6  # drawn positions are float32


def interval_of(scene: Scene, folder: Path) -> Interval:
    """Record a run and return all of it."""
    carom.run(scene, folder / "run.rrd")
    return Interval.of(Recording.open(folder / "run.rrd"), None, None, False, lambda _: None)


def test_a_ball_between_two_walls_flies_the_distance_of_the_walls_less_its_diameter(tmp_path: Path) -> None:
    ball = {"radius": 0.5, "mass": 1.0, "velocity": [1.0, 0.0, 0.0]}
    walls = {"boundary": "walls", "size": [4.0, 4.0, 4.0]}
    interval = interval_of(
        scene_of([ball], domain=walls, time={"duration": 11.0, "fixed_dt": 0.25}, **FLIGHT), tmp_path
    )
    paths = paths_of(interval)
    assert paths.free_times == pytest.approx([3.0] * 3, rel=SINGLE)  # impacts at 1.5, 4.5, 7.5 and 10.5 s
    assert paths.free_paths == pytest.approx([3.0] * 3, rel=SINGLE)
    assert paths.length == pytest.approx(11.0, rel=SINGLE)
    mean = measure_free_paths(interval).values
    assert mean["mean_free_time"].value == mean["mean_free_path"].value == pytest.approx(11.0 / 4, rel=SINGLE)


def test_a_path_through_the_faces_of_a_periodic_box_is_longer_than_half_the_box(tmp_path: Path) -> None:
    # equal balls exchange their velocities: one flies 6 m - 2 m from one side of the other to its other side, then the
    # other does, and each waits while the other flies
    resting: dict[str, Any] = {"radius": 0.5, "mass": 1.0}
    moving = {"radius": 0.5, "mass": 1.0, "position": [-2.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0]}
    balls = [resting, moving]
    box = {"boundary": "periodic", "size": [6.0, 6.0, 6.0]}
    interval = interval_of(scene_of(balls, domain=box, time={"duration": 14.0, "fixed_dt": 0.25}, **FLIGHT), tmp_path)
    paths = paths_of(interval)
    assert paths.free_times == pytest.approx([4.0] * 6, rel=SINGLE)
    assert np.sort(paths.free_paths) == pytest.approx([0.0] * 3 + [4.0] * 3, rel=SINGLE, abs=SINGLE)
    assert paths.length == pytest.approx(14.0, rel=SINGLE)


def test_statistics_of_impacts_say_how_many_are_missing_from_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    walls = {"boundary": "walls", "size": [4.0, 4.0, 4.0]}
    ball = {"radius": 0.5, "mass": 1.0, "velocity": [1.0, 0.0, 0.0]}
    interval = interval_of(scene_of([ball], domain=walls, time={"duration": 4.0, "fixed_dt": 0.5}, **FLIGHT), tmp_path)
    assert "impacts" not in measure_impacts(interval).note + measure_stress(interval).note
    monkeypatch.setitem(vars(interval), "impacts_left_out", 7)
    for measure in (measure_impacts, measure_stress, measure_free_paths):
        note = measure(interval).note
        assert "7" in note and "not recorded" in note and "--replay" in note
    assert measure_impacts(interval).values["impact_rate"].label == "recorded impacts"


def test_a_run_without_impacts_says_so_in_a_sentence(tmp_path: Path) -> None:
    apart: list[dict[str, Any]] = [
        {"radius": 0.5, "mass": 1.0, "position": [x, 0, 0], "velocity": [x, 0, 0]} for x in (-1.0, 1.0)
    ]
    interval = interval_of(scene_of(apart, time={"duration": 1.0, "fixed_dt": 0.5}, **FLIGHT), tmp_path)
    with pytest.raises(RecordingError, match=r"^there are no impacts from 0 to 1 s$"):
        measure_free_paths(interval)


class SoftBounces:
    """Another engine's ball between two planes 4 m apart, at 1 m/s; each bounce takes two of its steps of 0.1 s."""

    planes = (carom.record.Plane((1.0, 0.0, 0.0), -2.0), carom.record.Plane((-1.0, 0.0, 0.0), -2.0))

    def __init__(self) -> None:
        self.model = carom.record.Model(engine="soft", mass=[2.0], radius=[0.5], planes=list(self.planes))
        self.step = 0

    def state(self) -> carom.record.State:
        flights, along = divmod(self.step, 31)  # 30 steps of flight, and a step at rest at the plane
        to_right = flights % 2 == 0
        x = -1.5 + 0.1 * along if to_right else 1.5 - 0.1 * along
        turns = along == 30 or (along == 0 and flights > 0)
        velocity = 0.0 if along == 30 else 1.0 if to_right else -1.0
        contacts = np.zeros(int(turns), carom.record.CONTACT)
        at_right = x > 0.0
        contacts["i"], contacts["j"] = 0, 2 if at_right else 1
        contacts["point"], contacts["normal"] = [2.0 if at_right else -2.0, 0, 0], [1.0 if at_right else -1.0, 0, 0]
        contacts["force"] = 20.0  # N, two steps of it turn 2 kg m/s
        return carom.record.State(0.1 * self.step, [[x, 0.0, 0.0]], [[velocity, 0.0, 0.0]], contacts=contacts)


def test_a_bounce_of_another_engine_that_takes_two_steps_is_one_impact(tmp_path: Path) -> None:
    ball = SoftBounces()
    with carom.record.Recorder(ball, tmp_path / "run.rrd") as recorder:
        for ball.step in range(1, 125):
            recorder.frame()
    assert recorder.problems == []
    interval = Interval.of(Recording.open(tmp_path / "run.rrd"), None, None, False, lambda _: None)
    impacts = interval.impacts
    assert impacts.step.tolist() == [30, 61, 92, 123] and impacts.j.tolist() == [2, 1, 2, 1]
    assert impacts.speed == pytest.approx([1.0] * 4, rel=1e-12)  # of the exact states
    paths = paths_of(interval)
    assert paths.free_times == pytest.approx([3.1] * 3, rel=1e-12) and paths.free_paths == pytest.approx([3.0] * 3)
