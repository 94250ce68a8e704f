"""The starters of a lesson do what their comments promise: `carom new --from bouncing-ball` and its kind."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import carom
from carom import Scene, Space
from carom.state.frame import Frame
from carom_command import carom as command

G = 9.81  # m/s²


def run(name: str, overrides: list[str] | None = None) -> list[Frame]:
    return list(Space(Scene.load(name, overrides or [])).run())


@pytest.mark.parametrize("step", [0.005, 0.05])
def test_the_bouncing_ball_rises_to_064_of_the_height_before_whatever_the_step(step: float, tmp_path: Path) -> None:
    impacts = carom.run(Scene.load("bouncing-ball", [f"time.fixed_dt={step}"]), tmp_path / "run.rrd").impacts()
    fall, e = math.sqrt(2 / G), 0.8
    times = fall + np.cumsum([0.0, *(2 * fall * e**bounce for bounce in range(1, 6))])
    assert impacts["time"].to_pylist() == pytest.approx(list(times), abs=1e-9)  # recorded to the nanosecond
    approach = [e**bounce * math.sqrt(2 * G) for bounce in range(6)]
    assert impacts["approach_speed"].to_pylist() == pytest.approx(approach, rel=1e-6)  # recorded in float32


def test_balls_on_the_slope_slide_slip_and_roll_at_the_accelerations_of_the_textbook() -> None:
    frames = run("incline")
    downhill = np.array([math.cos(math.pi / 6), 0.0, -math.sin(math.pi / 6)])
    end = frames[-1]
    travelled = (end.position - frames[0].position) @ downhill
    sine, cosine = math.sin(math.pi / 6), math.cos(math.pi / 6)
    closed = [G * sine, G * (sine - 0.1 * cosine), 5 / 7 * G * sine]
    # constant accelerations, which kicks and drifts follow to rounding
    assert end.velocity @ downhill == pytest.approx(np.multiply(closed, end.time), rel=1e-9)
    assert travelled == pytest.approx(np.multiply(closed, end.time**2 / 2), rel=1e-9)
    lost = np.array([body_energy(end, body) - body_energy(frames[0], body) for body in range(3)])
    assert abs(lost[[0, 2]]).max() < 1e-9 < -lost[1]


def body_energy(frame: Frame, body: int) -> float:
    """Energy of a solid ball of 1 kg and 0.1 m under gravity, in J."""
    assert frame.angular_velocity is not None
    speed, spin = frame.velocity[body], frame.angular_velocity[body]
    return float(speed @ speed / 2 + 0.4 * 0.1**2 * spin @ spin / 2 + G * frame.position[body][2])


@pytest.mark.parametrize(("friction", "throw", "off"), [(0.0, 0.0, 1e-9), (0.06, 1.7, 0.2)])
def test_the_object_ball_leaves_along_the_line_of_centres_but_for_the_throw_and_ends_up_rolling(
    friction: float, throw: float, off: float
) -> None:
    frames = run("billiards", [f"contact.static_friction={friction}", f"contact.kinetic_friction={friction}"])
    after = next(frame for frame in frames if frame.velocity[1, 0] > 0.1)
    assert math.degrees(math.atan2(after.velocity[1, 1], after.velocity[1, 0])) == pytest.approx(30.0 - throw, abs=off)
    end = frames[-1]
    assert end.angular_velocity is not None
    slip = end.velocity + np.cross(end.angular_velocity, [0.0, 0.0, -0.028575])  # of the points that touch the cloth
    assert abs(slip).max() < 1e-12


def test_the_heap_comes_to_rest() -> None:
    frames = run("heap")
    assert np.linalg.norm(frames[-1].velocity, axis=1).max() < 0.01  # m/s; nothing brakes rolling


@pytest.mark.parametrize("name", ["bouncing-ball", "billiards", "incline", "cradle", "gas", "orbit", "heap"])
def test_a_starter_is_copied_by_its_short_name(name: str, tmp_path: Path) -> None:
    done = command("new", "mine", "--from", name, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert Scene.load(tmp_path / "mine.toml").count >= 1
