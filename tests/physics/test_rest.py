"""A contact at rest closes no faster than gravity makes it; what other piles do is their business."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom.physics.contact.rest import rest_speeds
from carom.physics.space import Space
from examples import scene_of

NO_FIELD = np.zeros(3)


def test_the_rest_speed_is_what_gravity_causes_in_a_step_and_no_field_counts() -> None:
    acceleration = np.array([[3.0, 0.0, -9.0], [0.0, 0.0, -9.0], [100.0, 0.0, 0.0]])
    pairs = np.array([[0, 1]])
    assert rest_speeds(pairs, acceleration, np.ones(3), np.array([0.0, 0.0, -9.0]), 0.1) == pytest.approx(
        [2 * 3.0 * 0.1]
    )
    assert rest_speeds(pairs, np.zeros((3, 3)), np.ones(3), NO_FIELD, 0.1) == pytest.approx([0.0])


def test_a_pile_shares_its_load_and_piles_are_apart() -> None:
    acceleration = np.zeros((7, 3))
    acceleration[3, 0], acceleration[6, 0] = 4.0, 9.0
    pairs = np.array([[0, 2], [1, 2], [1, 3], [4, 5], [5, 6]])
    assert np.array_equal(rest_speeds(pairs, acceleration, np.ones(7), NO_FIELD, 1.0), [8.0, 8.0, 8.0, 18.0, 18.0])


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
