"""Torques are those of contacts that last; impacts have angular impulses, which do not depend on the step."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from carom.physics.contact.contact_tap import Impulses
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.state.frame import Frame
from small_scenes import scene_of

ROUNDING = 1e-13  # relative, of the sum of some dozens of impulses
GRAVITY = 9.81


def frames_with_spins(scene: Scene, steps: int, *, recorded: bool = False) -> list[tuple[Frame, float]]:
    """Run some steps; return each frame with a bound of the rounding of I Δω (N m s)."""
    space = Space(scene, 1, record_contacts=recorded)
    inertia, before, found = space.state.inertia[:, None], space.state.angular_velocity.copy(), []
    for frame in itertools.islice(space.run(schedule=every(0.0)), 1, steps + 1):
        assert frame.torque is not None and frame.angular_impulse is not None and frame.angular_velocity is not None
        assert frame.angular_acceleration is not None
        change = inertia * (frame.angular_velocity - before)
        size = float(np.abs(inertia * frame.angular_velocity).max() + np.abs(frame.angular_impulse).max())
        assert frame.torque * frame.dt + frame.angular_impulse == pytest.approx(change, rel=0, abs=ROUNDING * size)
        assert frame.angular_acceleration == pytest.approx(frame.torque / inertia, rel=1e-15)
        before = frame.angular_velocity.copy()
        found.append((frame, ROUNDING * size))
    return found


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("timing", ["time-of-impact", "end-of-step"])
def test_an_impact_has_an_angular_impulse_but_no_torque(timing: str, recorded: bool) -> None:
    found = []
    for step in (1e-2, 2.5e-3):  # s
        scene = Scene.load("two-spheres", [f"time.max_dt={step}", "time.duration=2", f"contact.timing={timing}"])
        frames = [frame for frame, _ in frames_with_spins(scene, int(1.7 / step), recorded=recorded)]
        assert not any(np.any(frame.torque) for frame in frames), "no contact lasts"
        (impulse,) = (turned for frame in frames if (turned := frame.angular_impulse) is not None and turned.any())
        found.append(impulse)
    late = 0.2 if timing == "end-of-step" else 0.0  # relative: the impact is found up to a step late, at another offset
    assert found[1] == pytest.approx(found[0], rel=max(late, 1e-9), abs=1e-12 * np.abs(found[0]).max())


def test_a_ball_that_slides_on_a_floor_has_the_torque_of_friction_and_an_impact_adds_none() -> None:
    mass, radius, friction, speed = 0.5, 0.1, 0.2, 2.0  # it slides for 0.3 s
    rough = {"restitution": 0.8, "static_friction": friction, "kinetic_friction": friction}
    sliding = {"position": [0.0, 0.0, radius], "velocity": [speed, 0.0, 0.0]}
    falling = {"position": [0.25, 0.01, 4.0 * radius]}
    scene = scene_of(
        [{"mass": mass, "radius": radius, **body} for body in (sliding, falling)],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -GRAVITY]},
        contact=rough,
        plane=[{"name": "floor", "point": [0.0, 0.0, 0.0]}],
        time={"duration": 1.0, "fixed_dt": 1e-3},
    )
    frames = [frame for frame, _ in frames_with_spins(scene, 220)]
    torque = np.array([frame.torque for frame in frames])
    struck = np.array([bool(np.any(frame.angular_impulse)) for frame in frames])
    first = int(np.flatnonzero(struck)[0])
    assert torque[1:first, 0] == pytest.approx(np.tile([0.0, friction * mass * GRAVITY * radius, 0.0], (first - 1, 1)))
    assert not np.any(torque[:first, 1]), "it falls"
    # an impact over a step would be a torque of 1000 s⁻¹ times its angular impulse, 30 times that of the weight
    turned = frames[first].angular_impulse
    assert turned is not None and np.abs(turned / frames[first].dt).max() > 10.0 * friction * mass * GRAVITY * radius
    assert np.abs(torque).max() <= 2.5 * friction * 2.0 * mass * GRAVITY * radius, "of both weights on one contact"


@pytest.mark.slow  # compiles for half a minute
def test_what_resists_rolling_in_an_impact_is_in_its_angular_impulse() -> None:
    ball = {"mass": 1.0, "radius": 0.5, "position": [0.0, 0.0, 0.6], "angular_velocity": [3.0, 2.0, 5.0]}
    scene = scene_of(
        [{"velocity": [0.2, 0.0, -1.0], **ball}],
        gravity={"constant": 0.0},
        contact={
            "law": "rolling_resistance",
            "restitution": 0.5,
            "static_friction": 0.4,
            "kinetic_friction": 0.3,
            "rolling_resistance": {"rolling_friction": 0.1, "twisting_friction": 0.1},
        },
        plane=[{"name": "floor", "point": [0.0, 0.0, 0.0]}],
        time={"duration": 0.3, "fixed_dt": 0.01},
    )
    frames = frames_with_spins(scene, 30, recorded=True)
    assert not any(np.any(frame.torque) for frame, _ in frames), "the impact explains all of the change"
    (rows,) = (frame.impacts for frame, _ in frames if frame.impacts is not None and len(frame.impacts))
    assert abs(rows["angular_z"][0]) > 0.0, "friction alone cannot stop the twist"


def test_scenes_of_all_kinds_split_the_change_of_spin_without_rest() -> None:
    for name, steps in (("billiards", 120), ("heap", 80), ("incline", 40)):
        frames_with_spins(Scene.load(name), steps)


def test_the_impulses_of_a_step_hold_those_of_its_impacts() -> None:
    space = Space(Scene.load("billiards"), 1, record_contacts=True)
    for frame in itertools.islice(space.run(schedule=every(0.0)), 1, 120):
        given = np.zeros_like(space.state.torque)
        for some in space.impulses():
            _add_impacts(some, given)
        size = np.abs(given).max()
        assert frame.angular_impulse == pytest.approx(given, rel=0, abs=ROUNDING * size)


def _add_impacts(some: Impulses, given: np.ndarray) -> None:
    if some.impact is None:
        return
    for k in np.flatnonzero(some.impact & (some.values[:, 0] > 0.0)):
        moment = np.cross(some.values[k, 1:], some.normal[k])
        for end, body in enumerate(some.pairs[k].tolist()):
            if body < len(given):
                given[body] += some.arms[k, end] * moment
