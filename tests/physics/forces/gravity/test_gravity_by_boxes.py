"""Common promises of gravity by a tree and by fast multipoles."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.forces.gravity.fast_multipole.fast_multipole import FastMultipoleGravity
from carom.physics.forces.gravity.tree import TreeGravity
from gravity_shapes import SHAPES, Shape, ball, masses, plummer, pulled_by, summed, total_pull

FloatArray = NDArray[np.float64]
Method = type[TreeGravity] | type[FastMultipoleGravity]
METHODS: tuple[Method, ...] = (TreeGravity, FastMultipoleGravity)

# A box that is seen just under θ = 1/2 leaves out its octupole, at worst 4 θ³ of its pull and about θ³ for a pair of
# bodies. With few boxes these do not average out. A pair of boxes leaves out about θ⁶, and at worst 7 θ⁶ at the edge of
# a box.
BOUNDS = ((TreeGravity, 0.1 * 0.5**3, 0.5**3, 1e-3), (FastMultipoleGravity, 0.1 * 0.5**6, 7 * 0.5**6, 1e-4))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("softening", [0.0, 0.1])
@pytest.mark.parametrize(("method", "median", "largest", "of_energy"), BOUNDS)
def test_any_shape_is_summed_within_the_opening_error(
    shape: Shape, softening: float, method: Method, median: float, largest: float, of_energy: float
) -> None:
    position, mass = shape(1000), masses(1000)
    found, energy = pulled_by(method(mass, 1.0, softening, 0.5), position)
    expected, expected_energy = summed(position, mass, softening)
    error = np.linalg.norm(found - expected, axis=1) / total_pull(position, mass, softening)
    assert np.median(error) <= median
    assert np.max(error) <= largest
    assert energy == pytest.approx(expected_energy, rel=of_energy)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("method", METHODS)
def test_an_angle_of_almost_nothing_leaves_a_direct_sum(shape: Shape, method: Method) -> None:
    position, mass = shape(300), masses(300)
    found, energy = pulled_by(method(mass, 1.0, 0.0, 1e-9), position)
    expected, expected_energy = summed(position, mass)
    # 300 terms in another order, each rounded by 2⁻⁵³ relative to the largest; a box of coincident bodies is one term
    # at a centre of mass that is rounded, too, which far from the origin moves it by 2⁻⁵³ |x| / d.
    rounding = 300 * 4e-16 * (1.0 + np.abs(position.mean(axis=0)).max())
    assert np.abs(found - expected).max() <= rounding * np.abs(expected).max()
    assert energy == pytest.approx(expected_energy, rel=rounding)


@pytest.mark.parametrize("potential", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_the_bits_do_not_depend_on_earlier_sums(method: Method, potential: bool) -> None:
    position, mass = plummer(1000), masses(1000)
    gravity = method(mass, 1.0, 0.0, 0.5)
    fresh, used = np.empty((1000, 3)), np.empty((1000, 3))
    gravity.accelerate(position, fresh, potential=True)
    gravity.accelerate(ball(1000), used, potential=True)
    gravity.accelerate(position, used, potential=potential)
    assert np.array_equal(fresh, used)


@pytest.mark.parametrize("method", METHODS)
def test_a_state_that_is_not_finite_still_comes_to_an_end(method: Method) -> None:
    position, mass = plummer(1000), masses(1000)
    position[3], position[5], position[7], position[9] = np.nan, np.inf, -np.inf, [0.0, np.inf, np.nan]
    pulled_by(method(mass, 1.0, 0.0, 0.5), position)
