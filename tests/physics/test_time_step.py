"""The adaptive step keeps its bounds, at any speed of the whole and any mixture of radii."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest

from carom.errors import PhysicsError
from carom.physics.batch_step import BatchStepper
from carom.physics.jit.team import Team
from carom.physics.space import Space
from carom.physics.step import KickDriftStepper
from carom.physics.step_rule import BODIES_PER_BLOCK, step_of_largest
from carom.physics.time_step import MIN_SHARED_BLOCKS, Timestep
from carom.plan.auto import PAIRS_UP_TO, StepLimits
from carom.scene.load import Scene
from carom.scene.schema import Time
from small_scenes import kinetic_energy_of, random_bodies

NO_FIELD = np.zeros(3)


def still() -> Any:
    bodies = random_bodies(5, seed=1)
    bodies.velocity[:] = 0.0
    bodies.acceleration[:] = 0.0
    return bodies


def test_without_motion_the_step_is_the_cap() -> None:
    assert Timestep(Time(), StepLimits(0.7, 0.5, 0.01), NO_FIELD).choose(still(), math.inf) == (0.7, "cap")


def test_one_body_in_motion_gets_the_cap() -> None:
    bodies = random_bodies(1, seed=1)
    bodies.velocity[:] = [1e6, 0.0, 0.0]
    assert Timestep(Time(), StepLimits(0.7, 0.5, 0.01), NO_FIELD).choose(bodies, math.inf) == (0.7, "cap")


def test_the_largest_acceleration_moves_a_body_no_further_than_target_dx() -> None:
    bodies = still()
    bodies.acceleration[2] = [3.0, 0.0, 4.0]
    dt, limit = Timestep(Time(), StepLimits(100.0, 0.5, 0.1), NO_FIELD).choose(bodies, math.inf)
    assert limit == "acceleration"
    assert 0.5 * 5.0 * dt * dt == pytest.approx(0.1, rel=1e-15)


def test_no_body_crosses_more_than_its_part_of_its_own_radius() -> None:
    bodies = random_bodies(50, seed=3)
    dt, limit = Timestep(Time(), StepLimits(100.0, 0.3, 0.01), NO_FIELD).choose(bodies, math.inf)
    centre_velocity = bodies.mass @ bodies.velocity / bodies.mass.sum()
    crossed = np.linalg.norm(bodies.velocity - centre_velocity, axis=1) * dt / bodies.radius
    assert limit == "velocity"
    assert crossed.max() == pytest.approx(0.3, rel=1e-14)


def test_an_acceleration_moves_no_body_further_than_its_part_of_its_radius_either() -> None:
    bodies = still()
    bodies.radius[:] = 1e-3
    bodies.acceleration[2] = [0.0, 5.0, 0.0]
    bodies.velocity[2] = [0.1, 0.0, 0.0]
    bodies.mass[2] = 1e-9
    dt, limit = Timestep(Time(), StepLimits(100.0, 0.5, 0.01), NO_FIELD).choose(bodies, math.inf)
    assert limit == "velocity"
    assert 0.1 * dt + 0.5 * 5.0 * dt * dt == pytest.approx(0.5e-3, rel=1e-7)


def test_a_scene_that_falls_as_a_whole_gets_the_same_steps() -> None:
    field = np.array([0.0, 0.0, -8.0])
    bodies, falling = random_bodies(20, seed=2), random_bodies(20, seed=2)
    falling.acceleration[:] += field
    at_rest = Timestep(Time(), StepLimits(100.0, 0.5, 0.01), NO_FIELD).choose(bodies, math.inf)
    assert Timestep(Time(), StepLimits(100.0, 0.5, 0.01), field).choose(falling, math.inf) == at_rest


@pytest.mark.parametrize("rule", ["every-body", "fastest-body"])
@pytest.mark.parametrize("target_dx", [1e-9, 1.0])
def test_threads_that_share_the_bodies_find_the_same_step(
    rule: Literal["every-body", "fastest-body"], target_dx: float
) -> None:
    bodies, time = (
        random_bodies(2 * MIN_SHARED_BLOCKS * BODIES_PER_BLOCK + 1, seed=4),
        Time(velocity_limit=rule),
    )
    bodies.acceleration[:] = bodies.velocity[::-1]
    bodies.velocity[[3, -3]] = [100.0, 0.0, 0.0]  # which of two equals sets the limit must not depend on them either
    limits = StepLimits(100.0, 0.5, target_dx)
    chosen = {Timestep(time, limits, NO_FIELD, team=Team(threads)).choose(bodies, math.inf) for threads in (1, 2, 4)}
    assert len(chosen) == 1


def test_the_seeds_rule_lets_a_small_body_tunnel_and_ours_does_not() -> None:
    bodies = still()
    bodies.radius[:] = [10.0, 0.1, 1.0, 1.0, 1.0]
    bodies.mass[:] = 1.0
    bodies.velocity[:] = 0.0
    bodies.velocity[0, 0], bodies.velocity[2, 0] = 5.0, -5.0
    bodies.velocity[1, 1], bodies.velocity[3, 1] = 4.9, -4.9
    limits = StepLimits(100.0, 0.5, 0.01)
    crossed = {
        rule: Timestep(Time(velocity_limit=rule), limits, NO_FIELD).choose(bodies, math.inf)[0] * 4.9 / 0.1
        for rule in ("every-body", "fastest-body")
    }
    assert crossed["every-body"] == pytest.approx(0.5)
    assert crossed["fastest-body"] > 2.0


def test_a_scene_that_moves_as_a_whole_gets_the_same_steps() -> None:
    bodies, moving = random_bodies(20, seed=2), random_bodies(20, seed=2)
    moving.velocity[:] += np.array([1e6, -1e6, 1e6])
    at_rest = Timestep(Time(), StepLimits(100.0, 0.5, 0.01), NO_FIELD).choose(bodies, math.inf)[0]
    boosted = Timestep(Time(), StepLimits(100.0, 0.5, 0.01), NO_FIELD).choose(moving, math.inf)[0]
    # Adding 1e6 m/s rounds speeds of order 1 to 1.2e-10 each.
    assert boosted == pytest.approx(at_rest, rel=1e-9)


def test_growth_is_smoothed_and_a_shrink_is_taken_at_once() -> None:
    bodies = still()
    bodies.radius[:] = 10.0
    timestep = Timestep(Time(), StepLimits(1.0, 0.5, 0.5, smoothing=0.25), NO_FIELD)
    bodies.acceleration[0] = [1e4, 0.0, 0.0]
    assert timestep.choose(bodies, math.inf)[0] == pytest.approx(0.01)
    bodies.acceleration[0] = 0.0
    dt, limit = timestep.choose(bodies, math.inf)
    assert dt == pytest.approx(0.01 + 0.25 * 0.99) and limit == "growth"
    bodies.acceleration[0] = [1e4, 0.0, 0.0]
    assert timestep.choose(bodies, math.inf)[0] == pytest.approx(0.01)


def test_the_last_step_ends_the_run_exactly_and_is_never_a_sliver() -> None:
    timestep = Timestep(Time(fixed_dt=0.1), StepLimits(1.0, 0.5, 0.01), NO_FIELD)
    assert timestep.choose(still(), 0.25) == (0.1, "fixed")
    assert timestep.choose(still(), 0.05) == (0.05, "end")
    assert timestep.choose(still(), 0.1 + 1e-13) == (0.1 + 1e-13, "end")


POINTS: dict[str, Any] = {"gravity": {"constant": 1.0}, "contact": {"enabled": False}}
CORNERS = {3.0: [1.0, 3.0, 0.0], 4.0: [-2.0, -1.0, 0.0], 5.0: [1.0, -1.0, 0.0]}


def pythagorean(radius: float) -> Scene:
    """Let masses of 3, 4 and 5 fall from rest at the corners of their triangle, past the encounter at t = 15.83."""
    bodies = [{"mass": mass, "position": x, "radius": radius} for mass, x in CORNERS.items()]
    return Scene.from_dict({**POINTS, "body": bodies, "time": {"duration": 20.0}})


def binary(eccentricity: float, orbits: int, **time: Any) -> Scene:
    """Let two masses of 1/2 and a metre's radius orbit each other at a distance of 1 m, from apocentre."""
    x, v = 0.5 * (1 + eccentricity), 0.5 * math.sqrt((1 - eccentricity) / (1 + eccentricity))
    bodies = [{"mass": 0.5, "position": [s * x, 0.0, 0.0], "velocity": [0.0, s * v, 0.0]} for s in (-1.0, 1.0)]
    return Scene.from_dict({**POINTS, "body": bodies, "time": {"duration": orbits * 2 * math.pi, **time}})


