"""Flow out of a hopper: Beverloo's law.

Beverloo, Leniger & van de Velde, Chem. Eng. Sci. 15, 260 (1961): W = C ρ √g (D - k d)^{5/2} through a round outlet of
the diameter D, whatever the height of the filling. For spheres k is about 1.5, and C = 0.55 to 0.65 for a flat bottom;
a cone lets more through (Nedderman, Statics and Kinematics of Granular Materials, Cambridge 1992, chapter 10).
"""

from __future__ import annotations

import numpy as np
import pytest

from carom import Scene, Space

OUTLETS = np.array([0.18, 0.195, 0.21, 0.225, 0.24])  # m; at 0.16 spheres jam, at 0.26 half are out in 0.2 s
OUTLET, SPHERE, G = 0.3, 0.04, 9.81  # m, height of the outlet; m, mean diameter; m/s²
FIRST, LAST = 60, 220  # spheres that have left when the flow is steady, and when the cone still is full
PACKING = 0.58  # of a filling that flows


def flow(diameter: float, seed: int) -> float:
    """Return the spheres that leave the bundled hopper in a second, without rolling resistance."""
    overrides = [
        f"seed={seed}",
        f"wall.1.cone.radius={diameter / 2}",
        "contact.rolling_resistance.rolling_friction=0",
        "contact.sweeps=quick",
    ]
    space = Space(Scene.load("hopper", overrides))
    times, left = [], []
    for frame in space.run():
        count = int((frame.position[:, 2] < OUTLET).sum())
        if count > LAST:
            break
        if count >= FIRST:
            times.append(frame.time)
            left.append(count)
    return float(np.polyfit(times, left, 1)[0])


@pytest.mark.nightly
@pytest.mark.slow
def test_the_flow_out_of_a_hopper_grows_as_beverloo_measured() -> None:
    # Runs scatter by 4 %, the mean of two by 3 %, and with it the exponent by 0.1; k ± 0.1 changes it by 0.1. 0.3 is
    # twice the sum in quadrature. C is that of a flat bottom or, since the cone guides the flow, a third larger.
    flows = np.array([np.mean([flow(float(diameter), seed) for seed in (1, 2)]) for diameter in OUTLETS])
    effective = OUTLETS - 1.4 * SPHERE
    exponent = np.polyfit(np.log(effective), np.log(flows), 1)[0]
    assert exponent == pytest.approx(2.5, abs=0.3)
    grain = PACKING / (np.pi / 6 * SPHERE**3)  # 1/m³, spheres in the filling
    constants = flows / (grain * np.sqrt(G) * effective**2.5)
    assert 0.55 < constants.mean() < 0.85
