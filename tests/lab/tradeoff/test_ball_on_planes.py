"""The exact reference of a ball on planes, held to closed forms; and runs of the engine, held to the reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom.lab.compared_run import Trajectory, follow, sample_times
from carom.lab.tradeoff.ball_on_planes import BallSolution, solve_ball, why_no_ball
from carom.lab.tradeoff.reference import make_reference
from carom.physics.placement import place
from carom.physics.space import Space
from carom.scene.load import Scene

G = 10.0  # m/s²
ROLLS = 5.0 / 7.0  # of the force along a plane accelerates a solid ball that rolls
ROUNDING = 1e-11  # of m or m/s, in some hundred operations on numbers up to 100


def ball(time: float, *, plane: dict[str, Any] | None = None, field: Any = (0, 0, -G), **given: Any) -> Scene:
    """Return a scene with a ball of radius 0.1 m at the origin of a floor that touches it, unless told otherwise."""
    contact = {"restitution": 0.0, "static_friction": 0.3, "kinetic_friction": 0.2} | given.pop("contact", {})
    drag = {"drag": given.pop("drag")} if "drag" in given else {}
    body = {"radius": 0.1, "mass": 2.0, "position": [0.0, 0.0, 0.1]} | given
    return Scene.from_dict(
        {
            "time": {"duration": time},
            "gravity": {"constant": 0.0, "uniform": list(field)},
            "contact": contact,
            "plane": [plane or {}],
            "body": [body],
            **drag,
        }
    )


def solved(scene: Scene) -> BallSolution:
    return solve_ball(scene, place(scene), sample_times(scene))


def end(scene: Scene) -> tuple[Any, Any]:
    """Return the last position and velocity."""
    found = solved(scene)
    assert not found.ended
    return found.trajectory.position[-1, 0], found.trajectory.velocity[-1, 0]


def test_a_ball_bounces_infinitely_often_in_the_time_of_the_geometric_series() -> None:
    height, e = 1.25, 0.5
    fall = np.sqrt(2 * height / G)  # s
    rests_from = fall * (1 + 2 * e / (1 - e))
    found = solved(ball(2.0, position=[0.0, 0.0, 0.1 + height], contact={"restitution": e}))
    times, z = found.trajectory.time, found.trajectory.position[:, 0, 2] - 0.1
    assert found.impacts > 30 and not found.ended and found.trajectory.impacts == 0
    assert np.abs(z[times > rests_from + 1e-12]).max() < ROUNDING
    flies = times < fall
    assert z[flies] == pytest.approx(height - G * times[flies] ** 2 / 2, abs=ROUNDING)
    second = (times > fall) & (times < fall * (1 + 2 * e))
    since = times[second] - fall
    assert z[second] == pytest.approx(e * G * fall * since - G * since**2 / 2, abs=ROUNDING)
    assert found.trajectory.met.tolist() == pytest.approx([fall])


def test_a_ball_pushed_without_spin_slides_until_it_rolls_at_five_sevenths_of_its_speed() -> None:
    speed, friction = 7.0, 0.2 * G
    stops = 2 * speed / (7 * friction)  # s
    x, v = end(ball(3.0, velocity=[speed, 0.0, 0.0]))
    assert v == pytest.approx([ROLLS * speed, 0.0, 0.0], abs=ROUNDING)
    slid = speed * stops - friction * stops**2 / 2
    assert x == pytest.approx([slid + ROLLS * speed * (3.0 - stops), 0.0, 0.1], abs=ROUNDING)


@pytest.mark.parametrize(("slope", "rolls"), [(0.5, True), (2.0, False)])  # grips up to 7/2 of the coefficient, 1.05
def test_a_ball_rolls_down_a_gentle_slope_and_slides_down_a_steep_one(slope: float, rolls: bool) -> None:
    _, v = end(ball(2.0, field=(slope * G, 0.0, -G)))
    assert v[0] == pytest.approx((ROLLS * slope if rolls else slope - 0.2) * G * 2.0, rel=1e-13)


def test_a_ball_that_slides_across_a_slope_ends_at_the_velocity_that_its_angular_momentum_sets() -> None:
    velocity, spin, along, time = np.array([0.5, 2.0, 0.0]), np.array([4.0, -3.0, 5.0]), np.array([4.0, 0.0, 0.0]), 3.0
    scene = ball(time, field=(4.0, 0.0, -G), velocity=velocity.tolist(), angular_velocity=spin.tolist())
    _, v = end(scene)
    # friction acts at the contact point, so only the field changes 5/2 v + r ω × n; a rolling ball has r ω × n = v
    rolling = (2.5 * (velocity + along * time) + 0.1 * np.cross(spin, [0.0, 0.0, 1.0])) / 3.5
    assert v == pytest.approx(rolling, abs=ROUNDING)


def test_a_ball_in_a_wind_rolls_towards_its_speed_at_five_sevenths_of_the_rate() -> None:
    wind, relaxation = 3.0, 0.8
    _, v = end(ball(1.5, drag={"relaxation_time": relaxation, "medium_velocity": [wind, 0.0, 0.0]}))
    assert v[0] == pytest.approx(wind * (1 - np.exp(-ROLLS * 1.5 / relaxation)), rel=1e-13)


def test_an_impact_with_friction_grips_or_slips() -> None:
    down, e = -4.0, 0.5
    for speed, grips in ((1.0, True), (20.0, False)):
        scene = ball(1e-3, velocity=[speed, 0.0, down], contact={"restitution": e}, field=(0.0, 0.0, 0.0))
        _, v = end(scene)
        assert v[0] == pytest.approx(speed - (speed / 3.5 if grips else 0.2 * (1 + e) * 4.0))
        assert v[2] == pytest.approx(-e * down)


def errors(scene: Scene) -> tuple[float, float]:
    """Return the largest errors of a run's positions (m) and velocities (m/s)."""
    reference = solved(scene).trajectory
    run: Trajectory = follow(Space(scene), sample_times(scene))
    position, velocity = run.position - reference.position, run.velocity - reference.velocity
    return float(np.abs(position).max()), float(np.abs(velocity).max())


