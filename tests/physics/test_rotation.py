"""Orientations rotate by exactly ω dt, with carom's own sine and cosine."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from carom.physics.rotation import BLOCK, rotate, rotate_one, sine_cosine
from seeds import examples


@examples(500)
@given(theta=st.floats(0, 1e5))
def test_sine_and_cosine_are_right_to_the_last_bits(theta: float) -> None:
    sine, cosine = sine_cosine(theta)
    # Two units in the last place of a number in [½, 1): one from the reduced angle, one from the series.
    assert abs(sine - math.sin(theta)) <= 2.3e-16
    assert abs(cosine - math.cos(theta)) <= 2.3e-16


@examples(100)
@given(
    omega=st.tuples(*[st.floats(-50, 50)] * 3),
    start=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_a_step_is_the_rotation_that_scipy_computes(
    omega: tuple[float, float, float], start: tuple[float, float, float, float]
) -> None:
    q = np.array([start]) / np.linalg.norm(start)
    expected = Rotation.from_rotvec(np.array(omega) * 0.1) * Rotation.from_quat(q[0])
    rotate(q, np.array([omega]), 0.1)
    # A dozen products of numbers of order 1, each rounded by 1.1e-16.
    assert abs(abs(q[0] @ expected.as_quat()) - 1) <= 3e-15
    assert np.linalg.norm(q[0]) == pytest.approx(1.0, abs=3e-16)


@examples(200)
@given(theta=st.floats(1e5, 1e300))
def test_however_far_a_body_turns_its_orientation_is_a_rotation(theta: float) -> None:
    sine, cosine = sine_cosine(theta)
    assert sine * sine + cosine * cosine == pytest.approx(1.0, abs=1e-15)


def test_a_body_that_does_not_spin_keeps_its_bits() -> None:
    q = np.array([[0.1, 0.2, 0.3, math.sqrt(1 - 0.14)]])
    before = q.copy()
    rotate(q, np.zeros((1, 3)), 1.0)
    assert np.array_equal(q, before)


def test_a_thousand_turns_in_a_thousand_steps_end_where_they_began() -> None:
    q = np.array([[0.0, 0.0, 0.0, 1.0]])
    for _ in range(1000):
        rotate(q, np.array([[0.0, 0.0, 2 * math.pi]]), 1.0)
    # Each turn is ω dt = 2π rounded, 2.4e-16 rad off the real 2π, and adds a rounding of the product.
    assert abs(q[0, 2]) <= 1000 * 2.3e-16


@settings(max_examples=50, deadline=None)
@given(count=st.integers(1, 2 * BLOCK + 1), seed=st.integers(0, 2**32 - 1), dt=st.sampled_from([1e-3, -0.7, 1e6]))
def test_bodies_turned_in_blocks_have_the_bits_of_bodies_turned_one_by_one(count: int, seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    spins = rng.normal(size=(count, 3)) * rng.choice([0.0, 1e-160, 1.0, 50.0], size=(count, 1))
    in_blocks = rng.normal(size=(count, 4))
    in_blocks /= np.linalg.norm(in_blocks, axis=1)[:, None]
    one_by_one = in_blocks.copy()
    rotate(in_blocks, spins, dt)
    for i in range(count):
        rotate_one(i, one_by_one, spins, dt)
    assert np.array_equal(in_blocks, one_by_one)
