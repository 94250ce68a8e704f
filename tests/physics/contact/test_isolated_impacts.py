"""An impact of two bodies before which neither touches anything is exact at default settings, whatever else there is.

No scene here sets a step, an integrator or a timing.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from carom.physics.space import Space
from carom.scene.load import Scene

Document = dict[str, Any]
FloatArray = NDArray[np.float64]

R, MASS = 0.0285, 0.17  # m and kg, a billiard ball
RESTITUTION, FRICTION = 0.9, 0.1
EXACT = 1e-9  # the promise; rounding and the balls' own gravity, 10⁻¹⁰ N, leave 4 × 10⁻¹⁰ (measured)
PULL = 9.81  # m/s²

WALLS = [{"normal": [0, 0, 1], "point": [0, 0, -1.2 * R]}, {"normal": [0, -1, 0], "point": [0, 2.2 * R, 0]}]
CROWD = {"count": 1000, "radius": {"min": 0.02, "max": 0.04}, "region": {"radius": 1.0, "centre": [0, 0, 3]}}
NOTHING: Document = {}
SURROUNDINGS: dict[str, Document] = {
    "nothing said of gravity": NOTHING,
    "no gravity": {"gravity": {"constant": 0.0}},
    "a field": {"gravity": {"uniform": [0.0, 0.0, -PULL]}},
    "walls near": {"plane": WALLS},
    "a field and a floor": {"gravity": {"uniform": [0.0, 0.0, -PULL]}, "plane": [{"point": [0, 0, -3.0]}]},
    "a thousand other bodies": {"group": [CROWD]},
    "balls that rest on a floor": {
        "gravity": {"uniform": [0.0, 0.0, -PULL]},
        "plane": [{"point": [0, 0, -3.0]}],
        "group": [{"count": 20, "radius": R, "mass": MASS, "region": {"radius": 0.4, "centre": [0, 0, -2.5]}}],
    },
}


def oblique(x: float, spin: tuple[float, ...] = (0.0, 0.0, 0.0), **sections: Any) -> Scene:
    """A ball that comes from x at 1 m/s and hits another one off centre, by one radius."""
    balls = [
        {"position": [x, R, 0.0], "velocity": [1.0, 0, 0], "radius": R, "mass": MASS, "angular_velocity": list(spin)},
        {"position": [0.0, 0.0, 0.0], "radius": R, "mass": MASS},
    ]
    contact = {"restitution": RESTITUTION, "static_friction": FRICTION, "kinetic_friction": FRICTION}
    return Scene.from_dict({"time": {"duration": -2.3 * x}, "contact": contact, "body": balls, **sections})


def first_impact(scene: Scene, i: int = 0) -> tuple[Any, Space]:
    """Run a scene until a body has been struck; return the row of its first impact, and the space."""
    space = Space(scene, 1, record_contacts=True)
    for frame in space.run():
        assert frame.impacts is not None
        for row in frame.impacts:
            if row["i"] == i:
                return row, space
    raise AssertionError("nothing struck the body")


@pytest.mark.parametrize("x", [-0.31, -0.303, -0.2])
@pytest.mark.parametrize("around", SURROUNDINGS.values(), ids=list(SURROUNDINGS))
def test_two_billiard_balls_strike_each_other_as_the_closed_form_says(around: Document, x: float) -> None:
    row, space = first_impact(oblique(x, **around))
    # the line of centres is at 30° to the path: sin = R / 2 R
    normal = np.array([math.sqrt(0.75), -0.5, 0.0])
    approach, slip = math.sqrt(0.75), 0.5
    impulse = 0.5 * MASS * (1.0 + RESTITUTION) * approach
    rubbed = FRICTION * impulse  # slides: sticking would take slip / K_t = 0.0121 N s, less than μ J = 0.0140 N s
    sticks = slip / ((2.0 + 2.0 / 0.4) / MASS)
    rubbed = min(rubbed, sticks)
    assert np.allclose([row["nx"], row["ny"], row["nz"]], normal, rtol=0, atol=EXACT)
    assert row["approach_speed"] == pytest.approx(approach, rel=EXACT)
    assert row["normal_impulse"] == pytest.approx(impulse, rel=EXACT)
    friction = np.array([row["friction_x"], row["friction_y"], row["friction_z"]])
    assert np.linalg.norm(friction) == pytest.approx(rubbed, rel=EXACT)
    lost = 0.25 * MASS * (1.0 - RESTITUTION**2) * approach**2
    assert row["restitution_loss"] == pytest.approx(lost, rel=EXACT)
    lost_by_friction = rubbed * (slip - 0.5 * rubbed * 7.0 / MASS)
    assert row["friction_loss"] == pytest.approx(lost_by_friction, rel=EXACT)
    assert row["time"] == pytest.approx(-x - 2.0 * R * math.sqrt(0.75), rel=EXACT)
    if around in (NOTHING, SURROUNDINGS["no gravity"]):
        spin = np.cross(normal, friction) * R / (0.4 * MASS * R * R)
        assert np.allclose(space.state.angular_velocity, [-spin, -spin], rtol=0, atol=EXACT / R)
        velocity = impulse * normal / MASS + friction / MASS
        assert np.allclose(space.state.velocity[1], velocity, rtol=0, atol=EXACT)


def test_the_values_that_a_default_run_once_got_wrong() -> None:
    row, _ = first_impact(oblique(-0.31))
    found = (row["approach_speed"], row["normal_impulse"], row["restitution_loss"] + row["friction_loss"])
    assert [f"{value:.4g}" for value in found] == ["0.866", "0.1399", "0.009092"]


SPIN = (3.0, -20.0, 11.0)  # rad/s, of the ball that comes
MEDIA: dict[str, Document] = {
    "alone": {"gravity": {"constant": 0.0}},
    "in a wind and a field": {"gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -PULL]}, "wind": [0.2, -0.1, 0.3]},
    "walls near": {"gravity": {"constant": 0.0}, "plane": WALLS},
    "in steps of a second": {"gravity": {"constant": 0.0}, "time": {"duration": 1.0, "fixed_dt": 1.0}},
    "among a thousand others": {"gravity": {"constant": 0.0}, "group": [CROWD]},
}


@pytest.mark.parametrize("tau", [0.3, 0.7, 30.0])
@pytest.mark.parametrize("around", MEDIA.values(), ids=list(MEDIA))
def test_two_billiard_balls_strike_each_other_in_a_medium_as_the_closed_form_says(around: Document, tau: float) -> None:
    sections = {key: value for key, value in around.items() if key != "wind"}
    medium = {"relaxation_time": tau, "medium_velocity": around.get("wind", [0.0, 0.0, 0.0])}
    row, space = first_impact(oblique(-0.31, SPIN, drag=medium, **sections))
    normal = np.array([math.sqrt(0.75), -0.5, 0.0])
    flown = 0.31 - 2.0 * R * math.sqrt(0.75)  # = τ (1 - e^{-t/τ}), relative to the other ball
    speed, moment = 1.0 - flown / tau, -tau * math.log1p(-flown / tau)
    approach = speed * math.sqrt(0.75)
    impulse = 0.5 * MASS * (1.0 + RESTITUTION) * approach
    slip = -speed * np.array([1.0, 0.0, 0.0]) + approach * normal - R * np.cross(SPIN, normal)
    slips = float(np.linalg.norm(slip))
    friction = -min(FRICTION * impulse, slips * MASS / 7.0) * slip / slips
    assert row["time"] == pytest.approx(moment, rel=EXACT)
    assert np.allclose([row["nx"], row["ny"], row["nz"]], normal, rtol=0, atol=EXACT)
    assert row["approach_speed"] == pytest.approx(approach, rel=EXACT)
    assert row["normal_impulse"] == pytest.approx(impulse, rel=EXACT)
    rubbed = [row["friction_x"], row["friction_y"], row["friction_z"]]
    assert np.allclose(rubbed, friction, rtol=0, atol=EXACT * impulse)
    lost = 0.25 * MASS * (1.0 - RESTITUTION**2) * approach**2
    assert row["restitution_loss"] == pytest.approx(lost, rel=EXACT)
    if "group" in around or "plane" in around:
        return  # others may have struck them since
    decay = math.exp(-(space.time - moment) / tau)
    after = np.array([[speed, 0.0, 0.0], [0.0, 0.0, 0.0]]) + np.outer([-1.0, 1.0], impulse * normal + friction) / MASS
    apart = space.state.velocity[1] - space.state.velocity[0]
    assert np.allclose(apart, (after[1] - after[0]) * decay, rtol=0, atol=EXACT)
    spun = np.cross(friction, normal) / (0.4 * MASS * R)
    assert np.allclose(space.state.angular_velocity, [SPIN + spun, spun], rtol=0, atol=EXACT / R)
    way = tau * -math.expm1(-(space.time - moment) / tau)
    assert np.allclose(
        space.state.position[1] - space.state.position[0], 2.0 * R * normal + (after[1] - after[0]) * way, atol=EXACT
    )


@pytest.mark.parametrize("height", [0.02, 0.1, 1.0, 50.0])
@pytest.mark.parametrize("others", [0, 60], ids=["alone", "among sixty"])
def test_a_ball_falls_on_a_plane_at_the_speed_and_time_of_galileo(height: float, others: int) -> None:
    # with 61 bodies a step is 0.061 of a fall through a radius, and straight paths were off by up to 0.8 %
    crowd = [{"position": [1.0 + 0.3 * k, 0, 60.0], "radius": 0.1, "mass": 1.0} for k in range(others)]
    scene = Scene.from_dict(
        {
            "time": {"duration": 1.05 * math.sqrt(2.0 * height / PULL)},
            "gravity": {"uniform": [0.0, 0.0, -PULL]},
            "contact": {"restitution": 0.8, "static_friction": 0.3},
            "plane": [{}],
            "body": [{"position": [0, 0, 0.1 + height], "velocity": [0.2, 0, 0], "radius": 0.1, "mass": 1.0}, *crowd],
        }
    )
    row, space = first_impact(scene)
    assert row["approach_speed"] == pytest.approx(math.sqrt(2.0 * PULL * height), rel=EXACT)
    assert row["time"] == pytest.approx(math.sqrt(2.0 * height / PULL), rel=EXACT)
    assert row["z"] == pytest.approx(0.0, abs=1e-14)  # where it touches the plane
    since, rebound = space.time - row["time"], 0.8 * math.sqrt(2.0 * PULL * height)
    if PULL * since < 2.0 * rebound:  # it has not come down again
        assert space.state.velocity[0, 2] == pytest.approx(rebound - PULL * since, rel=EXACT, abs=EXACT)


@pytest.mark.parametrize("speed", [0.3, 2.0])
@pytest.mark.parametrize("off", [0.0, 0.02, 0.19])
def test_a_ball_thrown_at_a_fixed_one_meets_it_where_the_parabola_does(speed: float, off: float) -> None:
    start, throw, reach = np.array([-0.85 * speed, off, 1.0]), np.array([speed, 0.0, 3.0]), 0.2
    field = np.array([0.0, 0.0, -PULL])
    scene = Scene.from_dict(
        {
            "time": {"duration": 2.0},
            "gravity": {"uniform": field.tolist()},
            "contact": {"restitution": 0.8, "static_friction": 0.2},
            "body": [
                {"position": start.tolist(), "velocity": throw.tolist(), "radius": 0.1, "mass": 1.0},
                {"position": [0, 0, 0], "radius": 0.1, "mass": 1.0, "fixed": True},
                *({"position": [1e3 + k, 0, 0], "radius": 0.1, "mass": 1.0} for k in range(60)),
            ],
        }
    )
    terms = [0.25 * field @ field, field @ throw, throw @ throw + field @ start, 2.0 * start @ throw]
    roots = np.roots([*terms, start @ start - reach**2])
    meeting = min(root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0.0)
    place, velocity = start + throw * meeting + 0.5 * field * meeting**2, throw + field * meeting
    row, _ = first_impact(scene)
    normal = -place / reach
    graze = 1.0 / abs(velocity @ normal / np.linalg.norm(velocity))  # by which a graze amplifies rounding
    assert row["time"] == pytest.approx(meeting, rel=EXACT * graze)
    assert np.allclose([row["nx"], row["ny"], row["nz"]], normal, rtol=0, atol=EXACT * graze)
    assert row["approach_speed"] == pytest.approx(velocity @ normal, rel=EXACT * graze)


class Fall:
    """The closed form of a flight in a medium, v' = a - (v - u)/τ."""

    def __init__(self, x: Any, v: Any, tau: float, wind: Any = (0.0, 0.0, 0.0)) -> None:
        self.x, self.v, self.tau = np.array(x), np.array(v), tau
        self.terminal = np.array(wind) + np.array([0.0, 0.0, -PULL * tau])

    def place(self, t: float) -> FloatArray:
        """Where it is after t s, in m."""
        place: FloatArray = self.x + self.terminal * t - (self.v - self.terminal) * self.tau * math.expm1(-t / self.tau)
        return place

    def velocity(self, t: float) -> FloatArray:
        """Its velocity after t s, in m/s."""
        velocity: FloatArray = self.terminal + (self.v - self.terminal) * math.exp(-t / self.tau)
        return velocity


