"""Walls of all shapes: bounces off surfaces, edges and corners have their closed solutions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from carom import Scene, Space
from carom.arrays import FloatArray
from carom.errors import SceneError

r, G, HEIGHT = 0.1, 9.81, 2.0  # m, of the ball; m/s²; m, from which it falls
SMOOTH = {"restitution": 1.0, "static_friction": 0.0, "kinetic_friction": 0.0}
DOWN = np.array([0.0, 0.0, -G])
FUNNEL = {"cone": {"radius": 0.2, "end_radius": 1.2, "height": 1.0}}  # at 45°
PLATE = {"rectangle": {"side": [2, 0, 0], "other_side": [0, 2, 0]}}
LOW = math.sqrt(r * r - 0.05 * 0.05)  # m, height of a centre 0.05 m beside an edge that the ball touches


def end_of(wall: dict[str, Any], duration: float, gravity: FloatArray = DOWN, **body: Any) -> Space:
    """Run a ball and a wall to the end."""
    scene = Scene.from_dict(
        {
            "contact": SMOOTH,
            "gravity": {"constant": 0.0, "uniform": gravity.tolist()},
            "wall": [wall],
            "body": [{"radius": r} | body],
            "time": {"duration": duration},
        }
    )
    space = Space(scene)
    for _ in space.run():
        pass
    return space


@pytest.mark.slow  # kernels for walls are compiled for a minute
@pytest.mark.parametrize(
    ("wall", "x", "y", "touching", "normal"),
    [
        (FUNNEL, 0.7, 0.0, 0.5 + math.sqrt(2.0) * r, (-math.sqrt(0.5), 0.0, math.sqrt(0.5))),
        ({"disc": {"radius": 1.0}}, 0.5, 0.3, r, (0.0, 0.0, 1.0)),
        ({"disc": {"radius": 1.0}}, 1.05, 0.0, LOW, (0.5, 0.0, LOW / r)),
        (PLATE, 0.5, -0.3, r, (0.0, 0.0, 1.0)),
        (PLATE, 0.3, -1.05, LOW, (0.0, -0.5, LOW / r)),
        (PLATE, 1.03, 1.04, LOW, (0.3, 0.4, LOW / r)),
    ],
    ids=["cone", "disc", "edge of a disc", "rectangle", "edge of a rectangle", "corner of a rectangle"],
)
def test_a_ball_that_falls_on_a_wall_bounces_at_the_time_and_along_the_normal_of_the_closed_solution(
    wall: dict[str, Any], x: float, y: float, touching: float, normal: tuple[float, ...]
) -> None:
    fall, after, n = math.sqrt(2.0 * (HEIGHT - touching) / G), 0.05, np.array(normal)
    speed = DOWN * fall
    speed = speed - 2.0 * (speed @ n) * n
    expected = np.array([x, y, touching]) + speed * after + 0.5 * DOWN * after * after
    space = end_of(wall, fall + after, position=[x, y, HEIGHT])
    assert np.abs(space.state.position[0] - expected).max() < 1e-12  # one impact: only rounding


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_bounces_in_a_sphere_keep_energy_and_angular_momentum() -> None:
    x, v = np.array([0.3, -0.1, 0.2]), np.array([0.7, 0.4, -1.1])
    hollow = {"sphere": {"radius": 1.0}}
    state = end_of(hollow, 10.0, 0.0 * DOWN, position=x.tolist(), velocity=v.tolist()).state
    assert np.cross(state.position[0], state.velocity[0]) == pytest.approx(np.cross(x, v), rel=1e-12)
    assert state.velocity[0] @ state.velocity[0] == pytest.approx(v @ v, rel=1e-13)
    assert np.linalg.norm(state.position[0]) < 0.9 + 1e-12


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_ball_runs_through_a_funnel() -> None:
    space = end_of(FUNNEL, 3.0, position=[0.7, 0.2, 1.0])
    assert space.state.position[0, 2] < -1.0
    assert abs(space.state.position[0]).max() < 100.0


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_ball_passes_beside_a_disc_and_bounces_off_its_lower_side() -> None:
    plate = {"disc": {"radius": 1.0}}
    beside = end_of(plate, 1.0, position=[1.1 + 1e-9, 0.0, HEIGHT])
    assert beside.state.position[0, 2] == pytest.approx(HEIGHT - 0.5 * G, rel=1e-12)
    below = end_of(plate, 1.0, 0.0 * DOWN, position=[0.0, 0.0, -0.6], velocity=[0.0, 0.0, 1.0])
    assert below.state.position[0, 2] == pytest.approx(-r - 0.5, rel=1e-12)


def test_late_impacts_are_refused_at_thin_walls_which_they_would_pass() -> None:
    late = {"contact": {"timing": "end-of-step"}, "body": [{"radius": r, "position": [0, 0, 1]}]}
    with pytest.raises(SceneError, match="end-of-step"):
        Space(Scene.from_dict({"gravity": {"constant": 0.0, "uniform": [0, 0, -1]}, "wall": [PLATE]} | late))
