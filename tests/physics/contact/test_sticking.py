"""Steps with an accuracy end where a contact stops sliding or rolling."""

from __future__ import annotations

from typing import Any

import pytest

from carom.physics.space import Space
from carom.scene.load import Scene
from small_scenes import scene_of

G, R = 9.81, 0.03  # m/s², m


def ball_on_a_floor(speed: float, spin: float, duration: float, accuracy: float, **contact: Any) -> Scene:
    return scene_of(
        [{"position": [0, 0, R], "velocity": [speed, 0, 0], "angular_velocity": [0, spin, 0], "radius": R}],
        time={"duration": duration, "accuracy": accuracy},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -G]},
        contact={"restitution": 0.0, **contact},
        plane=[{}],
    )


# 0.25 s: it rolls within the last of the steps that all trial runs end together; 0.02 s: within their first step
@pytest.mark.parametrize(("speed", "mu", "duration"), [(2.3, 0.31, 3.0), (2.3, 0.31, 0.25), (0.002, 0.3, 0.02)])
def test_a_sliding_ball_rolls_after_2v_over_7_mu_g_with_five_sevenths_of_its_speed(
    speed: float, mu: float, duration: float
) -> None:
    accuracy = 1e-8
    space = Space(ball_on_a_floor(speed, 0.0, duration, accuracy, static_friction=mu, kinetic_friction=mu), 1)
    promise, rolls = space.scene.promise, 2.0 * speed / (7.0 * mu * G)
    assert promise is not None and promise.horizon is None and rolls < duration
    space.reach(duration)
    slid = speed * rolls - 0.5 * mu * G * rolls**2
    exact = slid + 5.0 / 7.0 * speed * (duration - rolls)
    # of the size, the radius; the promise allows for rounding, which a ball that moves by metres has
    assert abs(space.state.position[0, 0] - exact) / R <= min(accuracy, max(promise.error) + 1e-12)
    assert space.state.velocity[0, 0] == pytest.approx(5.0 / 7.0 * speed, rel=1e-9)


@pytest.mark.nightly
@pytest.mark.slow  # kernels of many steps are compiled for this law
def test_a_ball_that_resists_rolling_stops_where_its_energy_is_spent() -> None:
    speed, resistance, accuracy = 0.23, 0.03, 1e-8
    law = {"law": "rolling_resistance", "rolling_resistance": {"rolling_friction": resistance}}
    space = Space(ball_on_a_floor(speed, speed / R, 1.5, accuracy, **law), 1)
    space.reach(1.5)  # it stops after 1.09 s
    deceleration = 5.0 / 7.0 * resistance * G
    assert abs(space.state.position[0, 0] - 0.5 * speed**2 / deceleration) / R <= accuracy