def finished(scene: Scene) -> Space:
    space = Space(scene)
    for _ in space.run():
        pass
    return space


def test_points_in_units_of_one_keep_their_energy_by_default_whatever_their_radius() -> None:
    # Limited by radii of 1 m these three fly apart within the first encounter. In the closest one, at a distance of
    # 4e-4, the error is 4.6e-6 of the total energy; at the end 1.1e-8.
    spaces = [finished(pythagorean(radius)) for radius in (1.0, 1e-3)]
    for space in spaces:
        error = space.extremes.energy_error
        assert error is not None and error.value < 1e-5
        assert space.energy().relative_error < 1e-7
    assert spaces[0].fingerprint() == spaces[1].fingerprint()
    assert spaces[0].step == spaces[1].step


@pytest.mark.parametrize("eccentricity", [0.0, 0.9])
def test_an_eccentric_binary_without_contacts_returns_to_its_apocentre_by_default(eccentricity: float) -> None:
    # Yoshida's method errs in phase by 2.6e-9 an orbit at 0.9, and keeps energy and shape to round-off.
    space = finished(binary(eccentricity, 10))
    back = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]) * (1 + eccentricity)
    assert np.abs(space.state.position - back).max() < 1e-7
    assert space.energy().relative_error < 1e-12


def test_the_step_of_the_pulls_does_not_drift_in_or_out_of_an_encounter() -> None:
    # Leapfrog's error swings by 1.5e-5 of the scale in each orbit of e = 0.9. Were the step chosen by the state at its
    # beginning alone, it would add up, to 10 % of that in each.
    space = finished(binary(0.9, 20, integrator="leapfrog"))
    swing = space.extremes.energy_error
    assert swing is not None and space.energy().relative_error < 1e-3 * swing.value


