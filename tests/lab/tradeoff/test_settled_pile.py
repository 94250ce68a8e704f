"""The settled state of a pile, which settings are compared by where trajectories are not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carom.lab.compared_run import Trajectory
from carom.lab.tradeoff.settled_pile import Pile
from carom.scene.load import Scene
from small_scenes import scene_of

RADIUS, MASS, PULL = 0.05, 2.0, 10.0  # m, kg, m/s²
TIMES = np.linspace(0.0, 1.0, 11)[1:]  # s
COLUMN = Pile(np.full(3, MASS), np.full(3, RADIUS), np.array([0.0, 0.0, -PULL]), None)


def column(gap: float = 0.0, rests_from: float = 0.55) -> Trajectory:
    """Return three balls above each other, which fall at 1 m/s until a time (s) and then rest."""
    x = np.array([[0.0, 0.0, RADIUS + k * (2.0 * RADIUS + gap)] for k in range(3)])
    v = np.zeros((len(TIMES), 3, 3))
    v[rests_from >= TIMES, :, 2] = -1.0
    return Trajectory.exact(TIMES, np.tile(x, (len(TIMES), 1, 1)), v, {}, 0)


def test_a_column_of_three_has_the_settled_state_of_its_geometry() -> None:
    found = COLUMN.settled(column())
    assert found.height == pytest.approx(3.0 * RADIUS, rel=1e-12)
    # three balls in a box of their own, 2 r by 2 r by 6 r
    assert found.density == pytest.approx(math.pi / 6.0, rel=1e-12)
    assert found.coordination == pytest.approx(4.0 / 3.0)  # two contacts, each of two bodies
    assert found.settled_energy == pytest.approx(3.0 * MASS * PULL * 3.0 * RADIUS, rel=1e-12)
    assert found.rest_time == pytest.approx(0.6)  # the first sample at rest


def test_a_looser_column_errs_in_height_density_and_contacts() -> None:
    errors = COLUMN.errors(column(gap=0.01, rests_from=0.75), column())
    assert errors["height"] == pytest.approx(0.01 / (3.0 * RADIUS))
    assert errors["density"] == pytest.approx(1.0 - 1.0 / (1.0 + errors["height"]))
    assert errors["coordination"] == pytest.approx(4.0 / 3.0)
    assert errors["rest_time"] == pytest.approx(0.2)


def test_the_scatter_is_the_standard_deviation_over_seeds() -> None:
    others = [COLUMN.settled(column(gap=gap)) for gap in (0.01, 0.02)]
    scatter = COLUMN.scatter(others, column())
    assert scatter["height"] == pytest.approx(0.01 / (3.0 * RADIUS))  # heights of 0.15, 0.16 and 0.17 m
    assert scatter["rest_time"] == pytest.approx(0.1), "the time between two samples"


def pile(**changes: object) -> Scene:
    group = {"count": 3, "radius": RADIUS, "mass": MASS, "region": {"shape": "box", "size": [1.0, 1.0, 1.0]}}
    keys = {"gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -PULL]}, "plane": [{"point": [0.0, 0.0, -1.0]}]}
    return scene_of([], **({"group": [group]} | keys | changes))


def test_only_placed_bodies_that_settle_in_a_field_are_a_pile() -> None:
    assert Pile.of(pile()) is not None
    assert Pile.of(pile(gravity={"constant": 0.0})) is None
    assert Pile.of(pile(contact={"enabled": False})) is None
    assert Pile.of(scene_of([{"position": [0.0, 0.0, 1.0], "radius": 0.1}], plane=[{}])) is None
