"""Orientations of balls that contacts spin up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carom import Scene, Space
from carom.arrays import FloatArray
from carom.physics.schedule import every

r = 0.1  # m


def turned(time: dict[str, Any], field: list[float], velocity: list[float], mu: float) -> tuple[FloatArray, FloatArray]:
    """Return the angles (rad) by which a ball on a floor has turned in each step, and its positions along x (m)."""
    document = {
        "body": [{"radius": r, "position": [0.0, 0.0, r], "velocity": velocity}],
        "plane": [{"normal": [0.0, 0.0, 1.0]}],
        "contact": {"restitution": 0.0, "static_friction": mu, "kinetic_friction": mu},
        "gravity": {"constant": 0.0, "uniform": field},
        "time": time,
    }
    frames = list(Space(Scene.from_dict(document)).run(schedule=every(0.0)))
    turns = Rotation.from_quat([frame.orientation[0] for frame in frames if frame.orientation is not None])
    angles = np.append(0.0, np.cumsum((turns[1:] * turns[:-1].inv()).as_rotvec()[:, 1]))
    return angles, np.array([frame.position[0, 0] for frame in frames])


@pytest.mark.parametrize("time", [{}, {"fixed_dt": 4e-3}, {"fixed_dt": 1e-3}], ids=["default", "4 ms", "1 ms"])
def test_a_ball_that_rolls_down_an_incline_has_turned_by_its_path_over_its_radius(time: dict[str, Any]) -> None:
    angles, path = turned({"duration": 0.3} | time, [2.0, 0.0, -9.81], [0.0, 0.0, 0.0], 0.5)
    assert path[-1] == pytest.approx(5.0 / 14.0 * 2.0 * 0.3**2, rel=1e-12)  # 5/7 of the field along the slope
    # steps that start at rest, hold and release differ by nothing but rounding; before, by 0.012 rad at the default
    assert angles == pytest.approx(path / r, abs=1e-12)


def test_a_ball_that_starts_to_slide_turns_by_half_its_angular_acceleration_times_the_time_squared() -> None:
    mu, g, duration = 0.1, 9.81, 0.2
    angles, _ = turned({"duration": duration, "fixed_dt": 2e-3}, [0.0, 0.0, -g], [1.0, 0.0, 0.0], mu)
    assert angles[-1] == pytest.approx(2.5 * mu * g / r * duration**2 / 2.0, rel=1e-10)
