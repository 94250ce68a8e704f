"""Slow impacts bounce by their law, unless something presses the pair together along its normal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom.physics.contact.constraints import CONTACT, CONTACT_STATE
from carom.physics.contact.loads import LOAD, write_rest_speeds
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.scene.rest_speed import PER_STEP

RADIUS = 0.02
V = 0.05  # m/s, of the body that moves; a fall for one of these steps ends at 7 to 15 cm/s
ROUNDED = 1e-9  # of V: some 10³ steps, in each of which a floor holds the bodies to within 10⁻¹³
FIELD = 9.81


def marble(x: float, speed: float = 0.0, **further: Any) -> dict[str, Any]:
    return {"radius": RADIUS, "position": [x, 0.0, RADIUS], "velocity": [speed, 0.0, 0.0]} | further


def ended(bodies: list[dict[str, Any]], duration: float, restitution: float = 1.0, **further: Any) -> Space:
    """Run bodies on a smooth floor."""
    friction = further.pop("friction", 0.0)
    document: dict[str, Any] = {
        "body": bodies,
        "plane": [{}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -FIELD]},
        "contact": {"restitution": restitution, "static_friction": friction, **further.pop("contact", {})},
        "time": {"duration": duration},
    }
    space = Space(Scene.from_dict(document | further), threads=1)
    for _ in space.run():
        pass
    error = space.extremes.energy_error
    assert error is not None and error.value <= 1e-12
    return space


@pytest.mark.parametrize("contact", [{}, {"timing": "end-of-step"}])
@pytest.mark.parametrize(("restitution", "speed"), [(1.0, V), (0.5, V), (1.0, 1e-3)])
def test_two_marbles_on_a_floor_bounce_by_their_law(restitution: float, speed: float, contact: dict[str, str]) -> None:
    space = ended([marble(0.0, speed), marble(0.041)], 0.04 / speed / 20.0, restitution, contact=contact)
    expected = [0.5 * (1.0 - restitution), 0.5 * (1.0 + restitution)]
    assert space.state.velocity[:, 0] / speed == pytest.approx(expected, abs=ROUNDED)


def test_marbles_bounce_in_a_crowd_that_asks_for_long_steps() -> None:
    crowd = [
        marble(0.1 * k, 0.0) | {"position": [0.1 * k, 1.0 + 0.1 * row, RADIUS]} for k in range(10) for row in range(10)
    ]
    space = ended([marble(0.0, V), marble(0.045), *crowd], 0.2)
    assert space.state.velocity[:2, 0] / V == pytest.approx([0.0, 1.0], abs=ROUNDED)


def test_the_last_of_a_touching_row_leaves_at_the_speed_of_the_first() -> None:
    space = ended([marble(-0.005, V), *(marble(2.0 * RADIUS * (k + 1)) for k in range(5))], 1.5)
    assert space.state.velocity[:, 0] / V == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], abs=ROUNDED)


def test_a_marble_bounces_off_a_wall_that_nothing_presses_it_to() -> None:
    wall = {"point": [0.021, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]}
    space = ended([marble(0.0, 1e-3)], 2.0, plane=[{}, wall])
    assert space.state.velocity[0, 0] == pytest.approx(-1e-3, rel=ROUNDED)


def test_a_rolling_ball_hits_one_at_rest_and_both_roll_on_as_rigid_bodies_do() -> None:
    # e = 1. The surface of the rolling ball moves down at V where it touches the other. Friction sticks (μ = 0.2 is
    # above 1/7), so the impulse m V/7 takes 5/14 of the spin of the first and gives it to the other backwards. From
    # then on each keeps its angular momentum about its point of contact with the floor, (2 R ω/V + 5 u/V)/7 of V.
    rolls = marble(0.0, V, angular_velocity=[0.0, V / RADIUS, 0.0])
    space = ended([rolls, marble(0.045)], 1.0, friction=0.2)
    expected = [2.0 / 7.0 * (1.0 - 5.0 / 14.0), 5.0 / 7.0 - 2.0 / 7.0 * 5.0 / 14.0]
    assert space.state.velocity[:, 0] / V == pytest.approx(expected, abs=1e-6)


def test_what_presses_a_pair_is_the_relative_acceleration_and_the_load_along_the_normal() -> None:
    a = np.array([[0.0, 0.0, -FIELD]] * 2 + [[0.0, 0.0, 0.0]])
    loads = np.zeros(3, LOAD)
    up, along = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)

    def between(i: int, j: int, normal: tuple[float, float, float]) -> float:
        contacts, states = np.zeros(1, CONTACT), np.zeros(1, CONTACT_STATE)
        for name, component in zip(("nx", "ny", "nz"), normal, strict=True):
            contacts[name] = component
        pressed = np.zeros((3, 3)), a, loads, 1.0 / PER_STEP
        write_rest_speeds(0, 1, np.array([[i, j]]), contacts, pressed, np.array([np.inf]), states)
        return float(states["rest_speed"][0])

    assert between(0, 1, along) == 0.0, "in free fall beside each other"
    assert between(0, 2, (0.0, 0.0, -1.0)) == FIELD, "on a floor, before it carries"
    loads["z"][0] = loads["zz"][0] = FIELD  # the floor now carries the first
    assert between(0, 1, along) == 0.0, "beside each other on the floor"
    assert between(0, 1, up) == 2.0 * FIELD, "the second falls on the first, which the floor carries"
    loads["z"][1], loads["zz"][1] = FIELD, FIELD  # the first now carries the second
    assert between(0, 1, up) == 2.0 * FIELD, "in a column, where nothing accelerates"
