"""Balls that roll on curved walls and spin about the normal, against the equations of rolling without slip."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from carom import Scene, Space
from carom.arrays import FloatArray
from carom.physics.schedule import every
from rolling_balls import AT_REST, Turning, in_cone, in_cylinder, in_sphere, rolling_without_slip

R, r = 1.0, 0.1  # m, of the wall and of the ball
G = np.array([0.0, 0.0, -9.81])  # m/s²
INSIDE = R - r
SLOPE, CONE = math.radians(30.0), math.radians(40.0)  # of the tube's axis from the vertical, and of the cone's surface
TILTED = np.array([math.sin(SLOPE), 0.0, math.cos(SLOPE)])
LEVEL = np.array([math.cos(SLOPE), 0.0, -math.sin(SLOPE)])  # across the tube's axis
UPWARDS = np.array([math.sin(CONE), 0.0, math.cos(CONE)])  # along the cone
POLAR = 0.8  # rad, of the ball in the bowl from its bottom
IN_BOWL = INSIDE * np.array([math.sin(POLAR), 0.0, -math.cos(POLAR)])
BOWL_SPEED = np.array([0.3 * math.cos(POLAR), 2.0, 0.3 * math.sin(POLAR)])
FUNNEL = {"radius": 0.0, "end_radius": 4.0 * math.tan(CONE), "height": 4.0}
ON_FUNNEL = UPWARDS / math.sin(CONE) + r * np.array([-math.cos(CONE), 0.0, math.sin(CONE)])
HORIZONTAL = np.array([0.0, 1.0, 0.0])
DURATION = 0.2  # s

# wall, equations, position (m), velocity (m/s), spin about the normal (rad/s), angular velocity of the wall (rad/s)
Case = tuple[dict[str, Any], Turning, FloatArray, FloatArray, float, FloatArray]
CASES: dict[str, Case] = {
    "bowl": ({"sphere": {"radius": R}}, in_sphere(INSIDE), IN_BOWL, BOWL_SPEED, 30.0, AT_REST),
    "upright tube": (
        {"cylinder": {"radius": R}},
        *(in_cylinder(np.array([0.0, 0.0, 1.0]), INSIDE), np.array([INSIDE, 0.0, 0.0]), 4.0 * HORIZONTAL, -40.0),
        AT_REST,
    ),
    "tilted tube": (
        {"cylinder": {"radius": R, "axis": TILTED.tolist()}},
        *(in_cylinder(TILTED, INSIDE), INSIDE * LEVEL, 6.0 * HORIZONTAL + 0.5 * TILTED, 30.0, AT_REST),
    ),
    "cone": ({"cone": FUNNEL}, in_cone(CONE), ON_FUNNEL, 3.0 * HORIZONTAL + 0.5 * UPWARDS, 25.0, AT_REST),
    "rotating bowl": (
        {"sphere": {"radius": R, "axis": [1.0, 0.0, 1.0]}, "motion": {"rotation": 3.0}},
        *(in_sphere(INSIDE), IN_BOWL, BOWL_SPEED, 30.0, 3.0 * np.array([1.0, 0.0, 1.0]) / math.sqrt(2.0)),
    ),
}


def scene(wall: dict[str, Any], body: dict[str, Any], duration: float, **more: Any) -> Scene:
    """Return a ball on a wall on which it does not slip."""
    document: dict[str, Any] = {
        "contact": {"restitution": 0.0, "static_friction": 20.0, "kinetic_friction": 20.0},
        "gravity": {"constant": 0.0, "uniform": G.tolist()},
        "wall": [wall],
        "body": [{"radius": r, "mass": 1.0} | body],
        "time": {"duration": duration},
    }
    return Scene.from_dict(document | more)


def ended(of: Scene) -> tuple[Space, float]:
    """Return a space at the end of its run, and the scale of the energy in J."""
    space = Space(of)
    scales = [frame.energy.scale for frame in space.run()]
    return space, scales[-1]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_ball_that_rolls_and_spins_on_a_curved_wall_follows_the_equations_to_second_order(name: str) -> None:
    wall, turning, x, v, spin, rotation = CASES[name]
    spins, position, velocity = rolling_without_slip(turning, x, v, spin, r, G, DURATION, rotation)
    body = {"position": x.tolist(), "velocity": v.tolist(), "angular_velocity": spins.tolist()}
    errors = []
    for dt in (2e-3, 1e-3):
        space, scale = ended(scene(wall, body, DURATION, time={"duration": DURATION, "fixed_dt": dt}))
        state = space.state
        errors.append([np.abs(state.position[0] - position).max(), np.abs(state.velocity[0] - velocity).max()])
        # friction does no work where nothing slips. Its entry varies with the weight's component along the wall, by
        # ½ m/7 (g dt)² in all, 1e-5 J, and is of second order; before, 0.01 to 1 J were lost in 0.5 s
        assert abs(space.ledger.friction) < 2e-5 * scale * (dt / 2e-3) ** 2
    assert np.all(np.array(errors[1]) < 1e-3)  # of 0.4 to 1.2 m, and of 2 to 6 m/s
    assert np.array(errors[0]) / np.array(errors[1]) == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_the_golfers_ball_comes_up_again_at_default_settings() -> None:
    # the height oscillates with sqrt(2/7) of the rate f about the axis: z = -5 g/(2 f²) (1 - cos(sqrt(2/7) f t))
    rate = 10.0  # rad/s, at 0.5 m from the axis
    period = 2.0 * math.pi / (math.sqrt(2.0 / 7.0) * rate)
    body = {"position": [0.5, 0.0, 0.0], "velocity": [0.0, 0.5 * rate, 0.0], "angular_velocity": [0.0, 0.0, -50.0]}
    space, scale = ended(scene({"cylinder": {"radius": 0.6}}, body, period))
    assert abs(space.state.position[0, 2]) < 1e-6  # of 0.49 m; before, -3.9e-3
    assert abs(space.ledger.friction) < 1e-7 * scale


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize(
    "wall", [{"cylinder": {"radius": R}}, {"sphere": {"radius": R}}], ids=["ring", "hollow sphere"]
)
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_smooth_ball_inside_a_curved_wall_keeps_its_speed_without_a_field(
    wall: dict[str, Any], restitution: float
) -> None:
    smooth = {"restitution": restitution, "static_friction": 0.0, "kinetic_friction": 0.0}
    body = {"position": [INSIDE, 0.0, 0.0], "velocity": [0.0, 5.0, 0.0]}
    space, _ = ended(scene(wall, body, 1.0, contact=smooth, gravity={"constant": 0.0}))
    x, v = space.state.position[0], space.state.velocity[0]
    assert np.linalg.norm(v) == pytest.approx(5.0, rel=1e-12)
    assert np.linalg.norm(x) == pytest.approx(INSIDE, rel=1e-9)
    angle = 5.0 / INSIDE  # rad; a step of 0.02 rad is ahead by 7e-5 of it
    assert math.atan2(x[1], x[0]) == pytest.approx(angle - 2.0 * math.pi, abs=1e-4 * angle)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_run_in_a_ring_without_a_field_goes_on_from_a_checkpoint_with_the_same_bits() -> None:
    body = {"position": [0.5, 0.0, 0.0], "velocity": [1.0, 5.0, 0.0]}  # bounces until it slides
    smooth = {"restitution": 0.5, "static_friction": 0.0, "kinetic_friction": 0.0}
    ring = scene({"cylinder": {"radius": R}}, body, 1.0, contact=smooth, gravity={"constant": 0.0})
    run = list(Space(ring).run(schedule=every(0.0)))
    half = next(frame for frame in run if frame.time > 0.5)
    again = Space(ring)
    again.restore(half.checkpoint)
    assert [frame.fingerprint for frame in again.run(schedule=every(0.0))] == [f.fingerprint for f in run[half.step :]]


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_balls_that_roll_side_by_side_in_a_tube_move_like_one() -> None:
    # sixteen contacts that share no ball are solved in vectors of eight, a single one by itself
    ball = {"radius": r, "mass": 1.0, "velocity": [0.0, 4.0, 0.0], "angular_velocity": [-40.0, 0.0, -40.0]}
    tube = scene({"cylinder": {"radius": R}}, ball, 0.1, time={"duration": 0.1, "fixed_dt": 2e-3})
    row = [ball | {"position": [INSIDE, 0.0, 3.0 * r * k]} for k in range(16)]
    document = tube.model_dump(exclude_unset=True)
    ends = [ended(Scene.from_dict(document | {"body": balls}))[0].state for balls in (row[:1], row)]
    alone, beside = (np.hstack((state.velocity, state.angular_velocity)) for state in ends)
    # the line search sums over the balls, so its factor is rounded otherwise
    assert beside == pytest.approx(np.repeat(alone, len(row), axis=0), rel=1e-10, abs=1e-11)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_plate_that_accelerates_pushes_a_ball_without_a_loss(restitution: float) -> None:
    # from rest at the lower turning point: the ball leaves when the plate is fastest, after a quarter of a period
    amplitude, frequency, duration = 0.1, 0.5, 1.5
    motion = {"amplitude": [0.0, 0.0, amplitude], "frequency": frequency, "phase": -0.5 * math.pi}
    plate = {"normal": [0.0, 0.0, 1.0], "point": [0.0, 0.0, 0.0], "motion": motion}
    document = {
        "contact": {"restitution": restitution, "static_friction": 0.0, "kinetic_friction": 0.0},
        "gravity": {"constant": 0.0},
        "plane": [plate],
        "body": [{"radius": r, "mass": 1.0, "position": [0.0, 0.0, r - amplitude]}],
        "time": {"duration": duration},
    }
    space, _ = ended(Scene.from_dict(document))
    fastest = 2.0 * math.pi * frequency * amplitude
    assert space.state.velocity[0, 2] == pytest.approx(fastest, rel=1e-3)
    assert abs(space.ledger.restitution) < 1e-3 * 0.5 * fastest**2
