"""`carom contacts --statistics` on recorded gases, against kinetic theory.

Chapman & Cowling, *The Mathematical Theory of Non-Uniform Gases*: the mean free path 1/(√2 n π σ² g) of hard spheres of
diameter σ and number density n, with the contact value g of Carnahan & Starling, J. Chem. Phys. 51, 635 (1969).
"""

from __future__ import annotations

from math import pi, sqrt

import pytest

import carom
from carom import Recording
from carom.lab.statistics.statistics_report import Statistics

PACKING = 1000 * pi / 6 / 20.0**3  # of elastic-gas: spheres of 1 m
DENSITY = 1000 / 20.0**3  # 1/m³
CONTACT_VALUE = (1 - PACKING / 2) / (1 - PACKING) ** 3


@pytest.fixture(scope="module")
def elastic(tmp_path_factory: pytest.TempPathFactory) -> Statistics:
    """Statistics of the bundled elastic gas, from 1 s on, when it has forgotten its random start."""
    path = tmp_path_factory.mktemp("gas") / "gas.rrd"
    carom.run("elastic-gas", path)
    return Statistics.of(Recording.open(path), 1.0, None, False, lambda _: None)


@pytest.mark.slow
def test_the_free_path_of_an_elastic_gas_is_that_of_kinetic_theory(elastic: Statistics) -> None:
    # 3 %: 10 000 impacts count to 1 %, three times that
    free = elastic.kinds["free_paths"].values
    assert free["mean_free_path"].value == pytest.approx(1 / (sqrt(2) * DENSITY * pi * CONTACT_VALUE), rel=0.03)
