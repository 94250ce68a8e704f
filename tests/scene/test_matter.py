"""Radii drawn from a distribution, and masses from densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from carom.scene.load import scene_from_dict
from carom.scene.matter import drawn_radii, mass_of

DRAWN = 20_000
SIGNIFICANCE = 1e-3  # of a Kolmogorov-Smirnov test; the seed is fixed


@pytest.mark.parametrize("exponent", [-3.5, -2.0, -1.0, 0.0, 1.5])
def test_radii_of_a_power_law_have_its_cumulative_distribution(exponent: float) -> None:
    radius = {"min": 0.5, "max": 4.0, "distribution": "power-law", "exponent": exponent}
    (group,) = scene_from_dict({"group": [{"count": DRAWN, "radius": radius}]}).group
    low, high, p = 0.5, 4.0, exponent + 1.0

    def cumulative(r: np.ndarray) -> np.ndarray:
        """Integrate r^exponent from the smallest radius."""
        return np.asarray(np.log(r / low) / np.log(high / low) if p == 0.0 else (r**p - low**p) / (high**p - low**p))

    drawn = drawn_radii(group, np.random.default_rng(1))
    assert stats.kstest(drawn, cumulative).pvalue > SIGNIFICANCE


def test_a_sphere_of_a_density_has_the_mass_of_its_volume() -> None:
    (body,) = scene_from_dict({"body": [{"radius": 2.0, "density": 3.0}]}).body
    assert float(mass_of(body, np.array(2.0))) == pytest.approx(3.0 * 4.0 / 3.0 * np.pi * 8.0, rel=1e-15)