def pull_step(scene: Scene) -> tuple[float, str]:
    stepper = Space(scene)._stepper
    assert isinstance(stepper, KickDriftStepper | BatchStepper)
    return stepper.timestep.target(Space(scene).state)


def stepper_of(space: Space) -> KickDriftStepper:
    assert isinstance(space._stepper, KickDriftStepper)
    return space._stepper


def test_a_circular_orbit_gets_the_stated_part_of_the_time_of_its_pair() -> None:
    dt, limit = pull_step(binary(0.0, 1))
    assert limit == "pull"
    assert dt == pytest.approx(0.01 / math.sqrt(2.0), rel=1e-12)  # r = v = G(m_i + m_j) = 1
    assert pull_step(binary(0.0, 1, pull_fraction=0.1))[0] == pytest.approx(0.1 / math.sqrt(2.0), rel=1e-12)


def test_a_given_target_dx_or_cfl_limits_the_step_where_nothing_can_touch() -> None:
    dt, limit = pull_step(binary(0.0, 1, target_dx=1e-4))  # each is pulled by 1/2
    assert limit == "acceleration" and dt == pytest.approx(math.sqrt(4e-4), rel=1e-12)
    dt, limit = pull_step(binary(0.0, 1, cfl=1e-3))
    assert limit == "velocity" and dt == pytest.approx(2e-3, rel=2e-3)  # of a radius of 1 at 1/2, and the pull's part


def test_of_many_bodies_the_step_is_never_longer_than_twice_that_of_an_isolated_pair() -> None:
    # More bodies than are looked at in pairs: two of them 10⁻³ apart among others 1 apart, all of the same mass.
    count = PAIRS_UP_TO + 1
    bodies = random_bodies(count, seed=1)
    bodies.mass[:] = 1.0
    bodies.velocity[:] = 0.0
    bodies.acceleration[:] = 0.0
    bodies.acceleration[:2] = [[1e6, 0.0, 0.0], [-1e6, 0.0, 0.0]]
    scene = Scene.from_dict({"time": {"pull_fraction": 1.0}, "body": [{"mass": 1.0}]})
    rule = Timestep.of(scene, StepLimits(math.inf, None, None, pull_fraction=1.0), bodies, NO_FIELD, Team(1)).rule[0]
    assert not rule["examines_pairs"]
    assert rule["mean"] == rule["constant"]
    assert step_of_largest(1e6, 1.0, 0.0, 1.0) == pytest.approx(
        1e-3**1.5, rel=1e-12
    )  # √(r³/G m): a pair at rest has √2 less
    assert step_of_largest(0.1, 1.0, 0.1, 1.0) == pytest.approx(max(0.1**-0.75, 1.0), rel=1e-12)


@pytest.mark.parametrize(("length", "time"), [(2.0, 1.0), (1.0, 2.0), (2.0**9, 2.0**4), (2.0**-5, 2.0**3)])
@pytest.mark.parametrize("softening", [0.0, 0.3])
def test_the_step_of_the_largest_pull_has_the_same_bits_in_units_that_are_powers_of_two(
    length: float, time: float, softening: float
) -> None:
    acceleration, mean = length / time**2, length**3 / time**2
    for a, gm in np.random.default_rng(7).uniform(0.01, 10.0, (50, 2)):
        here = step_of_largest(a, gm, softening, 0.1)
        assert step_of_largest(a * acceleration, gm * mean, softening * length, 0.1) == here * time