@pytest.mark.parametrize("time", [{}, {"fixed_dt": 0.1}], ids=["", "in steps of 0.1 s"])
@pytest.mark.parametrize("tau", [0.1, 0.3, 5.0])
def test_a_ball_bounces_on_a_plane_in_a_medium_as_the_closed_form_says(tau: float, time: Document) -> None:
    wind, e, mu, radius = (0.5, -0.3, -0.2), 0.8, 0.05, 0.1
    spin, moment, struck = np.array([2.0, 30.0, -5.0]), 0.0, []
    flight = Fall([0.0, 0.0, 0.3], [0.7, 0.0, 1.0], tau, wind)
    scene = Scene.from_dict(
        {
            "time": {"duration": 2.0, **time},
            "gravity": {"uniform": [0.0, 0.0, -PULL], "constant": 0.0},
            "contact": {"restitution": e, "static_friction": mu, "kinetic_friction": mu},
            "drag": {"relaxation_time": tau, "medium_velocity": list(wind)},
            "plane": [{}],
            "body": [
                {"position": flight.x.tolist(), "velocity": flight.v.tolist(), "radius": radius, "mass": 2.0}
                | {"angular_velocity": spin.tolist()}
            ],
        }
    )
    space = Space(scene, 1, record_contacts=True)
    for frame in space.run():
        assert frame.impacts is not None
        struck += list(frame.impacts)
    assert len(struck) >= 3
    for row in struck[: 2 if time else 3]:  # a later one may be shorter than a step, and end at rest
        height = partial(lambda flight, t: flight.place(t)[2] - radius, flight)
        fell = brentq(height, 1e-3 * tau, 3.0, xtol=1e-15, rtol=1e-15)
        moment += fell
        before = flight.velocity(fell)
        impulse = -(1.0 + e) * 2.0 * before[2]
        slip = np.array([before[0] - radius * spin[1], before[1] + radius * spin[0], 0.0])
        slips = float(np.linalg.norm(slip))
        friction = -min(mu * impulse, slips * 2.0 / 3.5) * slip / slips  # on the ball
        assert row["time"] == pytest.approx(moment, rel=EXACT)
        assert row["approach_speed"] == pytest.approx(-before[2], rel=EXACT)
        assert row["normal_impulse"] == pytest.approx(impulse, rel=EXACT)
        assert np.allclose([row["friction_x"], row["friction_y"]], -friction[:2], rtol=0, atol=EXACT * impulse)
        assert row["z"] == pytest.approx(0.0, abs=1e-13)  # where it touches the plane
        after = before + [0.0, 0.0, impulse / 2.0] + friction / 2.0
        spin = spin + np.cross([0.0, 0.0, -radius], friction) / (0.4 * 2.0 * radius * radius)
        flight = Fall(flight.place(fell), after, tau, wind)
    assert frame.energy.relative_error <= 1e-12


