"""No body passes through a plane, whatever its speed and however impacts are found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.physics.space import Space
from carom.scene.load import Scene
from scene_strategies import EPS, choices, decades, parts, vectors
from seeds import examples
from small_scenes import scene_of

FloatArray = NDArray[np.float64]

STEPS = 12
SIDE = 10.0  # m, of the box
WEIGHTLESS = {"constant": 0.0}
TIMINGS = ("end-of-step", "time-of-impact")


def heights(space: Space) -> FloatArray:
    """Return the heights of centres above all planes, (n, p) m."""
    return np.asarray(space.state.position @ space.planes.normal.T - space.planes.offset)


@st.composite
def boxes(draw: st.DrawFn) -> Scene:
    """Draw some bodies in a box, thrown at up to a million diameters a step, some of them from a corner."""
    fixed = draw(st.booleans())
    dt = 2.0**-6  # s
    bodies: list[dict[str, Any]] = []
    corner = draw(st.booleans())
    for k in range(draw(st.integers(1, 3))):
        radius = float(draw(choices(0.01, 0.1, 0.5)))
        place = np.array([-3.0, 0.0, 3.0])[[k, (k + 1) % 3, (k + 2) % 3]]
        if corner and k == 0:
            place = np.full(3, -SIDE / 2 + radius)
        speed = 2.0 * radius / dt * draw(decades(-2, 6))
        bodies.append({"position": list(place), "velocity": list(speed * draw(vectors)), "radius": radius, "mass": 1.0})
    document: dict[str, Any] = {
        "body": bodies,
        "domain": {"boundary": "walls", "size": [SIDE] * 3},
        "time": {"duration": 100.0} | ({"fixed_dt": dt} if fixed else {"cfl": draw(choices(0.5, 100.0, 1e6))}),
        "gravity": {"constant": 0.0, "uniform": list(draw(vectors) * draw(choices(0.0, 10.0, 1e6)))},
        "contact": {
            "restitution": draw(parts),
            "static_friction": draw(choices(0.0, 0.5)),
            "timing": draw(choices(*TIMINGS)),
            "solver": draw(choices("lasting", "staged")),
            "stabilisation": draw(choices("split", "none")),
        },
        "record": {"every": "step", "check_every": 1},
    }
    if draw(st.booleans()):  # a plane across a corner, which is none of the walls
        document["plane"] = [{"normal": [-1.0, -1.0, -1.0], "point": [4.0, 4.0, 4.0]}]
    if fixed and document["contact"]["timing"] == "end-of-step":
        document["time"]["integrator"] = draw(choices("leapfrog", "euler"))
    return Scene.model_validate(document)


@examples(60)
@given(boxes())
def test_no_body_ends_a_step_behind_a_wall_at_any_speed(scene: Scene) -> None:
    space = Space(scene, threads=1)
    for step in range(STEPS):
        space.compute_dynamics(step + 1)
        # heights are computed in another order here; both round at the coordinates of the box
        assert heights(space).min() >= -8 * EPS * SIDE


@pytest.mark.parametrize(
    ("timing", "integrator"),
    [
        *(("end-of-step", integrator) for integrator in ("leapfrog", "euler", "yoshida4", "leapfrog-dkd")),
        *(("time-of-impact", integrator) for integrator in ("leapfrog", "euler")),
    ],
)
def test_a_ball_that_crosses_its_box_a_million_times_a_step_stays_in_it(timing: str, integrator: str) -> None:
    ball = {"velocity": [1e9, 7e8, -3e8], "radius": 0.5}
    box = {"boundary": "walls", "size": [SIDE] * 3}
    scene = scene_of([ball], domain=box, gravity=WEIGHTLESS, contact={"timing": timing, "restitution": 0.9},
                     time={"duration": 1.0, "fixed_dt": 0.01, "integrator": integrator})  # fmt: skip
    space = Space(scene)
    for _ in space.run():
        assert heights(space).min() >= -8 * EPS * SIDE


def test_a_ball_that_is_too_fast_for_a_step_rebounds_from_the_plane_that_it_meets_first() -> None:
    # It falls 100 m in a step, from 3 m above one plane and 50 m beside another.
    ball = {"position": [50.0, 0.0, 4.0], "velocity": [-1.0e4, 0.0, -1.0e4], "radius": 1.0, "mass": 1.0}
    planes = [{"normal": [0.0, 0.0, 1.0]}, {"normal": [1.0, 0.0, 0.0]}]
    contact = {"timing": "end-of-step", "restitution": 0.5, "static_friction": 0.0}
    scene = scene_of(
        [ball], plane=planes, gravity=WEIGHTLESS, contact=contact, time={"duration": 1.0, "fixed_dt": 0.01}
    )
    space = Space(scene)
    space.compute_dynamics(1)
    assert space.state.velocity[0] == pytest.approx([-1.0e4, 0.0, 0.5e4], rel=1e-12)
    assert space.state.position[0] == pytest.approx([47.0, 0.0, 1.0], abs=2e-6)  # overlapping by a millionth of r
    assert [event.kind for event in space.frame().events if event.level == "WARN"] == ["limit"]


def test_stopping_a_body_at_a_plane_closes_the_ledger_in_a_uniform_field() -> None:
    field = {"constant": 0.0, "uniform": [0.0, 0.0, -1e4]}
    ball = {"position": [0.0, 0.0, 30.0], "velocity": [5.0, 0.0, -3e4], "radius": 1.0, "mass": 2.0}
    contact = {"timing": "end-of-step", "restitution": 0.8}
    scene = scene_of([ball], plane=[{}], gravity=field, contact=contact, time={"duration": 0.05, "fixed_dt": 0.01})
    space = Space(scene)
    for frame in space.run():
        # about ten roundings a step of terms of the size of the scale
        assert abs(frame.energy.integration_error) <= 100 * EPS * frame.energy.scale
    assert space.ledger.stabilisation > 0.0


def test_a_pebble_that_a_giant_is_pushed_out_of_stays_in_front_of_the_floor() -> None:
    # The giant overlaps the pebble by seven times the pebble's radius; the push undoes that through the lighter one.
    bodies = [
        {"position": [0.5, 0.0, 1.0], "radius": 1.0, "mass": 1.0},
        {"position": [0.0, 0.0, 15.0], "radius": 20.0, "mass": 300.0},
    ]
    contact = {"timing": "end-of-step", "restitution": 0.0, "allow_overlap": True, "sweeps": 2}
    field = {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}
    scene = scene_of(bodies, plane=[{}], gravity=field, contact=contact, time={"duration": 0.2, "fixed_dt": 0.01})
    space = Space(scene)
    for _ in space.run():
        assert heights(space).min() >= 0.0


def test_a_body_that_begins_behind_a_plane_is_left_to_the_pushes() -> None:
    ball = {"position": [0.0, 0.0, -5.0], "velocity": [0.0, 0.0, 20.0], "radius": 1.0}
    contact = {"timing": "end-of-step", "allow_overlap": True}
    scene = scene_of([ball], plane=[{}], gravity=WEIGHTLESS, contact=contact, time={"duration": 1.0, "fixed_dt": 0.1})
    space = Space(scene)
    space.compute_dynamics(1)
    assert space.state.position[0, 2] == pytest.approx(-3.0, rel=1e-12)
