"""Flow of spheres down a rough chute.

Silbert, Ertaş, Grest, Halsey, Levine & Plimpton, Phys. Rev. E 64, 051302 (2001): between an angle of repose of some 20
degrees, a few degrees more for thin layers, and a largest angle of some 28 degrees the flow becomes steady; spheres
stop below these angles, and accelerate above 30 degrees. The lower layers move more slowly than the upper ones.
"""

from __future__ import annotations

import numpy as np
import pytest

from carom import Scene, Space
from carom.arrays import FloatArray

FIXED = 50  # bodies of the bed
G = 9.81  # m/s²


def flow(degrees: float, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean speed of the bundled chute at some times, and those of its lower and upper half at the last."""
    angle = np.radians(degrees)
    field = [float(G * np.sin(angle)), 0.0, float(-G * np.cos(angle))]
    space = Space(Scene.load("chute", [f"gravity.uniform={field}"]))
    speeds = []
    for time in times:
        space.reach(float(time))
        frame = space.frame()
        speeds.append(frame.velocity[FIXED:, 0].mean())
    height, speed = frame.position[FIXED:, 2], frame.velocity[FIXED:, 0]
    upper = height > np.median(height)
    assert frame.energy.relative_error < 3e-5  # as the scene promises
    return np.array(speeds), np.array([speed[~upper].mean(), speed[upper].mean()])


@pytest.mark.nightly
@pytest.mark.slow
def test_spheres_on_a_rough_chute_stop_flow_steadily_or_accelerate_by_its_angle() -> None:
    stopped, _ = flow(18.0, np.array([2.0]))
    assert stopped[0] < 1e-3  # of some 0.5 m/s at the other angles
    steady, halves = flow(26.0, np.array([3.0, 4.0]))
    assert steady[1] > 0.3
    assert halves[1] > 2.0 * halves[0]
    # without a bed, the acceleration is g sin θ; 5 % of it is the fluctuation of 300 spheres in a second
    assert abs(steady[1] - steady[0]) < 0.05 * G * np.sin(np.radians(26.0))
    accelerated, _ = flow(40.0, np.array([1.0, 2.0]))
    assert accelerated[1] - accelerated[0] > 0.1 * G * np.sin(np.radians(40.0))