@pytest.mark.parametrize("tau", [0.1, 1.0])
@pytest.mark.parametrize("time", [{}, {"fixed_dt": 0.5}], ids=["", "in steps of 0.5 s"])
def test_a_ball_thrown_in_a_medium_meets_a_fixed_one_where_its_path_does(tau: float, time: Document) -> None:
    fixed = [0.0, 0.0, 0.0]
    flight = Fall([-0.05, 0.02, 0.4], [0.3, 0.0, 1.0], tau)
    scene = Scene.from_dict(
        {
            "time": {"duration": 1.0, **time},
            "gravity": {"uniform": [0.0, 0.0, -PULL], "constant": 0.0},
            "contact": {"restitution": 0.8, "static_friction": 0.2},
            "drag": {"relaxation_time": tau},
            "body": [
                {"position": flight.x.tolist(), "velocity": flight.v.tolist(), "radius": 0.1, "mass": 1.0},
                {"position": fixed, "radius": 0.1, "mass": 1.0, "fixed": True},
            ],
        }
    )
    row, _ = first_impact(scene)
    meeting = brentq(lambda t: np.linalg.norm(flight.place(t)) - 0.2, 0.0, row["time"] + 0.01, xtol=1e-15, rtol=1e-15)
    normal = -flight.place(meeting) / 0.2
    assert row["time"] == pytest.approx(meeting, rel=EXACT)
    assert np.allclose([row["nx"], row["ny"], row["nz"]], normal, rtol=0, atol=EXACT)
    assert row["approach_speed"] == pytest.approx(flight.velocity(meeting) @ normal, rel=EXACT)


