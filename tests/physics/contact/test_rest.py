"""A contact at rest closes no faster than gravity makes it, whatever happens in other piles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from carom.physics.contact.events.time_of_impact import step_by_impacts
from carom.physics.contact.islands import Islands
from carom.physics.jit.team import SOLO, Team
from carom.physics.space import Space
from small_scenes import scene_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NO_FIELD = np.zeros(3)


def load_speeds(
    pairs: IntArray, acceleration: FloatArray, inverse_mass: FloatArray, field: FloatArray, dt: float, team: Team = SOLO
) -> FloatArray:
    speeds: FloatArray = np.full(len(pairs), np.nan)
    state = (acceleration, inverse_mass, field, dt)
    presses = Islands(len(acceleration), team).write_load_speeds(pairs, np.unique(pairs), *state, speeds)
    assert presses == np.any(speeds > 0.0)
    return speeds


def test_the_load_speed_is_what_gravity_causes_in_a_step_and_no_field_counts() -> None:
    acceleration = np.array([[3.0, 0.0, -9.0], [0.0, 0.0, -9.0], [100.0, 0.0, 0.0]])
    pairs = np.array([[0, 1]])
    assert load_speeds(pairs, acceleration, np.ones(3), np.array([0.0, 0.0, -9.0]), 0.1) == pytest.approx(
        [2 * 3.0 * 0.1]
    )
    assert load_speeds(pairs, np.zeros((3, 3)), np.ones(3), NO_FIELD, 0.1) == pytest.approx([0.0])


def test_a_pile_shares_its_load_and_piles_are_apart() -> None:
    acceleration = np.zeros((7, 3))
    acceleration[3, 0], acceleration[6, 0] = 4.0, 9.0
    pairs = np.array([[0, 2], [1, 2], [1, 3], [4, 5], [5, 6]])
    assert np.array_equal(load_speeds(pairs, acceleration, np.ones(7), NO_FIELD, 1.0), [8.0, 8.0, 8.0, 18.0, 18.0])


def test_piles_are_what_a_search_of_the_graph_finds_on_any_number_of_threads() -> None:
    # Bodies in random order along many rows, with fixed ones that pass nothing on.
    rng = np.random.default_rng(2)
    n = 40_000
    rows = rng.permutation(n).reshape(200, -1)
    pairs = np.sort(np.stack((rows[:, :-1], rows[:, 1:]), axis=-1).reshape(-1, 2), axis=1)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    inverse_mass = np.where(rng.random(n) < 0.01, 0.0, 1.0)
    acceleration = rng.standard_normal((n, 3)) * (inverse_mass > 0.0)[:, None]
    moving = pairs[np.all(inverse_mass[pairs] > 0.0, axis=1)]
    graph = coo_array((np.ones(len(moving)), (moving[:, 0], moving[:, 1])), shape=(n, n))
    pile = connected_components(graph, directed=False)[1]
    squares = acceleration[:, 0] ** 2 + acceleration[:, 1] ** 2 + acceleration[:, 2] ** 2
    largest = np.zeros(pile.max() + 1)
    np.maximum.at(largest, pile, squares)
    mover = np.where(inverse_mass[pairs[:, 0]] > 0.0, pairs[:, 0], pairs[:, 1])
    expected = 2.0 * np.sqrt(largest[pile[mover]]) * 0.1
    for threads in (1, 2, 4):
        assert np.array_equal(load_speeds(pairs, acceleration, inverse_mass, NO_FIELD, 0.1, Team(threads)), expected)


def test_an_impact_keeps_its_bounce_beside_a_heavy_pile_far_away() -> None:
    light: list[dict[str, Any]] = [
        {"position": [-1.5, 0, 0], "velocity": [0.2, 0, 0], "mass": 1e-6},
        {"position": [1.5, 0, 0], "velocity": [-0.2, 0, 0], "mass": 1e-6},
    ]
    heavy: list[dict[str, Any]] = [
        {"position": [0, 1e4 - 1, 0], "mass": 40.0},
        {"position": [0, 1e4 + 1, 0], "mass": 40.0},
    ]
    space = Space(
        scene_of(
            light + heavy,
            gravity={"constant": 1.0},
            contact={"restitution": 1.0, "static_friction": 0.0},
            time={"duration": 4.0, "fixed_dt": 0.03},
        )
    )
    for _ in space.run():
        pass
    # The heavy pair pulls the light ones by 80/10⁸ m/s² for 4 s, both alike to a part in 10⁴.
    assert np.allclose(space.state.velocity[:2, 0], [-0.2, 0.2], rtol=0, atol=1e-5)


def test_balls_at_rest_on_each_other_that_close_by_rounding_end_no_step() -> None:
    """In a uniform field nothing pulls one towards the other, so any closing speed seems to be an impact."""
    position = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 1.5]])
    velocity = np.array([[0.0, 0.0, -4e-23], [0.0, 0.0, -8e-22]])
    field, radius = np.full((2, 3), [0.0, 0.0, -9.81]), np.full(2, 0.5)
    none = np.zeros((0, 3)), np.zeros(0)
    apart, held = np.zeros((0, 2), np.int64), np.array([[0, 1]])
    assert step_by_impacts(position, velocity, field, radius, *none, apart, 0.01) == np.inf
    velocity[1, 2] = -1e-6
    assert step_by_impacts(position, velocity, field, radius, *none, apart, 0.01) < 0.01
    assert step_by_impacts(position, velocity, field, radius, *none, held, 0.01) == np.inf
