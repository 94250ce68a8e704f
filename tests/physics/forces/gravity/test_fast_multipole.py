"""Gravity by fast multipoles: beside the direct sum, within its error, with opposite forces, and the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.forces.gravity.boxes import LEAF
from carom.physics.forces.gravity.fast_multipole.fast_multipole import BRANCH, FastMultipoleGravity
from carom.physics.jit.team import Team
from carom.physics.space import Space
from carom.scene.load import Scene
from gravity_shapes import SHAPES, Shape, ball, errors, masses, plummer, pulled_by, summed, total_pull

FloatArray = NDArray[np.float64]

# docs/physics.md: the median and the 99th percentile of |a - a_direct| / |a_direct| stay below these times θ^6
MEDIAN, PERCENTILE_99 = 0.003, 0.1


def pulled(
    position: FloatArray, mass: FloatArray, theta: float, softening: float = 0.0
) -> tuple[FloatArray, float | None]:
    return pulled_by(FastMultipoleGravity(mass, 1.0, softening, theta), position)


@pytest.mark.parametrize("theta", [pytest.param(0.3, marks=pytest.mark.slow), 0.5, 0.8])
@pytest.mark.parametrize("shape", [plummer, ball])
def test_the_error_falls_with_the_sixth_power_of_the_opening_angle(shape: Shape, theta: float) -> None:
    position, mass = shape(4000), masses(4000)
    error = errors(pulled(position, mass, theta)[0], summed(position, mass)[0])
    assert np.median(error) <= MEDIAN * theta**6
    assert np.percentile(error, 99) <= PERCENTILE_99 * theta**6


@pytest.mark.parametrize("theta", [0.5, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_forces_add_up_to_nothing_but_rounding(shape: Shape, theta: float) -> None:
    position, mass = shape(1000), masses(1000, decades=3.0)
    force = mass[:, None] * pulled(position, mass, theta)[0]
    # About 10³ terms for each body, each rounded by 2⁻⁵³ of the pulls that it stands for; those of opposite sides may
    # cancel. Far from the origin, a centre of mass is rounded by 2⁻⁵³ of its distance, which moves both forces.
    rounding = 1e-14 * (1.0 + np.abs(position.mean(axis=0)).max() / np.ptp(position, axis=0).max())
    assert np.linalg.norm(force.sum(axis=0)) <= rounding * (mass * total_pull(position, mass, 0.0)).sum()


@pytest.mark.parametrize("n", [1, 2, 3, LEAF, LEAF + 1, 33, BRANCH, BRANCH + 1])
@pytest.mark.parametrize("softening", [0.0, 0.3])
def test_any_number_of_bodies_is_summed(n: int, softening: float) -> None:
    position, mass = ball(n), masses(n)
    found, energy = pulled(position, mass, 0.5, softening)
    expected, expected_energy = summed(position, mass, softening)
    assert np.abs(found - expected).max() <= 0.5**6 * np.abs(expected).max()
    assert energy == pytest.approx(expected_energy, rel=1e-5, abs=1e-300)


def test_bodies_at_one_point_have_a_potential_only_with_softening_and_no_pull() -> None:
    position, mass = np.ones((300, 3)), np.ones(300)
    assert pulled(position, mass, 0.5)[1] == 0.0
    found, energy = pulled(position, mass, 0.5, softening=0.5)
    assert energy == pytest.approx(-300 * 299 / 2 / 0.5, rel=1e-12)
    assert np.array_equal(found, np.zeros_like(position))


@pytest.mark.parametrize("power", [-120, 120])
def test_another_unit_of_length_changes_no_digit(power: int) -> None:
    # 2¹²⁰ m is 10³⁶ m; the thirteenth power of a distance would be lost without a unit of its own.
    position, mass = plummer(2000), masses(2000)
    found, energy = pulled(position, mass, 0.5)
    scaled, scaled_energy = pulled(np.ldexp(position, power), mass, 0.5)
    assert energy is not None and scaled_energy is not None
    assert np.array_equal(np.ldexp(scaled, 2 * power), found) and scaled_energy * 2.0**power == energy


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_change_no_bit(threads: int) -> None:
    n = 3 * BRANCH
    position, mass = plummer(n), masses(n)
    serial, parallel = np.empty((n, 3)), np.empty((n, 3))
    energy = FastMultipoleGravity(mass, 1.0, 0.0, 0.7).accelerate(position, serial, potential=True)
    team = Team(threads)
    shared = FastMultipoleGravity(mass, 1.0, 0.0, 0.7, team).accelerate(position, parallel, potential=True)
    assert np.array_equal(serial, parallel) and energy == shared


def test_a_walk_that_runs_out_of_room_is_repeated_with_more() -> None:
    position, mass = plummer(2000), masses(2000)
    gravity = FastMultipoleGravity(mass, 1.0, 0.0, 0.1)
    enough, little = np.empty((2000, 3)), np.empty((2000, 3))
    gravity.accelerate(position, enough, potential=False)
    gravity._buffers = gravity._buffers._replace(left=np.empty((1, 10), np.int64))
    gravity.accelerate(position, little, potential=False)
    assert gravity._buffers.left.shape[1] > 10
    assert np.array_equal(little, enough)


def test_a_cloud_keeps_its_momentum_and_falls_as_by_the_direct_sum() -> None:
    group = {"count": 400, "radius": 0.1, "region": {"shape": "ball", "radius": 3.0}}
    document = {"time": {"max_dt": 0.01, "duration": 0.2}, "group": [group], "contact": {"enabled": False}}
    end = {}
    for method in ("fast-multipole", "direct"):
        space = Space(Scene.from_dict({**document, "gravity": {"constant": 1e-3, "method": method}}))
        start = space.state.position.copy()
        for frame in space.run():
            end[method] = frame.position
    moved = np.linalg.norm(end["direct"] - start, axis=1)
    parted = np.linalg.norm(end["fast-multipole"] - end["direct"], axis=1)
    centre = end["fast-multipole"].mean(axis=0) - start.mean(axis=0)  # equal masses
    assert 0.0 < np.percentile(parted, 99) <= PERCENTILE_99 * 0.5**6 * np.median(moved)
    assert np.linalg.norm(centre) <= 1e-13 * np.linalg.norm(start, axis=1).max()  # 20 steps, rounded by 2⁻⁵³ each
