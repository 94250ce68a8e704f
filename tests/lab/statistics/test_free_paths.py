"""Free times and free paths of bodies whose paths are known in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Recording
from carom.errors import RecordingError
from carom.lab.statistics.impact_statistics import measure_free_paths, paths_of
from carom.lab.statistics.interval import Interval
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


def test_a_run_without_impacts_says_so_in_a_sentence(tmp_path: Path) -> None:
    apart: list[dict[str, Any]] = [
        {"radius": 0.5, "mass": 1.0, "position": [x, 0, 0], "velocity": [x, 0, 0]} for x in (-1.0, 1.0)
    ]
    interval = interval_of(scene_of(apart, time={"duration": 1.0, "fixed_dt": 0.5}, **FLIGHT), tmp_path)
    with pytest.raises(RecordingError, match=r"^there are no impacts from 0 to 1 s$"):
        measure_free_paths(interval)
