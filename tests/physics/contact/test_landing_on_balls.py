"""Balls that land on balls: after the last bounce they slide or roll on, and no longer hop from step to step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom import Scene, Space
from carom.physics.schedule import every

R, r = 0.5, 0.1  # m, of the ball below and of the ball that lands
DT = 2e-3  # s
SLIPPERY = {"restitution": 0.0, "static_friction": 0.05, "kinetic_friction": 0.05}


def landing(gap: float, contact: dict[str, Any], below: dict[str, Any], planes: list[dict[str, Any]]) -> Space:
    """Return a ball of 1 kg that moves along the top of another, with a gap (m) between them."""
    across = 0.05
    above = [0.0, across, np.sqrt((R + r + gap) ** 2 - across**2)]
    ball = {"radius": r, "mass": 1.0, "position": above, "velocity": [0.5, 0.0, 0.0]}
    document = {
        "body": [{"radius": R, "position": [0.0, 0.0, 0.0]} | below, ball],
        "plane": planes,
        "contact": contact,
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        "time": {"duration": 0.1, "fixed_dt": DT},
    }
    return Space(Scene.from_dict(document))


@pytest.mark.parametrize("gap", [1e-6, 1e-4])
@pytest.mark.parametrize(
    ("contact", "below", "planes"),
    [
        pytest.param(SLIPPERY, {"fixed": True}, [], id="slides on a fixed ball"),
        pytest.param(SLIPPERY | {"restitution": 0.5}, {"fixed": True}, [], id="bounces before it slides"),
        pytest.param(SLIPPERY | {"static_friction": 2.0, "kinetic_friction": 2.0}, {"fixed": True}, [], id="rolls"),
        pytest.param(
            *(SLIPPERY, {"mass": 50.0}, [{"normal": [0.0, 0.0, 1.0], "point": [0.0, 0.0, -R]}]), id="on a free ball"
        ),
    ],
)
def test_a_ball_that_has_landed_on_a_ball_stays_on_it(
    gap: float, contact: dict[str, Any], below: dict[str, Any], planes: list[dict[str, Any]]
) -> None:
    # each straight drift opened the gap by v² dt²/2(R + r), 1e-6 m: the ball hit anew in each step, and at the end of
    # the step it fell with g dt/2, 1 cm/s
    space = landing(gap, contact, below, planes)
    frames = list(space.run(schedule=every(0.0)))
    for frame in frames[len(frames) // 2 :]:
        apart = frame.position[1] - frame.position[0]
        distance = np.linalg.norm(apart)
        falling = (frame.velocity[1] - frame.velocity[0]) @ apart / distance
        assert distance == pytest.approx(R + r, abs=1e-12)
        assert abs(falling) < 1e-10  # 1e-8 of g dt/2, at which sweeps end


def test_a_ball_that_slides_on_after_it_has_landed_ends_where_a_ball_that_touched_all_along_does() -> None:
    touching, landed = landing(0.0, SLIPPERY, {"fixed": True}, []), landing(1e-9, SLIPPERY, {"fixed": True}, [])
    for space in (touching, landed):
        list(space.run())
    assert landed.state.velocity[1] == pytest.approx(touching.state.velocity[1], abs=1e-5)  # before, 8 mm/s
    assert landed.ledger.friction == pytest.approx(touching.ledger.friction, rel=1e-5)  # before, 1 % less
