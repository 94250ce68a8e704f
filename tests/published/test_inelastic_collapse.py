"""Three beads on a line: below e = 7 - 4√3 = 0.0718 they collide infinitely often in a finite time.

McNamara & Young, Phys. Fluids A 4, 496 (1992): collisions alternate between the two pairs, and the three stay together
where they shrink the differences of velocity without end; above that restitution the beads part after a finite number.
The velocities after an impact do not depend on when it comes, only on the order, so the end can be computed collision
by collision and carom has to meet it at any dt. At the end of a step one sweep lets each collision be
counted; at their own moments each counts by itself.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.space import Space
from small_scenes import scene_of

COLLAPSE = 7 - 4 * sqrt(3)
GAPS = (0.3, 0.4)  # m, unequal: the left pair meets first
SPEEDS = (1.0, 0.0, -1.0)  # m/s
DURATION = 40.0  # s


def beads(restitution: float, **contact: int | str) -> Space:
    """Run three unit beads of which the outer two fly at the one at rest."""
    places = (-1.0 - GAPS[0], 0.0, 1.0 + GAPS[1])
    bodies = [
        {"radius": 0.5, "mass": 1.0, "position": [x, 0, 0], "velocity": [v, 0, 0]}
        for x, v in zip(places, SPEEDS, strict=True)
    ]
    sections = {"restitution": restitution, "static_friction": 0.0, **contact}
    space = Space(
        scene_of(bodies, gravity={"constant": 0.0}, contact=sections, time={"fixed_dt": 0.01, "duration": DURATION})
    )
    for _ in space.run():
        pass
    return space


def collide_alternately(restitution: float) -> tuple[int, NDArray[np.float64]]:
    """Collide left, right, left, right, … until the beads part; return how often, and the velocities then."""
    velocity = np.array(SPEEDS)
    count = 0
    while True:
        pair = slice(count % 2, count % 2 + 2)
        first, second = velocity[pair]
        if second >= first:
            return count, velocity
        mean, half = (first + second) / 2, (first - second) / 2
        velocity[pair] = mean - restitution * half, mean + restitution * half
        count += 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("restitution", "collisions"), [(1.0, 3), (0.7, 3), (0.3, 4), (0.15, 5), (0.1, 6), (0.08, 11), (0.075, 17)]
)
@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
def test_beads_above_the_threshold_part_after_as_many_collisions_as_they_must(
    timing: str, restitution: float, collisions: int
) -> None:
    # Round-off: each collision adds half an ulp of 1 m/s or two.
    space = beads(restitution, timing=timing, sweeps=1)
    expected, velocity = collide_alternately(restitution)
    assert expected == collisions
    assert space.extremes.impacts == collisions
    assert np.allclose(space.state.velocity[:, 0], velocity, rtol=0, atol=collisions * 2.3e-16)


@pytest.mark.slow
@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
@pytest.mark.parametrize("sweeps", [1, 1000])
@pytest.mark.parametrize("restitution", [0.0, 0.0715])
def test_beads_below_the_threshold_collapse_into_one_and_the_run_goes_on(
    restitution: float, sweeps: int, timing: str
) -> None:
    # Infinitely many collisions come in a finite time, yet each step has a bounded number of sweeps. What is left of
    # the differences of velocity is no more than round-off of 1 m/s; each pair stays in contact to the same.
    assert restitution < COLLAPSE
    space = beads(restitution, timing=timing, sweeps=sweeps)
    assert space.time == DURATION
    assert np.abs(space.state.velocity).max() <= 2.3e-16
    assert np.allclose(np.diff(space.state.position[:, 0]), 1.0, rtol=0, atol=1e-9)
    assert space.energy().relative_error <= 1e-15