def test_points_that_fall_into_each_other_end_the_run_and_say_what_would_help() -> None:
    scene = binary(0.0, 1)
    bodies = [body.model_copy(update={"velocity": (0.0, 0.0, 0.0)}) for body in scene.body]
    with pytest.raises(PhysicsError, match=r"set gravity\.softening"):
        finished(scene.model_copy(update={"body": tuple(bodies)}))


def test_where_nothing_can_touch_and_nothing_pulls_the_cap_sets_the_step() -> None:
    bodies = [{"velocity": [float(k), 0.0, 0.0], "position": [0.0, 3.0 * k, 0.0]} for k in range(2)]
    document = {"body": bodies, "contact": {"enabled": False}, "gravity": {"constant": 0.0}}
    assert pull_step(Scene.from_dict(document)) == (1.0, "cap")


def huddle(*far: dict[str, Any]) -> Scene:
    """Let three touching spheres rest on each other, G = 1, and others fly far from them."""
    triangle = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, math.sqrt(3.0), 0.0]]
    bodies = [{"position": x, "mass": 1.0, "radius": 1.0} for x in triangle]
    time = {"duration": 1000.0, "max_dt": 100.0}
    return Scene.from_dict({"body": [*bodies, *far], "gravity": {"constant": 1.0}, "time": time})


def after(scene: Scene, steps: int) -> Space:
    space = Space(scene)
    for step in range(1, steps + 1):
        space.compute_dynamics(step)
    return space


def test_bodies_that_rest_on_each_other_get_the_step_of_many_bodies_at_any_number() -> None:
    # Each is pulled by √3/4, and held by 1/4 at two contacts. Three in flight get 0.003 of a fall, 33 times the steps.
    space = after(huddle(), 60)
    pull = math.sqrt(3.0) / 4.0
    assert stepper_of(Space(huddle())).timestep.target(space.state)[0] == pytest.approx(
        0.003 * math.sqrt(2.0 / pull), rel=1e-6
    )
    assert space.first_dt == pytest.approx(0.1 * math.sqrt(2.0 / 0.5), rel=1e-6)
    assert space.dt > 0.9 * space.first_dt and space.dt_limit in ("held", "growth")
    assert kinetic_energy_of(space.state) < 1e-15, "and stays at rest"


def test_a_body_in_flight_keeps_its_own_step_beside_a_pile_at_rest() -> None:
    space = after(huddle({"position": [30.0, 0.0, 0.0], "velocity": [0.0, 0.3, 0.0], "mass": 1e-6, "radius": 1.0}), 60)
    fall = np.linalg.norm(space.state.acceleration[3])
    dt, limit = stepper_of(space).timestep.target(space.state, stepper_of(space).supported_acceleration())
    assert limit == "acceleration" and dt == pytest.approx(0.004 * math.sqrt(2.0 / fall), rel=1e-12)


def test_two_that_roll_about_each_other_turn_in_some_six_hundred_steps() -> None:
    # At half the angular speed of an orbit: three quarters of gravity are supported.
    ends = [{"position": [s, 0.0, 0.0], "velocity": [0.0, 0.25 * s, 0.0], "angular_velocity": [0.0, 0.0, 0.25]}
            for s in (-1.0, 1.0)]  # fmt: skip
    bodies = [{**end, "mass": 1.0, "radius": 1.0} for end in ends]
    scene = Scene.from_dict({"body": bodies, "gravity": {"constant": 1.0}, "time": {"duration": 100.0}})
    space = after(scene, 100)
    assert len(space.contacts) == 1
    assert space.first_dt == pytest.approx(0.01 / 0.25, rel=1e-3)


def test_the_impulses_that_hold_a_body_are_in_the_checkpoint() -> None:
    space = after(huddle(), 60)
    again = Space(huddle())
    again.restore(space.frame().checkpoint)
    assert again.first_dt == space.first_dt
    supported = stepper_of(space).supported_acceleration()
    assert np.array_equal(stepper_of(again).supported_acceleration(), supported) and len(supported) == 3


def test_a_body_squeezed_between_heavy_ones_keeps_the_short_step() -> None:
    scene = Scene.load("extremes/mass-ratio-squeezed")
    space = after(scene, 20)
    assert space.dt == pytest.approx(Space(scene).first_dt, rel=1e-6)
