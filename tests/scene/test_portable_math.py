"""Starts have the same bits on any processor: powers and cube roots are computed by basic operations alone."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from carom.scene.portable_math import cosine_and_sine, cube_root, power

ULP = 2.0**-52

PLACE = """
import hashlib
from carom.physics.placement import place
from carom.scene.load import Scene

for radius in ({"distribution": "log-uniform"}, {"distribution": "power-law", "exponent": -3.5}):
    group = {"count": 500, "radius": {"min": 0.01, "max": 0.1, **radius}}
    start = place(Scene.from_dict({"group": [group, {**group, "region": {"radius": 9.0, "centre": [20.0, 0.0, 0.0]}}]}))
    print(hashlib.sha256(start.position.tobytes() + start.radius.tobytes()).hexdigest())
"""


def test_cube_roots_are_right_to_the_last_two_bits() -> None:
    x = np.concatenate((np.random.default_rng(0).random(100_000), [0.0, 1.0, 8.0, 27.0, 1e300, 1e-300, 5e-324]))
    exact = np.cbrt(x.astype(np.longdouble)).astype(np.float64)  # np.cbrt of doubles is wrong by up to 3 ULP
    assert np.allclose(cube_root(x), exact, rtol=2 * ULP, atol=0)


def test_sines_and_cosines_are_right_to_the_last_two_bits_and_exact_at_right_angles() -> None:
    degrees = np.concatenate((np.random.default_rng(0).uniform(-720, 720, 10_000), [0.0, 90.0, 180.0, 270.0, 360.0]))
    cosine, sine = cosine_and_sine(degrees)
    turns = np.fmod(degrees, 360.0).astype(np.longdouble) * (4 * np.arctan(np.longdouble(1)) / 180)
    assert np.allclose(cosine, np.cos(turns).astype(np.float64), rtol=0, atol=2 * ULP)
    assert np.allclose(sine, np.sin(turns).astype(np.float64), rtol=0, atol=2 * ULP)
    assert cosine[-5:].tolist() == [1.0, 0.0, -1.0, 0.0, 1.0] and sine[-5:].tolist() == [0.0, 1.0, 0.0, -1.0, 0.0]


def test_powers_are_right_to_the_rounding_of_their_exponent() -> None:
    rng = np.random.default_rng(0)
    base, exponent = np.exp(rng.uniform(-20, 20, 100_000)), rng.uniform(-4, 4, 100_000)
    # b^p = e^(p ln b): a rounding of p ln b, up to 80, counts 80 times in the result
    assert np.allclose(power(base, exponent), base**exponent, rtol=2 * 80 * ULP, atol=0)
    assert power(np.array([1.0, 4.0]), 0.5).tolist() == [1.0, 2.0]


@pytest.mark.slow
def test_bodies_are_placed_with_the_same_bits_where_numpy_has_no_wide_instructions() -> None:
    dispatched = " ".join(np._core._multiarray_umath.__cpu_dispatch__)  # type: ignore[attr-defined]
    starts = []
    for disabled in ("", dispatched):
        command = [sys.executable, "-W", "ignore", "-c", PLACE]
        environment = os.environ | {"NPY_DISABLE_CPU_FEATURES": disabled}
        starts.append(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)
    assert starts[0] == starts[1] and len(starts[0].split()) == 2


@pytest.mark.parametrize("value", [1.0, 2.5])
def test_a_power_of_one_changes_nothing(value: float) -> None:
    assert power(np.array([value]), 1.0)[0] == pytest.approx(value, rel=4 * ULP)
