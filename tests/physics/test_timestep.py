"""The adaptive step keeps its bounds, at any speed of the whole and any mixture of radii."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest

from carom.physics.team import Team
from carom.physics.timestep import BLOCK, SOME, Timestep
from carom.scene.schema import Time
from examples import random_bodies

NO_FIELD = np.zeros(3)


def still() -> Any:
    bodies = random_bodies(5, seed=1)
    bodies.velocity[:] = 0.0
    bodies.acceleration[:] = 0.0
    return bodies


def test_without_motion_the_step_is_the_cap() -> None:
    assert Timestep(Time(max_dt=0.7), 0.5, 0.01, NO_FIELD).choose(still(), math.inf) == (0.7, "cap")


def test_one_body_in_motion_gets_the_cap() -> None:
    bodies = random_bodies(1, seed=1)
    bodies.velocity[:] = [1e6, 0.0, 0.0]
    assert Timestep(Time(max_dt=0.7), 0.5, 0.01, NO_FIELD).choose(bodies, math.inf) == (0.7, "cap")


def test_the_largest_acceleration_moves_a_body_no_further_than_target_dx() -> None:
    bodies = still()
    bodies.acceleration[2] = [3.0, 0.0, 4.0]
    dt, limit = Timestep(Time(max_dt=100.0), 0.5, 0.1, NO_FIELD).choose(bodies, math.inf)
    assert limit == "acceleration"
    assert 0.5 * 5.0 * dt * dt == pytest.approx(0.1, rel=1e-15)


def test_no_body_crosses_more_than_its_part_of_its_own_radius() -> None:
    bodies = random_bodies(50, seed=3)
    dt, limit = Timestep(Time(max_dt=100.0), 0.3, 0.01, NO_FIELD).choose(bodies, math.inf)
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
    dt, limit = Timestep(Time(max_dt=100.0), 0.5, 0.01, NO_FIELD).choose(bodies, math.inf)
    assert limit == "velocity"
    assert 0.1 * dt + 0.5 * 5.0 * dt * dt == pytest.approx(0.5e-3, rel=1e-7)


def test_a_scene_that_falls_as_a_whole_gets_the_same_steps() -> None:
    field = np.array([0.0, 0.0, -8.0])
    bodies, falling = random_bodies(20, seed=2), random_bodies(20, seed=2)
    falling.acceleration[:] += field
    at_rest = Timestep(Time(max_dt=100.0), 0.5, 0.01, NO_FIELD).choose(bodies, math.inf)
    assert Timestep(Time(max_dt=100.0), 0.5, 0.01, field).choose(falling, math.inf) == at_rest


@pytest.mark.parametrize("rule", ["every-body", "fastest-body"])
@pytest.mark.parametrize("target_dx", [1e-9, 1.0])
def test_threads_that_share_the_bodies_find_the_same_step(
    rule: Literal["every-body", "fastest-body"], target_dx: float
) -> None:
    bodies, time = random_bodies(2 * SOME * BLOCK + 1, seed=4), Time(max_dt=100.0, velocity_limit=rule)
    bodies.acceleration[:] = bodies.velocity[::-1]
    bodies.velocity[[3, -3]] = [100.0, 0.0, 0.0]  # which of two equals sets the limit must not depend on them either
    chosen = {
        Timestep(time, 0.5, target_dx, NO_FIELD, team=Team(threads)).choose(bodies, math.inf) for threads in (1, 2, 4)
    }
    assert len(chosen) == 1


def test_the_seeds_rule_lets_a_small_body_tunnel_and_ours_does_not() -> None:
    bodies = still()
    bodies.radius[:] = [10.0, 0.1, 1.0, 1.0, 1.0]
    bodies.mass[:] = 1.0
    bodies.velocity[:] = 0.0
    bodies.velocity[0, 0], bodies.velocity[2, 0] = 5.0, -5.0
    bodies.velocity[1, 1], bodies.velocity[3, 1] = 4.9, -4.9
    crossed = {
        rule: Timestep(Time(max_dt=100.0, velocity_limit=rule), 0.5, 0.01, NO_FIELD).choose(bodies, math.inf)[0]
        * 4.9
        / 0.1
        for rule in ("every-body", "fastest-body")
    }
    assert crossed["every-body"] == pytest.approx(0.5)
    assert crossed["fastest-body"] > 2.0


def test_a_scene_that_moves_as_a_whole_gets_the_same_steps() -> None:
    bodies, moving = random_bodies(20, seed=2), random_bodies(20, seed=2)
    moving.velocity[:] += np.array([1e6, -1e6, 1e6])
    at_rest = Timestep(Time(max_dt=100.0), 0.5, 0.01, NO_FIELD).choose(bodies, math.inf)[0]
    boosted = Timestep(Time(max_dt=100.0), 0.5, 0.01, NO_FIELD).choose(moving, math.inf)[0]
    # Adding 1e6 m/s rounds speeds of order 1 to 1.2e-10 each.
    assert boosted == pytest.approx(at_rest, rel=1e-9)


def test_growth_is_smoothed_and_a_shrink_is_taken_at_once() -> None:
    bodies = still()
    bodies.radius[:] = 10.0
    timestep = Timestep(Time(max_dt=1.0, smoothing=0.25), 0.5, 0.5, NO_FIELD)
    bodies.acceleration[0] = [1e4, 0.0, 0.0]
    assert timestep.choose(bodies, math.inf)[0] == pytest.approx(0.01)
    bodies.acceleration[0] = 0.0
    dt, limit = timestep.choose(bodies, math.inf)
    assert dt == pytest.approx(0.01 + 0.25 * 0.99) and limit == "growth"
    bodies.acceleration[0] = [1e4, 0.0, 0.0]
    assert timestep.choose(bodies, math.inf)[0] == pytest.approx(0.01)


def test_the_last_step_ends_the_run_exactly_and_is_never_a_sliver() -> None:
    timestep = Timestep(Time(fixed_dt=0.1), 0.5, 0.01, NO_FIELD)
    assert timestep.choose(still(), 0.25) == (0.1, "fixed")
    assert timestep.choose(still(), 0.05) == (0.05, "end")
    assert timestep.choose(still(), 0.1 + 1e-13) == (0.1 + 1e-13, "end")
