"""The pressure in a silo: Janssen's law, from the fields of a recording.

Janssen, Z. Ver. dtsch. Ing. 39, 1045 (1895), translated by Sperl, Granular Matter 8, 59 (2006, arXiv cond-mat/0511618):
walls that carry friction carry a part of the weight, and the vertical stress at the depth z is

    σ_zz = ρ g λ (1 - exp(-z/λ)),    λ = R/(2 μ K),

of a cylinder of radius R with friction μ, on which the horizontal stress is K σ_zz. It saturates at ρ g λ, whatever the
height of the filling. All contacts with the wall are to slide. Vanel & Clément, Eur. Phys. J. B 11, 525 (1999),
therefore lower the floor slowly; so does this test. Poured spheres alone press on the floor with nearly their whole
weight.
Landry, Grest & Plimpton (2003, arXiv cond-mat/0302115) find that packings of spheres follow the law but for a
hydrostatic layer at their top.
"""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import carom
from carom.arrays import FloatArray

RADIUS, HEIGHT = 3.0, 18.0  # m, of the filling; spheres have a diameter of 1 m and a mass of 1 kg, g = 1 m/s²
FRICTION = 0.5
AREA = pi * RADIUS**2
COUNT = int(0.58 * AREA * HEIGHT / (pi / 6))
TALL = COUNT * (pi / 6) / (0.28 * pi * (RADIUS - 0.5) ** 2) + 1.0  # m, of the random start
SETTLED, SINKS, END = 12.0, 0.05, 20.0  # s, m/s, s
EDGE = 1.5  # m, of a cell


def silo(path: Path) -> carom.Recording:
    rough = {"static_friction": FRICTION, "kinetic_friction": FRICTION, "restitution": 0.2, "sweeps": "quick"}
    centre = [0.0, 0.0, TALL / 2]
    region = {"shape": "cylinder", "radius": RADIUS - 0.02, "height": TALL, "centre": centre}
    document = {
        "seed": 1,
        "time": {"duration": END, "max_dt": 0.02},
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        "contact": rough,
        "plane": [{"name": "floor", "motion": {"times": [SETTLED], "velocities": [[0.0, 0.0, -SINKS]]}}],
        "wall": [{"name": "silo", "cylinder": {"radius": RADIUS}}],
        "record": {"every": 0.25},
        "group": [{"count": COUNT, "radius": 0.5, "mass": 1.0, "region": region}],
    }
    return carom.run(carom.Scene.from_dict(document), path)


def profile(recording: carom.Recording, start: float, end: float) -> tuple[FloatArray, FloatArray]:
    """Return the vertical stress (Pa) of each layer of cells, and the weight above its middle over the area (Pa)."""
    found = carom.fields(recording, EDGE, start=start, end=end, replay=True)
    part = EDGE**2 / AREA
    stress = (found.contact_stress + found.kinetic_stress)[..., 2, 2].sum(axis=(0, 1)) * part
    layer = found.density.sum(axis=(0, 1)) * part * EDGE
    filled = layer > 0.5 * EDGE  # without the layer of the surface
    above = np.cumsum(layer[::-1])[::-1] - layer / 2
    return stress[filled], above[filled]


@pytest.mark.nightly
@pytest.mark.slow
def test_the_pressure_at_the_bottom_of_a_silo_saturates_as_janssen_found(tmp_path: Path) -> None:
    recording = silo(tmp_path / "run.rrd")
    stress, weight = profile(recording, 17.0, END)
    bottom, whole = stress[0], weight[0]
    # a liquid would press with its whole weight; R/(2 μ K) is 3 to 10 m for K from 1, a liquid's, to 0.3
    saturation = brentq(lambda p: p * (1.0 - np.exp(-whole / p)) - bottom, 0.1 * bottom, whole)
    assert 0.3 < RADIUS / (2.0 * FRICTION * saturation) < 1.0
    # the law has one length for all depths; 20 % of the saturation, as single layers of 50 spheres fluctuate
    law = saturation * (1.0 - np.exp(-weight / saturation))
    assert stress == pytest.approx(law, abs=0.2 * saturation)
