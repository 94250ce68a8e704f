"""Head-on impacts of two spheres: Newton's law of restitution (Principia, 1687, scholium to the laws of motion)."""

from __future__ import annotations

import numpy as np
import pytest

from carom.physics.space import Space
from small_scenes import scene_of

EPSILON = float(np.finfo(float).eps)


def after_impact(speeds: tuple[float, float], masses: tuple[float, float], restitution: float) -> tuple[float, float]:
    """Let two unit spheres meet on the x axis; return their velocities after it."""
    left = {"position": [-1.5, 0.0, 0.0], "velocity": [speeds[0], 0.0, 0.0], "mass": masses[0]}
    right = {"position": [1.5, 0.0, 0.0], "velocity": [speeds[1], 0.0, 0.0], "mass": masses[1]}
    crossing = 3.0 / (speeds[0] - speeds[1])  # s
    time = {"duration": crossing, "max_dt": crossing, "cfl": 0.1}
    scene = scene_of([left, right], gravity={"constant": 0.0}, contact={"restitution": restitution}, time=time)
    space = Space(scene)
    for _ in space.run():
        pass
    assert space.extremes.impacts == 1
    assert not space.state.velocity[:, 1:].any()
    return float(space.state.velocity[0, 0]), float(space.state.velocity[1, 0])


@pytest.mark.parametrize("speed", [1.0, 3.0, 0.1, 1e-9, 1e9, 2 / 3])
def test_an_elastic_sphere_that_hits_an_equal_one_at_rest_hands_over_its_velocity_to_the_last_bit(speed: float) -> None:
    # No tolerance: for equal masses (1 + 1) v / 2 is v in floating point, too. Jolt once let both move at half speed.
    assert after_impact((speed, 0.0), (1.0, 1.0), 1.0) == (0.0, speed)


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("masses", [(1.0, 1.0), (1.0, 3.0), (1e-6, 1.0), (1e6, 1.0)])
def test_unequal_spheres_part_at_e_times_their_approach_and_keep_their_momentum(
    restitution: float, masses: tuple[float, float]
) -> None:
    # Round-off: half a dozen operations, each to half an ulp of the largest term.
    before = (2.0, -0.7)
    after = after_impact(before, masses, restitution)
    approach, momentum = before[0] - before[1], masses[0] * before[0] + masses[1] * before[1]
    scale = masses[0] * abs(before[0]) + masses[1] * abs(before[1])
    assert after[1] - after[0] == pytest.approx(restitution * approach, abs=8 * EPSILON * approach)
    assert masses[0] * after[0] + masses[1] * after[1] == pytest.approx(momentum, abs=8 * EPSILON * scale)
