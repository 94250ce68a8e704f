"""Gravity by direct sum: right, symmetric, and the same bits on any number of threads."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.forces.gravity.direct import DirectGravity
from carom.physics.jit.team import Team

FloatArray = NDArray[np.float64]


def oracle(position: FloatArray, mass: FloatArray, G: float, softening: float) -> tuple[FloatArray, float]:
    """The sum as the equation says it, in NumPy."""
    d = position[None, :, :] - position[:, None, :]
    r2 = np.sum(d * d, axis=2) + softening**2
    np.fill_diagonal(r2, np.inf)
    acceleration = G * np.sum(mass[None, :, None] * d / r2[:, :, None] ** 1.5, axis=1)
    return acceleration, float(-0.5 * G * np.sum(mass[:, None] * mass[None, :] / np.sqrt(r2)))


def random_cluster(n: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, 3)), rng.uniform(0.1, 2.0, n)


@pytest.mark.parametrize("n", [2, 3, 63, 64, 65, 130, 400])
@pytest.mark.parametrize("softening", [0.0, 0.3])
def test_the_kernel_equals_the_sum_written_in_numpy(n: int, softening: float) -> None:
    position, mass = random_cluster(n)
    acceleration = np.empty((n, 3))
    energy = DirectGravity(mass, 2.5, softening).accelerate(position, acceleration, potential=True)
    expected, expected_energy = oracle(position, mass, 2.5, softening)
    # n terms of relative rounding 2⁻⁵³ each; their sum may cancel, so the bound is relative to the largest.
    assert np.abs(acceleration - expected).max() <= n * 4e-16 * np.abs(expected).max()
    assert energy == pytest.approx(expected_energy, rel=n * 4e-16)


def test_leaving_out_the_potential_changes_no_bit_of_the_acceleration() -> None:
    position, mass = random_cluster(200)
    gravity = DirectGravity(mass, 1.0, 0.0)
    with_potential, without = np.empty((200, 3)), np.empty((200, 3))
    gravity.accelerate(position, with_potential, potential=True)
    gravity.accelerate(position, without, potential=False)
    assert np.array_equal(with_potential, without)


@pytest.mark.parametrize("threads", [2, 3, 4])
def test_threads_change_no_bit(threads: int) -> None:
    position, mass = random_cluster(2500)
    serial, parallel = np.empty((2500, 3)), np.empty((2500, 3))
    DirectGravity(mass, 1.0, 0.0).accelerate(position, serial, potential=False)
    DirectGravity(mass, 1.0, 0.0, Team(threads)).accelerate(position, parallel, potential=False)
    assert np.array_equal(serial, parallel)


def test_coincident_bodies_do_not_pull_each_other() -> None:
    position = np.zeros((3, 3))
    position[2, 0] = 2.0
    acceleration = np.empty((3, 3))
    energy = DirectGravity(np.ones(3), 1.0, 0.0).accelerate(position, acceleration, potential=True)
    assert np.array_equal(acceleration[:, 0], [0.25, 0.25, -0.5])
    assert energy == -1.0


def test_softened_coincident_bodies_have_a_potential_and_no_pull() -> None:
    acceleration = np.empty((2, 3))
    energy = DirectGravity(np.array([1.0, 3.0]), 2.0, 0.5).accelerate(np.zeros((2, 3)), acceleration, True)
    assert energy == pytest.approx(-2.0 * 3.0 / 0.5, rel=1e-15)
    assert np.array_equal(acceleration, np.zeros((2, 3)))


def test_forces_of_a_cluster_add_up_to_nothing() -> None:
    position, mass = random_cluster(500)
    acceleration = np.empty((500, 3))
    DirectGravity(mass, 1.0, 0.0).accelerate(position, acceleration, potential=False)
    force = mass[:, None] * acceleration
    # Each of 500 forces is a sum of 500 terms: round-off of a sum of as many, relative to the sum of magnitudes.
    assert np.abs(force.sum(axis=0)).max() <= 500 * 2.3e-16 * np.abs(force).sum()


def test_a_sphere_of_points_pulls_like_its_mass_at_the_centre() -> None:
    # Newton's shell theorem, exact for a continuous shell; 4000 spread points leave a relative error of about 1/√4000.
    k = np.arange(4000) + 0.5
    z, angle = 1 - 2 * k / 4000, np.pi * (1 + 5**0.5) * k
    shell = np.column_stack((np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z))
    position = np.concatenate((shell, [[3.0, 0.0, 0.0], [0.2, 0.1, 0.0]]))
    mass = np.concatenate((np.full(4000, 1 / 4000), [1e-12, 1e-12]))
    acceleration = np.empty((4002, 3))
    DirectGravity(mass, 1.0, 0.0).accelerate(position, acceleration, potential=False)
    assert acceleration[4000] == pytest.approx([-1 / 9, 0, 0], abs=1e-3)
    assert acceleration[4001] == pytest.approx([0, 0, 0], abs=1e-3)
