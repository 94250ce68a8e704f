"""What a scene with a piston may contain, and the force of a pressure."""

from __future__ import annotations

from typing import Any

import pytest

from carom import Scene
from carom.errors import SceneError
from carom.plan.auto import timing
from carom.scene.pistons import Side, sides_of_face

BALL = {"radius": 0.1, "position": [0.0, 0.0, 0.3]}
DOWN = {"point": [0.0, 0.0, 0.5], "normal": [0.0, 0.0, -1.0]}


def scene(piston: dict[str, Any], **others: Any) -> Scene:
    """Return a ball between a floor and a piston."""
    return Scene.from_dict({"body": [BALL], "plane": [{}, DOWN | {"piston": piston}]} | others)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no lasting contacts": ({"contact": {"solver": "staged"}}, 'set "lasting"'),
    "no contacts": ({"contact": {"enabled": False}}, "contact.enabled = false"),
    "sleep": ({"contact": {"sleep": {"speed": 0.1}}}, "contact.sleep"),
    "drag": ({"drag": {"relaxation_time": 1.0}}, "a [drag]"),
    "an accuracy": ({"time": {"duration": 1.0, "accuracy": 1e-3}}, "time.accuracy"),
    "several drifts": ({"time": {"duration": 1.0, "integrator": "yoshida4"}}, 'set "leapfrog"'),
    "a motion": ({"plane": [DOWN | {"piston": {"mass": 1.0}, "motion": {"velocity": [0, 0, 1]}}]}, "leave one out"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_piston_is_refused_with_what_does_not_support_it(what: str) -> None:
    others, said = REFUSED[what]
    with pytest.raises(SceneError) as refused:
        scene({"mass": 1.0}, **others)
    assert said in str(refused.value) and "piston" in str(refused.value)


def test_impacts_with_a_piston_are_resolved_at_their_own_times_unless_the_scene_says_otherwise() -> None:
    assert timing(scene({"mass": 1.0})) == "time-of-impact"
    assert timing(scene({"mass": 1.0}, contact={"timing": "end-of-step"})) == "end-of-step"


def test_a_pressure_acts_on_the_face_of_the_box() -> None:
    pressed = scene({"mass": 1.0, "pressure": 10.0}, domain={"size": [2.0, 3.0, 4.0], "boundary": "walls"})
    assert sides_of_face(pressed, 1) == (Side(2.0, ()), Side(3.0, ()))
    with pytest.raises(
        SceneError, match=r"needs domain.size, to define the area on which its pressure acts; give the force instead"
    ):
        scene({"mass": 1.0, "pressure": 10.0})
    with pytest.raises(SceneError, match="leave one out"):
        scene({"mass": 1.0, "pressure": 10.0, "force": 1.0})
    with pytest.raises(SceneError, match="mass"):
        scene({"mass": 0.0})


def test_a_pressure_acts_on_the_face_between_planes_where_pistons_move() -> None:
    pressed = {"mass": 1.0, "pressure": 10.0}
    left = {"name": "left", "point": [-1.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0], "piston": pressed}
    right = {"point": [2.0, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]}
    domain = {"size": [9.0, 3.0, 4.0], "boundary": ["open", "walls", "open"]}
    both = scene(pressed, plane=[{}, DOWN | {"piston": pressed}, left, right], domain=domain)
    assert sides_of_face(both, 1) == (Side(3.0, (2,)), Side(3.0, ()))
    assert sides_of_face(both, 2) == (Side(3.0, ()), Side(0.5, (1,)))
    with pytest.raises(SceneError, match=r"needs a plane opposite to left, .*; add one along x, or give the force"):
        scene(pressed, plane=[{}, DOWN | {"piston": pressed}, left], domain=domain)
    with pytest.raises(SceneError, match="needs a normal along x, y or z"):
        scene(pressed, plane=[{}, DOWN | {"normal": [0.0, 1.0, -1.0], "piston": pressed}], domain=domain)
    with pytest.raises(SceneError, match=r"velocity = 2 exceeds max_speed = 1; lower it, or raise max_speed"):
        scene({"mass": 1.0, "force": 1.0, "velocity": 2.0, "max_speed": 1.0})
