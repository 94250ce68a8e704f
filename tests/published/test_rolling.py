"""A sphere that slides until it rolls, and spheres that leave a fixed sphere.

Both are problems of every textbook of mechanics (Routh 1905, A Treatise on the Dynamics of a System of Rigid Bodies;
Goldstein, Poole & Safko 2002, Classical Mechanics, ch. 2):

- a full sphere set sliding at v₀ on a plane rolls at 5/7 v₀ after 2 v₀ / 7 μ g;
- a small sphere that starts from rest on top of a large fixed one leaves it at cos θ = 2/3 if it slides without
  friction, and at cos θ = 10/17 if it rolls.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from carom.physics.space import Space
from small_scenes import scene_of

G = 9.81  # m/s²


@pytest.mark.parametrize("dt", [0.01, 0.001])
def test_a_sliding_sphere_rolls_at_five_sevenths_when_friction_has_turned_it(dt: float) -> None:
    mu, v0 = 0.3, 1.0
    expected = 2 * v0 / (7 * mu * G)
    space = Space(
        scene_of(
            [{"position": [0, 0, 1.0], "velocity": [v0, 0, 0]}],
            plane=[{}],
            gravity={"constant": 0.0, "uniform": [0, 0, -G]},
            contact={"static_friction": mu, "kinetic_friction": mu},
            time={"duration": 2 * expected, "fixed_dt": dt},
        )
    )
    rolling_from = None
    for frame in space.run():
        assert frame.angular_velocity is not None
        slip = frame.velocity[0, 0] - frame.angular_velocity[0, 1]
        if rolling_from is None and abs(slip) <= 1e-12 * v0:
            rolling_from = frame.time
    assert rolling_from is not None
    assert 0.0 <= rolling_from - expected <= dt, "it sticks in the step in which the slip ends"
    # The impulses' torque and force are one: whatever they are, v + 2/5 ω r stays; a few hundred of them are rounded.
    assert frame.velocity[0, 0] == pytest.approx(5 / 7 * v0, rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mu", "cosine"), [(0.0, 2 / 3), pytest.param(50.0, 10 / 17, marks=pytest.mark.slow)], ids=["sliding", "rolling"]
)
def test_a_small_sphere_leaves_a_fixed_one_where_its_weight_no_longer_holds_it(mu: float, cosine: float) -> None:
    R, r, dt, start = 1.0, 0.01, 0.00025, 1e-3
    space = Space(
        scene_of(
            [
                {"radius": R, "fixed": True, "mass": 1.0},
                {
                    "position": [(R + r) * math.sin(start), 0.0, (R + r) * math.cos(start)],
                    "radius": r,
                    "mass": 1e-3,
                },
            ],
            gravity={"constant": 0.0, "uniform": [0, 0, -G]},
            contact={"static_friction": mu, "kinetic_friction": mu, "restitution": 0.0},
            time={"duration": 4.0, "fixed_dt": dt},
        )
    )
    left = next(frame for frame in space.run() if frame.time > 0.1 and len(frame.contacts) == 0)
    position = left.position[1]
    # The gap grows as (3 g sin θ θ'/6) t³: it is wider than what counts as touching, 10⁻⁹ (R + r), after 5 × 10⁻⁴ s.
    # The contact is seen to have gone one step later at most, and cos θ changes by sin θ θ' = 2 a second.
    late = 5e-4 + dt
    assert 0.0 <= cosine - position[2] / np.linalg.norm(position) <= 2.0 * late