def test_a_run_down_an_incline_errs_by_rounding() -> None:
    assert max(errors(ball(0.5, field=(3.0, 0.0, -9.0)))) < 1e-12


def test_a_run_that_bounces_in_a_medium_errs_by_the_rounding_of_its_impacts() -> None:
    medium = {"relaxation_time": 2.0, "medium_velocity": [0.0, 1.0, 0.0]}
    smooth = {"static_friction": 0.0, "kinetic_friction": 0.0, "restitution": 0.9}
    scene = ball(1.5, position=[0.0, 0.0, 1.1], velocity=[1.0, 0.0, 0.0], drag=medium, contact=smooth)
    assert max(errors(scene)) < 1e-9  # steps of drag are exact; each time of impact is known to some 1e-12 s


def test_the_reference_of_a_study_is_the_closed_form() -> None:
    scene = ball(0.2, field=(3.0, 0.0, -9.0))
    reference = make_reference(scene)
    assert reference.kind == "exact" and reference.is_complete and "closed forms" in reference.text
    assert reference.uncertainty.position < 1e-13
    found = reference.errors(follow(Space(scene), reference.trajectory.time))
    assert found.position < 1e-13 and found.velocity < 1e-13


def test_scenes_that_are_more_than_a_ball_on_planes_are_named() -> None:
    assert why_no_ball(ball(1.0)) == ""
    assert why_no_ball(Scene.load("two-spheres")) == "more than one ball that moves"
    assert why_no_ball(ball(1.0, plane={"motion": {"velocity": [0, 0, 1]}})) == "planes that move"
    rolling = {"law": "rolling_resistance", "rolling_resistance": {"rolling_friction": 0.1}}
    assert why_no_ball(ball(1.0, contact=rolling)) == "another contact law than Coulomb's"
