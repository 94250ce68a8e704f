"""Exponentials, logarithms and powers of kernels have the bits of the functions for arrays, on any machine."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carom.physics.exponential import exponential, logarithm, power
from carom.scene import portable_math

ULP = 2.0**-52


@given(st.floats(-700.0, 700.0))
def test_an_exponential_is_right_to_an_ulp_and_has_the_bits_of_the_plain_form(x: float) -> None:
    assert exponential(x) == portable_math.exponential(np.array([x]))[0]
    assert math.isclose(exponential(x), math.exp(x), rel_tol=2 * ULP)


@given(st.floats(1e-300, 1e300))
def test_a_logarithm_is_right_to_an_ulp(x: float) -> None:
    assert math.isclose(logarithm(x), math.log(x), rel_tol=2 * ULP)


@given(st.floats(1e-3, 1e3), st.floats(-10.0, 10.0))
def test_a_power_has_the_bits_of_the_plain_form(base: float, exponent: float) -> None:
    assert power(base, exponent) == portable_math.power(np.array([base]), exponent)[0]


def test_an_exponential_overflows_to_infinity_and_underflows_to_zero() -> None:
    assert exponential(1e4) == math.inf and exponential(-1e4) == 0.0 and math.isnan(exponential(math.nan))