LONGEST = 0.008  # s, of a step


def on_a_floor(height: float, restitution: float, **sections: Any) -> Scene:
    """A ball above a floor, among sixty others that are far away; with so many, steps end at no impact."""
    crowd = [{"position": [1.0 + 0.3 * k, 0, 60.0], "radius": 0.1, "mass": 1.0} for k in range(60)]
    return Scene.from_dict(
        {
            "gravity": {"uniform": [0.0, 0.0, -PULL]},
            "contact": {"restitution": restitution},
            "plane": [{}],
            "body": [{"position": [0, 0, 0.1 + height], "radius": 0.1, "mass": 1.0}, *crowd],
            "time": {"duration": 1.2 * math.sqrt(2.0 * height / PULL), "max_dt": LONGEST},
            **sections,
        }
    )


@pytest.mark.parametrize("height", [4e-4, 1e-3])
def test_a_ball_that_falls_no_farther_than_in_a_step_bounces_with_its_restitution(height: float) -> None:
    row, space = first_impact(on_a_floor(height, 0.8))
    approach = math.sqrt(2.0 * PULL * height)
    assert approach < 2.0 * PULL * LONGEST  # at which contacts of a pile are at rest
    assert row["approach_speed"] == pytest.approx(approach, rel=EXACT)
    assert row["normal_impulse"] == pytest.approx(1.8 * approach, rel=EXACT)
    assert row["restitution_loss"] == pytest.approx(0.5 * 0.36 * approach**2, rel=EXACT)
    assert space.state.velocity[0, 2] == pytest.approx(0.8 * approach - PULL * (space.time - row["time"]), rel=EXACT)


