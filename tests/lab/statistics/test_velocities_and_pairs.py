"""Velocity distributions and pair correlations whose values are known in closed form."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from carom.lab.statistics.motion_statistics import fourth_cumulant, peculiar
from carom.lab.statistics.structure_statistics import NEAR, Distances, distances_of, value_at_contact

POINTS = 3000


def test_the_fourth_cumulant_of_maxwellian_samples_is_0_even_of_five_bodies() -> None:
    # four standard errors of 20 000 samples of five velocities, 8/(15 N) each
    velocity = np.random.default_rng(1).standard_normal((20_000, 5, 3))
    states = peculiar(velocity, np.ones(5))
    found = np.mean([fourth_cumulant(state) for state in states])
    assert abs(found) < 4 * sqrt(8 / (15 * 5 * 20_000))


def test_the_fourth_cumulant_of_equal_speeds_is_minus_two_fifths() -> None:
    direction = np.random.default_rng(2).standard_normal((1000, 3))
    direction = np.concatenate([direction, -direction]) / np.linalg.norm(np.tile(direction, (2, 1)), axis=1)[:, None]
    freedom = 3 * (len(direction) - 1)
    assert fourth_cumulant(direction) == pytest.approx(0.6 * (freedom + 2) / freedom - 1, abs=1e-14)
    assert fourth_cumulant(direction) == pytest.approx(-0.4, abs=3 / len(direction))


def test_peculiar_velocities_are_relative_to_the_centre_of_mass_and_weighted_by_the_root_of_the_mass() -> None:
    velocity = np.array([[[3.0, 1.0, 0.0], [0.0, 1.0, 0.0]]])
    assert peculiar(velocity, np.array([1.0, 2.0])) == pytest.approx(
        np.array([[[2.0, 0.0, 0.0], [-sqrt(2.0), 0.0, 0.0]]])
    )


@pytest.mark.parametrize("box", [np.array([9.0, 10.0, 11.0]), None], ids=["periodic", "open"])
def test_random_positions_have_a_pair_correlation_of_1_whatever_the_radii(box: np.ndarray | None) -> None:
    # four standard errors of the pairs found, each counted from both ends
    random = np.random.default_rng(3)
    position = random.uniform(0, 1, (POINTS, 3)) * np.array([9.0, 10.0, 11.0])
    radius = random.uniform(0.1, 0.3, POINTS)
    found, ideal = distances_of(position, radius, box, 3.0).counts(np.linspace(0.0, 3.0, 4))
    assert np.all(np.abs(found / ideal - 1) < 4 * sqrt(2) / np.sqrt(found))


def test_a_cubic_lattice_has_6_12_and_8_neighbours_at_its_first_three_distances() -> None:
    side = 8
    position = np.stack(np.meshgrid(*[np.arange(0.25, side)] * 3), axis=-1).reshape(-1, 3)
    distances = distances_of(position, np.full(side**3, 0.5), np.full(3, float(side)), 1.9)
    found, ideal = distances.counts(np.array([0.9, 1.1, 1.5, 1.8]))
    assert found.tolist() == [6 * side**3, 12 * side**3, 8 * side**3]
    others = side**3 - 1
    assert ideal == pytest.approx(others * 4 * pi / 3 * np.diff(np.array([0.9, 1.1, 1.5, 1.8]) ** 3))


def test_the_value_at_contact_of_a_parabola_is_exact() -> None:
    middle = (NEAR[1:] + NEAR[:-1]) / 2 - 1
    ideal = Distances(np.empty(0), 1e6).counts(NEAR)[1]
    contact, error = value_at_contact(np.stack([ideal * (2.5 - 4 * middle + 3 * middle**2), ideal]))
    assert contact == pytest.approx(2.5, rel=1e-10)
    assert 0.0 < error < 0.01
