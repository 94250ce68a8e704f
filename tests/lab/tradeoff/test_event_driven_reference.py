"""The exact course of a few bodies: against what is known in closed form."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carom.lab.compared_run import follow, sample_times
from carom.lab.tradeoff.event_driven_reference import solve, why_not
from carom.lab.tradeoff.reference import make_reference
from carom.physics.space import Space
from carom.scene.load import Scene
from published.test_two_body_bounce import AT_REST, BOUNCES
from small_scenes import pair, scene_of


def course(scene: Scene, tolerance: float = 1e-13) -> Any:
    return solve(Space(scene), sample_times(scene), tolerance)


def test_the_orbit_is_keplers() -> None:
    # e = 0.5, from apocentre: the mean anomaly M = t + π gives the eccentric one by Newton, E - e sin E = M. Ten
    # periods: the phase error is 3π times that of the period, 1e-13 a step of some hundred a period.
    e = 0.5
    planet = {
        "mass": 1e-12,
        "radius": 1e-3,
        "position": [1 + e, 0, 0],
        "velocity": [0, math.sqrt((1 - e) / (1 + e)), 0],
    }
    scene = scene_of(
        [{"mass": 1.0, "radius": 1e-3}, planet],
        gravity={"constant": 1.0},
        contact={"enabled": False},
        time={"duration": 20 * math.pi, "fixed_dt": 0.01},
    )
    run = course(scene).trajectory
    anomaly = run.time + math.pi
    E = anomaly.copy()
    for _ in range(50):
        E -= (E - e * np.sin(E) - anomaly) / (1 - e * np.cos(E))
    expected = np.stack((e - np.cos(E), -math.sqrt(1 - e * e) * np.sin(E)), axis=1)  # pericentre at -x
    found = run.position[:, 1, :2] - run.position[:, 0, :2]
    # the planet's mass changes the period by 5e-13 of itself and the tolerance by some 1e-12; the phase, 20 π of it
    assert np.abs(found - expected).max() <= 1e-9


def test_the_bounces_come_when_kepler_says_and_the_course_ends_where_the_bodies_rest() -> None:
    bodies = [{"position": [x, 0, 0], "radius": 2.0, "mass": 1.0} for x in (-10, 10)]
    scene = scene_of(bodies, gravity={"constant": 1.0}, contact={"restitution": 0.5}, time={"duration": 100.0})
    exact = course(scene)
    assert np.allclose(exact.time[:4], BOUNCES, rtol=0, atol=5e-6), "published to five decimals"
    assert "body 0 and body 1 stay in contact" in exact.ended
    assert exact.trajectory.time[-1] <= AT_REST < exact.trajectory.time[-1] + 0.5
    # each flight is half as long as the one before; those from 4e-11 m of height on, 7e-5 s, are left out
    assert abs(exact.time[-1] - AT_REST) <= 2e-4


def test_a_bullet_of_a_million_radii_a_second_is_not_stepped_over() -> None:
    target = {"position": [0.0, 0.0, 0.0], "radius": 1e-3, "mass": 1.0}
    bullet = {"position": [-10.0, 1e-4, 0.0], "velocity": [1000.0, 0, 0], "radius": 1e-3, "mass": 1e-3}
    exact = course(scene_of([target, bullet], gravity={"constant": 0.0}, time={"duration": 1.0}))
    met = (10.0 - math.sqrt(4e-6 - 1e-8)) / 1000.0
    # the gap is a difference of coordinates of 10 m: round-off 2e-15 m at 1000 m/s, and 2e-18 s of the clock
    assert exact.time == pytest.approx([met], abs=1e-16)


def test_a_contact_is_found_though_rounding_leaves_no_gap_so_small_that_it_counts_as_contact() -> None:
    # 10 km away at 1 km/s, the positions have 2e-12 m and the clock 2e-15 s, which is as much; 1e-12 r is 2e-15 m
    target = {"position": [0.0, 0.0, 0.0], "radius": 1e-3, "mass": 1.0}
    bullet = {"position": [-1e4, 5e-4, 0.0], "velocity": [1000.0, 0, 0], "radius": 1e-3, "mass": 1e-3}
    scene = scene_of([target, bullet], gravity={"constant": 0.0}, time={"duration": 20.0})
    exact = solve(Space(scene), np.array([5.0, 20.0]), budget=20.0)
    assert exact.ended == ""
    assert exact.time == pytest.approx([(1e4 - math.sqrt(4e-6 - 2.5e-7)) / 1000.0], rel=1e-15)


def test_the_exact_course_asks_the_law_how_a_contact_rebounds(monkeypatch: pytest.MonkeyPatch) -> None:
    def fading(material: Any, approach: float, rest_speed: float) -> float:
        return float(material.restitution / (1.0 + approach))

    law = SimpleNamespace(restitution=fading)
    monkeypatch.setattr("carom.lab.tradeoff.event_driven_reference.LAW", law)
    bodies = [{"position": [x, 0, 0], "velocity": [-0.2 * x, 0, 0], "radius": 1.0, "mass": 1.0} for x in (-5.0, 5.0)]
    scene = scene_of(bodies, gravity={"constant": 0.0}, contact={"restitution": 0.9}, time={"duration": 8.0})
    rebound = course(scene).trajectory.velocity[-1, 1, 0]
    assert rebound == pytest.approx(0.9 / (1.0 + 2.0), rel=1e-12)  # they meet at 2 m/s and leave at e · 1 m/s each


@pytest.mark.slow
def test_friction_turns_the_spheres_as_the_impulse_law_says() -> None:
    # stick or slide: the test is that angular momentum, spin included, is kept, and that Space finds the same
    scene = pair(offset=0.5, contact={"restitution": 0.8}, time={"duration": 4.0, "max_dt": 1e-4})
    exact = course(scene)
    space = Space(scene)
    for _ in space.run():
        pass
    assert len(exact.time) == 1
    # found up to a step late, at 2 m/s: 2e-4 of the radius deeper, and the normal turns by as much
    assert np.allclose(exact.trajectory.velocity[-1], space.state.velocity, rtol=0, atol=1e-3)


def test_two_balls_that_hit_the_cradle_send_two_out() -> None:
    scene = Scene.load("newtons-cradle")
    exact = course(scene)
    assert exact.trajectory.velocity[-1, :, 0].tolist() == [0.0] * 5 + [1.0, 1.0]
    assert len(exact.time) == 10


@pytest.mark.parametrize(
    ("name", "reason"),
    [("cloud-collapse", "500 bodies"), ("marbles-in-a-box", "151 bodies"), ("kepler-orbits", "")],
)
def test_a_scene_without_an_exact_reference_says_why(name: str, reason: str) -> None:
    assert why_not(Scene.load(name)).startswith(reason) and bool(why_not(Scene.load(name))) is bool(reason)


def test_the_event_driven_reference_refuses_planes_and_boxes() -> None:
    assert "planes" in why_not(pair(plane=[{"point": [0, 0, -5]}]))
    assert "periodic" in why_not(pair(domain={"boundary": "periodic", "size": [20.0, 20.0, 20.0]}))


def test_a_sample_at_the_moment_of_a_contact_has_the_velocities_after_it() -> None:
    # gap 2 m at 2 m/s: contact at 1 s but for the rounding of SciPy's sums, which depends on the processor
    scene = pair(time={"duration": 2.0}, contact={"restitution": 1.0, "static_friction": 0.0})
    samples = np.arange(1, 9) / 4
    [samples[3]] = solve(Space(scene), samples).time
    assert samples[3] == pytest.approx(1.0, rel=0.0, abs=1e-14)
    exact = solve(Space(scene), samples)
    assert exact.time == [samples[3]]
    assert exact.trajectory.velocity[:, 0, 0].tolist() == [1.0] * 3 + [-1.0] * 5


def spheres(*bodies: tuple[float, float, float], radius: float = 0.1, **sections: Any) -> Scene:
    """Line spheres up along x: place, velocity and mass of each."""
    listed = [{"position": [x, 0.0, 0.0], "velocity": [v, 0.0, 0.0], "radius": radius, "mass": m} for x, v, m in bodies]
    sections.setdefault("gravity", {"constant": 0.0})
    sections.setdefault("time", {"duration": 4.0})
    return scene_of(listed, **sections)


def test_bodies_that_stay_together_after_a_plastic_impact_move_on_together() -> None:
    exact = course(spheres((-1.0, 1.0, 1.0), (0.0, 0.0, 3.0), contact={"restitution": 0.0}))
    assert exact.ended == "" and exact.time == pytest.approx([0.8], abs=1e-14)  # sums of rounded steps
    assert exact.trajectory.velocity[-1, :, 0] == pytest.approx([0.25, 0.25], abs=1e-15)  # m v / (m + M)
    assert exact.trajectory.position[-1, :, 0] == pytest.approx([0.6, 0.8], abs=1e-14)


def test_a_third_body_strikes_two_that_stay_together_as_two() -> None:
    # 1 + 1 kg at 0.5 m/s after 0.8 s, and 2 kg that catches up with them at 2.5 m/s: all four at 1.5 m/s
    bodies = (-1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (-7.0, 2.5, 2.0)
    exact = course(spheres(*bodies, contact={"restitution": 0.0}))
    assert exact.ended == ""
    assert exact.trajectory.velocity[-1, :, 0] == pytest.approx([1.5] * 3, abs=1e-14)


def test_a_pull_on_touching_bodies_that_is_only_rounding_does_not_hold_them_together() -> None:
    # a uniform field pulls both alike; 0.1 m and 0.3 m/s² are no binary fractions, so that rounding is not zero
    field = {"constant": 0.0, "uniform": [0.3, -0.1, 0.7]}
    exact = course(spheres((-1.0, 1.0, 1.0), (0.0, 0.0, 3.0), gravity=field, contact={"restitution": 0.0}))
    assert exact.ended == ""
    assert exact.trajectory.velocity[-1] == pytest.approx(np.array([[1.45, -0.4, 2.8]] * 2), abs=1e-13)


def test_a_cradle_whose_balls_touch_sends_as_many_out_as_come_in() -> None:
    balls = [(0.2 * k, 0.0, 1.0) for k in range(5)]
    exact = course(spheres((-2.2, 1.0, 1.0), (-2.0, 1.0, 1.0), *balls, contact={"restitution": 1.0}))
    assert exact.ended == ""
    assert exact.trajectory.velocity[-1, :, 0] == pytest.approx([0.0] * 5 + [1.0] * 2, abs=1e-13)


def test_bodies_that_touch_and_close_at_the_start_collide_at_the_start() -> None:
    exact = course(spheres((-0.125, 1.0, 1.0), (0.125, 0.0, 1.0), radius=0.125, contact={"restitution": 1.0}))
    assert exact.time == [0.0] and exact.trajectory.velocity[0, :, 0].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("constant", [1.0, 1e-9])
def test_the_course_ends_where_gravity_presses_bodies_that_touch(constant: float) -> None:
    # e = 0: no bounce delays the contact that lasts
    gravity, plastic = {"constant": constant}, {"restitution": 0.0}
    exact = course(spheres((-0.5, 0.5, 1.0), (0.5, 0.0, 1.0), gravity=gravity, contact=plastic))
    assert f"body 0 and body 1 stay in contact from t = {exact.time[0]:.3g}" in exact.ended
    assert exact.time[0] - 4.0 / 600 <= exact.trajectory.time[-1] <= exact.time[0] + 4.0 / 600


def test_the_course_ends_where_a_passing_mass_begins_to_press_bodies_that_touch() -> None:
    # two bodies of next to no mass, side by side across the path of a third that comes from 10 km at 5 km/s: tides
    # press them, by m r / d³ of 2e-10 m/s² at the start and of 200 m/s² at the end
    light = [{"position": [x, 0.0, 0.0], "radius": 0.1, "mass": 1e-30} for x in (-0.1, 0.1)]
    heavy = {"position": [0.0, 1e4, 0.0], "velocity": [0.0, -5e3, 0.0], "radius": 0.1, "mass": 1e3}
    scene = scene_of([*light, heavy], gravity={"constant": 1.0}, time={"duration": 2.0}, contact={"restitution": 0.5})
    exact = course(scene)
    assert "body 0 and body 1 stay in contact" in exact.ended
    gaps = np.linalg.norm(exact.trajectory.position[:, 0] - exact.trajectory.position[:, 1], axis=1) - 0.2
    # the tolerance of 1e-13 of the speed, 5 km/s, is the slowest approach that is no rounding: 1e-9 m in 2 s
    assert gaps.min() > -1e-9, "they are never inside each other"


def test_spheres_that_meet_askew_and_keep_no_approach_part_along_their_tangents() -> None:
    # without friction the tangential velocities stay, so the distance is hypot(d, v_t t)
    scene = pair(offset=1.0, contact={"restitution": 0.0, "static_friction": 0.0}, time={"duration": 4.0})
    exact = course(scene)
    assert exact.ended == "" and len(exact.time) == 1
    apart = np.linalg.norm(exact.trajectory.position[-1, 1] - exact.trajectory.position[-1, 0])
    met = (4.0 - math.sqrt(3.0)) / 2.0
    assert apart == pytest.approx(math.hypot(2.0, (4.0 - met) * 1.0), rel=1e-13)  # v_t = 2 m/s · sin 30°


def struck_row(restitution: float, gap: float) -> Scene:
    """Return a ball that meets a row of four others, which touch or are a gap (m) apart, after 1.3 s."""
    row = [{"radius": 0.1, "mass": 1.0, "position": [k * (0.2 + gap), 0.0, 0.0]} for k in range(4)]
    ball = {"radius": 0.1, "mass": 1.0, "position": [-1.5, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0]}
    contact = {"restitution": restitution, "static_friction": 0.0, "kinetic_friction": 0.0}
    return scene_of([ball, *row], gravity={"constant": 0.0}, contact=contact, time={"duration": 2.0})


@pytest.mark.parametrize(
    ("restitution", "gap", "is_determined"), [(1.0, 0.0, True), (0.9, 0.0, False), (0.9, 0.01, True)]
)
def test_a_reference_says_where_the_order_of_simultaneous_impacts_matters(
    restitution: float, gap: float, is_determined: bool
) -> None:
    # Touching balls that lose energy strike again at once, in several orders. Equal elastic ones exchange velocities,
    # and balls apart strike one after the other: both have a single outcome.
    reference = make_reference(struck_row(restitution, gap), threads=1)
    said = "velocities after the simultaneous impacts at t = 1.3 s depend on their order" in reference.text
    assert said is not is_determined
    assert (reference.uncertainty.velocity < 1e-12) is is_determined


def test_balls_that_touch_from_the_start_have_no_time_of_first_contact() -> None:
    scene = struck_row(1.0, 0.0)
    reference = make_reference(scene, threads=1)
    errors = reference.errors(follow(Space(scene, 1), sample_times(scene)))
    assert reference.trajectory.pair.tolist() == [[0, 1]], "the only pair that is apart at first"
    assert errors.impact <= 1e-13 and errors.missed == 0.0