def test_bounces_die_down_to_rest_without_an_overlap() -> None:
    space = Space(on_a_floor(0.05, 0.5, time={"duration": 1.0, "max_dt": LONGEST}), 1, record_contacts=True)
    bounces, deepest = [], 0.0
    for frame in space.run():
        assert frame.impacts is not None
        deepest = max(deepest, 0.1 - frame.position[0, 2])
        bounces += [row["approach_speed"] for row in frame.impacts if row["i"] == 0]
    # each is half as fast as the one before, down to a rebound that lasts less than a step: e v < g dt / 2
    followed = [0.5**k * math.sqrt(2.0 * PULL * 0.05) for k in range(4)]
    assert bounces[:4] == pytest.approx(followed, rel=EXACT)
    assert 0.5 * bounces[-1] < 0.5 * PULL * LONGEST
    assert deepest < 1e-15  # a rebound that ends within its step lands at the end of it
    assert np.abs(space.state.velocity[0]).max() < 1e-12  # the others attract it
    assert space.state.position[0, 2] == pytest.approx(0.1, abs=1e-15)


def test_two_bodies_that_only_their_gravity_moves_together_rebound_with_their_restitution() -> None:
    gap, mass, dt = 3e-5, 1e9, 0.05
    pull = 2.0 * 6.67430e-11 * mass / (2.0 + gap) ** 2
    scene = Scene.from_dict(
        {
            "time": {"duration": dt, "integrator": "leapfrog", "fixed_dt": dt},
            "contact": {"restitution": 0.7},
            "body": [{"position": [x, 0, 0], "radius": 1.0, "mass": mass} for x in (0.0, 2.0 + gap)],
        }
    )
    row, _ = first_impact(scene)
    assert 0.0 < row["approach_speed"] < 2.0 * 0.5 * pull * dt  # at which contacts of a pile are at rest
    assert row["normal_impulse"] == pytest.approx(0.5 * mass * 1.7 * row["approach_speed"], rel=EXACT)
