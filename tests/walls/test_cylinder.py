"""A cylinder with bodies inside: closed solutions of bounces and of rolling, and what cannot be combined with walls."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Scene, Space
from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.schedule import every

R, r = 1.0, 0.1  # m, of the cylinder and of the ball
G = 9.81  # m/s²
SMOOTH = {"restitution": 1.0, "static_friction": 0.0, "kinetic_friction": 0.0}
ROUGH = {"restitution": 0.0, "static_friction": 10.0, "kinetic_friction": 10.0}
HEAVY = {"constant": 0.0, "uniform": [0.0, 0.0, -G]}
WEIGHTLESS = {"constant": 0.0}


def drum(contact: dict[str, Any], gravity: dict[str, Any], duration: float, **body: Any) -> Scene:
    """Return a ball in a cylinder along y."""
    return Scene.from_dict(
        {
            "contact": contact,
            "gravity": gravity,
            "wall": [{"name": "drum", "cylinder": {"radius": R, "axis": [0, 1, 0]}}],
            "body": [{"radius": r} | body],
            "time": {"duration": duration},
        }
    )


def bounces(x: FloatArray, v: FloatArray, duration: float) -> FloatArray:
    """Return where a point that bounces elastically in the circle ρ = R - r is at the end; y is along the axis."""
    around = np.array([1.0, 0.0, 1.0])
    while True:
        u, p = v * around, x * around
        b, c = p @ u, p @ p - (R - r) ** 2
        t = (-b + math.sqrt(b * b - (u @ u) * c)) / (u @ u)
        if t > duration:
            return x + v * duration
        x, duration = x + v * t, duration - t
        n = x * around / np.linalg.norm(x * around)
        v = v - 2.0 * (v @ n) * n


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_elastic_bounces_follow_the_closed_solution_and_keep_energy_and_angular_momentum() -> None:
    x, v = np.array([0.3, 0.0, -0.2]), np.array([0.7, 0.1, 1.1])
    space = Space(drum(SMOOTH, WEIGHTLESS, 20.0, position=x.tolist(), velocity=v.tolist()))
    for _ in space.run():
        pass
    end = space.state
    # some 15 bounces, each of which has a few roundings of a speed of 1 m/s; they grow in proportion to the time
    assert np.abs(end.position[0] - bounces(x, v, 20.0)).max() < 1e-12
    turning = end.position[0, 2] * end.velocity[0, 0] - end.position[0, 0] * end.velocity[0, 2]
    assert turning == pytest.approx(x[2] * v[0] - x[0] * v[2], rel=1e-13)
    assert end.velocity[0] @ end.velocity[0] == pytest.approx(v @ v, rel=1e-13)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_elastic_bounces_under_gravity_keep_the_energy() -> None:
    space = Space(drum(SMOOTH, HEAVY, 5.0, position=[0.5, 0.0, 0.3], velocity=[0.0, 0.3, 0.0]))
    errors = [abs(frame.energy.integration_error) / frame.energy.scale for frame in space.run()]
    assert max(errors) < 1e-12  # parabolas and their impacts are exact: only rounding, of some 40 impacts
    assert np.hypot(*space.state.position[0, [0, 2]]) < R - r + 1e-9


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_rolling_ball_oscillates_with_the_period_of_the_closed_solution() -> None:
    angle = 0.05
    start = [(R - r) * math.sin(angle), 0.0, -(R - r) * math.cos(angle)]
    space = Space(drum(ROUGH, HEAVY, 7.0, position=start))
    x = [(frame.time, frame.position[0, 0]) for frame in space.run()]
    crossings = [t + (u - t) * a / (a - b) for (t, a), (u, b) in pairwise(x) if a > 0.0 >= b]
    # a rolling sphere is a pendulum of the length 7/5 (R - r); the amplitude makes it slower by angle²/16
    period = 2.0 * math.pi * math.sqrt(7.0 / 5.0 * (R - r) / G) * (1.0 + angle * angle / 16.0)
    assert np.diff(crossings) == pytest.approx(period, rel=1e-4)  # the steps are 400 a period, of second order
    assert max(position for t, position in x if t > 2.0 * period) > 0.998 * start[0]


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_fast_ball_rolls_around_the_inside_without_losing_contact() -> None:
    speed = 1.2 * math.sqrt(27.0 / 7.0 * G * (R - r))  # at the bottom; the least one that stays at the top is 1/1.2
    rolling = {"velocity": [speed, 0, 0], "angular_velocity": [0, speed / r, 0]}
    space = Space(drum(ROUGH, HEAVY, 1.5, position=[0, 0, -(R - r)], **rolling))
    heights, energies = [], []
    for frame in space.run(schedule=every(0.0)):
        heights.append(frame.position[0, 2])
        energies.append(frame.energy.translational + frame.energy.rotational + frame.energy.field)
        assert np.hypot(*frame.position[0, [0, 2]]) == pytest.approx(R - r, abs=1e-4)
    assert max(heights) > 0.99 * (R - r)
    assert energies[-1] == pytest.approx(energies[0], rel=1e-3)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_ball_at_the_bottom_stays_at_rest() -> None:
    space = Space(drum(ROUGH, HEAVY, 1.0, position=[0, 0, -(R - r)]))
    for _ in space.run():
        pass
    assert np.abs(space.state.position[0] - [0, 0, -(R - r)]).max() < 1e-12


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_run_is_recorded_replayed_and_shows_the_wall(tmp_path: Path) -> None:
    file = tmp_path / "drum.rrd"
    carom.run(drum(ROUGH, HEAVY, 0.5, position=[0.5, 0.0, 0.0]), file)
    assert carom.replay(file).same
    shown = carom.Recording.open(file)
    mesh = np.asarray(shown._entities.static("world/shapes")["Mesh3D:vertex_positions"]).reshape(-1, 3)
    corners = mesh + np.asarray(shown.info["origin"])
    assert np.hypot(corners[:, 0], corners[:, 2]) == pytest.approx(R, rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        (
            {
                "time": {"duration": 1.0, "accuracy": 1e-6},
                "wall": [{"cylinder": {"radius": 1.0}, "motion": {"rotation": 1.0}}],
            },
            "time.accuracy",
        ),
        ({"time": {"duration": 1.0, "integrator": "gauss-radau15"}}, "gauss-radau15"),
        ({"drag": {"relaxation_time": 1.0}}, "drag"),
        ({"contact": {"sleep": {"speed": 0.1}}}, "contact.sleep"),
        ({"contact": {"enabled": False}}, "contact.enabled"),
        ({"domain": {"boundary": "periodic", "size": [3, 3, 3]}, "gravity": WEIGHTLESS}, "space repeats along"),
        ({"wall": [{"cylinder": {"radius": 1.0, "axis": [0, 0, 0]}}]}, "direction"),
        ({"wall": [{"name": "drum"}]}, "no shape"),
        ({"wall": [{"cylinder": {"radius": 0.05}}]}, "cylinder 0"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_walls_cannot_be_combined_with_is_refused(changes: dict[str, Any], key: str) -> None:
    whole = {
        "contact": ROUGH,
        "gravity": HEAVY,
        "wall": [{"cylinder": {"radius": R}}],
        "body": [{"radius": r}],
        "time": {"duration": 1.0},
    }
    with pytest.raises(SceneError, match=key):
        Space(Scene.from_dict(whole | changes))
