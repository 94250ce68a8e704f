"""A body that rests, rolls or slides on something fixed is hit with the velocities that its contacts leave it.

The contacts of such a body act in the kicks at both ends of a step, and an impact lies between them. Closed forms, at
steps whose impacts fall anywhere within them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from carom.physics.space import Space
from carom.scene.load import Scene

R, V, G = 0.1, 1.0, 9.81  # m, m/s, m/s²
ROUNDED = 1e-12  # relative; some 10³ steps
STEPS: list[dict[str, float]] = [{}, {"max_dt": 7e-4}, {"fixed_dt": 3e-3}, {"fixed_dt": 1.7e-3}]
GRIP = {"restitution": 0.0, "static_friction": 20.0, "kinetic_friction": 20.0}


def rolling(x: float = 0.0, **further: Any) -> dict[str, Any]:
    return {"position": [x, 0, R], "radius": R, "velocity": [V, 0, 0], "angular_velocity": [0, V / R, 0]} | further


def space_of(duration: float, time: dict[str, float], contact: dict[str, Any], **sections: Any) -> Space:
    gravity = {"constant": 0.0, "uniform": [0.0, 0.0, -G]}
    document = {"time": {"duration": duration, **time}, "gravity": gravity, "contact": contact, **sections}
    return Space(Scene.from_dict(document), threads=1, record_contacts=True)


def ended(*arguments: Any, **sections: Any) -> Space:
    """Run a scene to its end, with an energy that closes to rounding."""
    space = space_of(*arguments, **sections)
    for _ in space.run():
        pass
    error = space.extremes.energy_error
    assert error is not None and error.value <= 1e-11  # rounding of up to 5 × 10⁴ steps leaves 3 × 10⁻¹²
    return space


def incline(angle: float) -> dict[str, Any]:
    return {"normal": [-math.sin(angle), 0.0, math.cos(angle)], "point": [0.5, 0.0, 0.0]}


@pytest.mark.parametrize("degrees", [5.0, 20.0, 40.0, 65.0])
@pytest.mark.parametrize("time", STEPS)
def test_a_rolling_ball_that_meets_an_incline_keeps_its_angular_momentum_about_the_contact(
    degrees: float, time: dict[str, float]
) -> None:
    angle = math.radians(degrees)
    along = np.array([math.cos(angle), 0.0, math.sin(angle)])
    meets = 0.5 - R * math.tan(0.5 * angle)  # m, and s
    space = ended(meets + 0.05, time, GRIP, plane=[{}, incline(angle)], body=[rolling()])
    after = V * (2.0 + 5.0 * math.cos(angle)) / 7.0
    expected = after - 5.0 / 7.0 * G * math.sin(angle) * 0.05
    assert space.state.velocity[0] @ along == pytest.approx(expected, rel=ROUNDED)
    assert space.state.angular_velocity[0, 1] * R == pytest.approx(expected, rel=ROUNDED)
    way = after * 0.05 - 2.5 / 7.0 * G * math.sin(angle) * 0.05**2
    # the step of the impact rolls on at its mean speed, without the field of the rest of the step: ½ g dt² at most
    dt = max(time.values(), default=1e-3)
    assert (space.state.position[0] - [meets, 0.0, R]) @ along == pytest.approx(way, abs=0.5 * G * dt**2)


@pytest.mark.parametrize("degrees", [20.0, 65.0])
@pytest.mark.parametrize("time", STEPS)
def test_a_ball_that_rolls_into_a_cone_keeps_its_angular_momentum_about_the_contact(
    degrees: float, time: dict[str, float]
) -> None:
    angle, height = math.radians(degrees), 0.4
    cone = {"radius": 0.5, "end_radius": 0.5 + height / math.tan(angle), "height": height, "point": [0.0, 0.0, 0.0]}
    meets = 0.5 - R * math.tan(0.5 * angle)  # m, and s
    space = ended(meets + 0.02, time, GRIP, plane=[{}], wall=[{"cone": cone}], body=[rolling()])
    after = V * (2.0 + 5.0 * math.cos(angle)) / 7.0 - 5.0 / 7.0 * G * math.sin(angle) * 0.02
    along = np.array([math.cos(angle), 0.0, math.sin(angle)])
    assert space.state.velocity[0] @ along == pytest.approx(after, rel=ROUNDED)
    assert space.state.angular_velocity[0, 1] * R == pytest.approx(after, rel=ROUNDED)


def test_a_piston_overhead_does_not_change_an_impact_of_balls_on_the_floor() -> None:
    smooth, rests = {"restitution": 1.0, "static_friction": 0.0}, rolling(0.5, velocity=[0.0, 0.0, 0.0])
    lid = {"point": [0.0, 0.0, 3.0], "normal": [0.0, 0.0, -1.0], "piston": {"mass": 1.0, "force": 1.0}}
    struck = ended(0.4, {"fixed_dt": 3e-3}, smooth, plane=[*cloth(0.3), lid], body=[rolling(), rests])
    alone = ended(0.4, {"fixed_dt": 3e-3}, smooth, plane=cloth(0.3), body=[rolling(), rests])
    assert struck.state.velocity == pytest.approx(alone.state.velocity, abs=ROUNDED)
    assert struck.state.angular_velocity == pytest.approx(alone.state.angular_velocity, abs=ROUNDED)


@pytest.mark.parametrize("restitution", [0.3, 1.0])
@pytest.mark.parametrize("time", STEPS)
def test_a_rolling_ball_climbs_a_wall_as_high_as_friction_throws_it(time: dict[str, float], restitution: float) -> None:
    friction = 0.1  # less than 2/7 / (1 + e): it slips throughout the impact
    contact = {"restitution": restitution, "static_friction": friction, "kinetic_friction": friction}
    space = ended(0.415, time, contact, plane=[{}, incline(0.5 * math.pi)], body=[rolling()])
    thrown, since = friction * (1.0 + restitution) * V, 0.415 - 0.4  # m/s up, and s
    assert space.state.velocity[0] == pytest.approx([-restitution * V, 0.0, thrown - G * since], abs=ROUNDED)
    assert space.state.position[0, 2] - R == pytest.approx(thrown * since - 0.5 * G * since**2, abs=ROUNDED)
    assert space.state.angular_velocity[0, 1] * R == pytest.approx(V - 2.5 * thrown, abs=ROUNDED)


def cloth(friction: float) -> list[dict[str, Any]]:
    return [{"static_friction": friction, "kinetic_friction": friction}]


@pytest.mark.parametrize("dt", [4e-3, 1.7e-3, 1e-3])
def test_a_ball_slides_into_another_at_the_speed_that_friction_has_left_it(dt: float) -> None:
    friction, way = 0.3, 0.05  # m between the surfaces; it slides for 0.083 m
    slides, other = rolling(angular_velocity=[0.0, 0.0, 0.0]), {"position": [way + 2.0 * R, 0.0, R], "radius": R}
    smooth = {"restitution": 1.0, "static_friction": 0.0}
    space = space_of(0.1, {"fixed_dt": dt}, smooth, plane=cloth(friction), body=[slides, other])
    struck = next(frame.impacts for frame in space.run() if frame.impacts is not None and len(frame.impacts))
    speed = math.sqrt(V * V - 2.0 * friction * G * way)
    # between the kicks the path is straight, at most a dt²/8 beside the true one
    late = friction * G * dt**2 / 8.0 / speed
    assert struck["approach_speed"][0] == pytest.approx(speed, abs=2.0 * friction * G * late)


@pytest.mark.parametrize("dt", [4e-3, 1.7e-3, 1e-3])
def test_friction_slows_a_ball_from_the_moment_at_which_it_was_hit(dt: float) -> None:
    friction, way = 0.3, 0.1
    smooth, other = {"restitution": 1.0, "static_friction": 0.0}, {"position": [way + 2.0 * R, 0.0, R], "radius": R}
    space = ended(0.15, {"fixed_dt": dt}, smooth, plane=cloth(friction), body=[rolling(), other])
    since = 0.15 - way / V
    # one had rolled and now spins on the spot, the other slides
    expected = [friction * G * since, V - friction * G * since]
    assert space.state.velocity[:, 0] == pytest.approx(expected, rel=ROUNDED)
    spins = [V - 2.5 * friction * G * since, 2.5 * friction * G * since]
    assert R * space.state.angular_velocity[:, 1] == pytest.approx(spins, rel=ROUNDED)


def test_a_ball_at_rest_that_is_hit_along_the_floor_stays_on_it() -> None:
    smooth, rests = {"restitution": 1.0, "static_friction": 0.0}, rolling(0.5, velocity=[0.0, 0.0, 0.0])
    space = ended(0.5, {"fixed_dt": 3e-3}, smooth, plane=[{}], body=[rolling(), rests])
    assert np.array_equal(space.state.position[:, 2], [R, R])
    assert space.state.velocity == pytest.approx(np.array([[0.0, 0, 0], [V, 0, 0]]), abs=ROUNDED)


def test_the_billiards_err_by_less_than_a_ten_thousandth_of_a_radius_and_by_the_square_of_the_step() -> None:
    def at_the_end(dt: float) -> Any:
        space = Space(Scene.load("billiards", [f"time.fixed_dt={dt}", "time.duration=0.6"]), threads=1)
        for _ in space.run():
            pass
        return space.state.position.copy()

    fine = at_the_end(0.0025 / 256)
    errors = [float(np.abs(at_the_end(0.0025 / k) - fine).max()) for k in (1, 16)]
    assert errors[0] < 2e-6  # m; 4.6e-4 if impacts ignore what the cloth does to the balls
    assert errors[1] < errors[0] / 16**2 * 8  # 8: impacts fall anywhere within their steps


def balls_on_a_table(seed: int) -> dict[str, Any]:
    """Balls that roll, slide and spin on a table between inclined cushions, with any restitution and friction."""
    rng = np.random.default_rng(seed)
    places = [(x, y) for x in (-0.5, -0.15, 0.2, 0.55) for y in (-0.4, 0.0, 0.4)]
    balls = [
        {
            "position": [*(np.array(places[k]) + rng.uniform(-0.04, 0.04, 2)), R],
            "radius": R,
            "mass": rng.uniform(0.5, 2.0),
            "velocity": [*rng.uniform(-2.0, 2.0, 2), 0.0],
            "angular_velocity": rng.uniform(-10.0, 10.0, 3).tolist(),
        }
        for k in rng.choice(len(places), rng.integers(2, 5), replace=False)
    ]
    angle = math.radians(rng.uniform(20.0, 80.0))
    cushions = [
        {"normal": [-math.sin(angle) * x, -math.sin(angle) * y, math.cos(angle)], "point": [0.8 * x, 0.8 * y, 0.0]}
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    contact = {"restitution": rng.choice([0.0, 0.4, 0.9]), "static_friction": rng.uniform(0.0, 0.6)}
    return {"contact": contact, "plane": [{}, *cushions], "body": balls}


def test_balls_that_meet_on_a_table_err_by_the_square_of_the_step() -> None:
    errors = []
    for seed in range(12):
        scene = balls_on_a_table(seed)
        steps = (once := ended(0.5, {}, **scene)).step
        finer, finest = (ended(0.5, {"fixed_dt": 0.5 / steps / k}, **scene) for k in (8, 64))
        errors.append([np.abs(each.state.position - finest.state.position).max() for each in (once, finer)])
    usual, finer = np.median(errors, axis=0)
    assert usual < 1e-6  # m; 1.7e-4 if impacts ignore what supports give. Few scenes are chaotic within 0.5 s
    assert finer < usual / 8**2 * 4  # 4: impacts fall anywhere within their steps


@pytest.mark.parametrize("dt", [4e-3, 1e-3])
@pytest.mark.parametrize("wind", [(0.7, -0.4, 0.0), (0.0, 0.0, 0.3)])
def test_a_floor_at_a_constant_velocity_is_a_floor_at_rest_in_its_own_frame(
    wind: tuple[float, float, float], dt: float
) -> None:
    """A belt and a lift: the same impacts and the same losses; only the work of the floor differs."""

    def after(drift: np.ndarray[Any, Any]) -> tuple[Space, list[float]]:
        slides = rolling(angular_velocity=[0.0, 0.0, 0.0], velocity=(np.array([V, 0.0, 0.0]) + drift).tolist())
        rests = rolling(0.35, position=[0.35, 0.06, R], velocity=drift.tolist(), angular_velocity=[0.0, 0.0, 5.0])
        floor = cloth(0.3)[0] | {"motion": {"velocity": drift.tolist()}}
        contact = {"restitution": 0.5, "static_friction": 0.3}
        space = ended(0.4, {"fixed_dt": dt}, contact, plane=[floor], body=[slides, rests])
        return space, [space.ledger.restitution, space.ledger.friction]

    (still, losses), drift = after(np.zeros(3)), np.array(wind)
    moving, further = after(drift)
    assert moving.state.velocity - drift == pytest.approx(still.state.velocity, abs=ROUNDED)
    assert moving.state.position - 0.4 * drift == pytest.approx(still.state.position, abs=ROUNDED)
    assert moving.state.angular_velocity == pytest.approx(still.state.angular_velocity, abs=10.0 * ROUNDED)
    assert further == pytest.approx(losses, rel=10.0 * ROUNDED)
    assert losses[0] > 0.1 and losses[1] > 0.1


@pytest.mark.parametrize("offset", [0.0, 0.06, 0.12])
def test_a_rolling_ball_throws_and_spins_the_ball_that_it_hits_as_the_closed_form_says(offset: float) -> None:
    e, mu, masses = 0.8, 0.2, (1.0, 1.3)
    along = math.sqrt(4 * R * R - offset * offset)
    normal, velocity, spin = np.array([along, offset, 0.0]) / (2 * R), np.array([V, 0, 0]), np.array([0, V / R, 0])
    inertia = [0.4 * m * R * R for m in masses]

    closing = float(velocity @ normal)
    slip = velocity - closing * normal + np.cross(spin, R * normal)
    inverse_mass = 1 / masses[0] + 1 / masses[1]
    push = (1 + e) * closing / inverse_mass
    stops = float(np.linalg.norm(slip)) / (inverse_mass + R * R / inertia[0] + R * R / inertia[1])
    friction = -min(mu * push, stops) * slip / np.linalg.norm(slip)
    turned = np.cross(R * normal, friction)  # of both balls: the arms are opposite, and so are the impulses
    spins = [spin + turned / inertia[0], turned / inertia[1]]
    velocities = [velocity + (friction - push * normal) / masses[0], (push * normal - friction) / masses[1]]
    velocities[1][2] = 0.0  # a smooth floor without restitution stops the ball that friction presses into it

    hit = {"position": [0.4, offset, R], "radius": R, "mass": masses[1]}
    contact = {"restitution": e, "static_friction": mu, "kinetic_friction": mu}
    floor = {"restitution": 0.0, "static_friction": 0.0, "kinetic_friction": 0.0}
    time = (0.4 - along) / V + 1e-9  # s; in 1 ns, gravity gives 10⁻⁸ m/s
    for step in STEPS:
        state = ended(time, step, contact, plane=[floor], body=[rolling(mass=masses[0]), hit]).state
        assert state.velocity == pytest.approx(np.array(velocities), abs=2e-8)
        assert state.angular_velocity == pytest.approx(np.array(spins), abs=ROUNDED * V / R)
