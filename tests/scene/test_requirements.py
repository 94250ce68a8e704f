"""Only what a scene requires is modelled, and the reason is given."""

from __future__ import annotations

from typing import Any

import pytest

from carom.physics.space import Space
from carom.scene.requirements import frame_interval, gravity_method, integrator, require, target_dx
from carom.scene.schema import Scene
from examples import cloud, pair, scene_of

MOVING: list[dict[str, Any]] = [{"position": [0, 0, 0]}, {"position": [5, 0, 0], "velocity": [1, 0, 0]}]
RESTING: list[dict[str, Any]] = [{"position": [0, 0, 0]}, {"position": [5, 0, 0]}]
POST: dict[str, Any] = {"position": [9, 0, 0], "fixed": True}
FALLING = {"constant": 0, "uniform": [0, 0, -9.81]}
SMOOTH = {"static_friction": 0}
ROUGH = {"point": [0, 0, -1], "static_friction": 0.5}

CASES: list[tuple[str, Any, str, bool]] = [
    ("no constant, no gravity", scene_of(MOVING, gravity={"constant": 0}), "gravity", False),
    ("one body pulls nothing", scene_of(MOVING[:1]), "gravity", False),
    ("two bodies pull", scene_of(MOVING), "gravity", True),
    ("nothing moves, nothing meets", scene_of(RESTING, gravity={"constant": 0}), "contact", False),
    ("one moves, so they may meet", scene_of(MOVING, gravity={"constant": 0}), "contact", True),
    ("disabled contact", scene_of(MOVING, contact={"enabled": False}), "contact", False),
    ("what may meet is searched", pair(), "search", True),
    ("what cannot meet is not", scene_of(RESTING, gravity={"constant": 0}), "search", False),
    ("no friction, no torque", pair(contact={"static_friction": 0}), "torque", False),
    ("no friction and no spin, no orientation", pair(contact={"static_friction": 0}), "spin", False),
    ("friction turns bodies", pair(), "spin", True),
    ("spin at the start", cloud(contact={"static_friction": 0}), "spin", True),
    ("the step is adaptive", pair(), "adaptive_step", True),
    ("a fixed step is not", pair(time={"fixed_dt": 0.01}), "adaptive_step", False),
    ("a fixed step needs no warm-up", pair(time={"fixed_dt": 0.01}), "warm_up", False),
    ("one body and a plane may meet", scene_of(MOVING[1:], plane=[{"point": [0, 0, -1]}]), "contact", True),
    ("one body at rest beside a plane", scene_of(RESTING[1:], plane=[{"point": [0, 0, -1]}]), "contact", False),
    (
        "one body that falls on a plane",
        scene_of([{"position": [0, 0, 5]}], plane=[{}], gravity=FALLING),
        "contact",
        True,
    ),
    ("one body between walls", scene_of(MOVING[1:], domain={"boundary": "walls", "size": [99] * 3}), "contact", True),
    ("all fall alike", scene_of(RESTING, gravity=FALLING), "contact", False),
    ("one is fixed, and one falls", scene_of([RESTING[0], POST], gravity=FALLING), "contact", True),
    ("one is fixed, and nothing moves", scene_of([RESTING[0], POST], gravity={"constant": 0}), "contact", False),
    ("a rough plane turns smooth spheres", scene_of(MOVING[1:], plane=[ROUGH], contact=SMOOTH), "torque", True),
    ("a smooth plane does not", scene_of(MOVING[1:], plane=[{"point": [0, 0, -1]}], contact=SMOOTH), "torque", False),
    ("a uniform field", pair(gravity={"constant": 0, "uniform": [0, 0, -9.81]}), "field", True),
]


@pytest.mark.parametrize(("sentence", "scene", "part", "modelled"), CASES, ids=[case[0] for case in CASES])
def test_a_part_is_modelled_where_it_is_required(sentence: str, scene: Scene, part: str, modelled: bool) -> None:
    decision = getattr(require(scene), part)
    assert decision.modelled is modelled
    assert decision.why


@pytest.mark.parametrize(
    ("count", "gravity", "method", "why"),
    [
        (2, {}, "direct", "direct sum over 2 bodies (fewer than 5000)"),
        (4999, {}, "direct", "direct sum over 4999 bodies (fewer than 5000)"),
        (5000, {}, "tree", "tree over 5000 bodies, opening angle 0.5 (at least 5000)"),
        (5000, {"method": "direct"}, "direct", "direct sum over 5000 bodies,"),
        (9, {"method": "tree", "opening_angle": 0.3}, "tree", "tree over 9 bodies, opening angle 0.3,"),
        (1, {"method": "tree"}, "none", "one body"),
        (9, {"method": "tree", "constant": 0}, "none", "gravity.constant = 0"),
    ],
)
def test_many_bodies_are_summed_by_a_tree(count: int, gravity: dict[str, Any], method: str, why: str) -> None:
    scene = Scene.from_dict({"group": [{"count": count}], "gravity": gravity})
    assert gravity_method(scene) == method
    assert why in require(scene).gravity.why


POINTS = {"enabled": False}


@pytest.mark.parametrize(
    ("scene", "chosen", "why"),
    [
        (cloud(8, contact=POINTS), "yoshida4", "8 bodies pull each other, and no contact is modelled"),
        (cloud(9, contact=POINTS), "leapfrog", "more than 8 bodies, whose encounters are sudden"),
        (cloud(8), "leapfrog", "contacts are found at the end of a step"),
        (cloud(8, contact=POINTS, gravity={"constant": 0.0}), "leapfrog", "exact without a pull between bodies"),
        (cloud(8, contact=POINTS, time={"integrator": "euler"}), "euler", 'time.integrator = "euler"'),
        (cloud(8, time={"integrator": "yoshida4"}), "yoshida4", 'time.integrator = "yoshida4"'),
        (cloud(3, contact=POINTS, time={"fixed_dt": 0.1}), "yoshida4", "3 bodies"),
    ],
)
def test_the_integrator_is_of_fourth_order_where_nothing_is_sudden(scene: Scene, chosen: str, why: str) -> None:
    assert integrator(scene) == chosen
    assert why in require(scene).integrator.why


def test_the_fourth_order_takes_twice_the_step_where_it_is_chosen_for_its_order() -> None:
    eight, second = (cloud(8, contact=POINTS, time={"integrator": name}) for name in ("auto", "leapfrog"))
    assert target_dx(eight) == pytest.approx(4.0 * target_dx(second), rel=1e-15)
    assert target_dx(cloud(8, time={"integrator": "yoshida4"})) == target_dx(cloud(8)) == target_dx(second)
    many, fourth = (cloud(20, contact=POINTS, time={"integrator": name}) for name in ("auto", "yoshida4"))
    assert target_dx(many) == target_dx(fourth)


def test_a_part_that_is_not_required_takes_no_memory() -> None:
    space = Space(pair(contact={"static_friction": 0}))
    assert space.state.orientation.size == space.state.angular_velocity.size == space.state.torque.size == 0


@pytest.mark.parametrize(("every", "interval"), [("step", 0.0), (0.25, 0.25), ("auto", 10.0 / 600)])
def test_frames_are_due_as_often_as_the_scene_says(every: Any, interval: float) -> None:
    assert frame_interval(pair(record={"every": every})) == interval


def test_an_acceleration_moves_a_body_by_a_part_of_the_smallest_radius_that_grows_with_their_number() -> None:
    # From rest, a part s of the time to fall through a radius is s² of the way.
    few = scene_of([{"radius": 3.0}, {"position": [9, 0, 0], "radius": 0.5}])
    assert target_dx(few) == pytest.approx(0.002**2 * 0.5, rel=1e-15)
    assert target_dx(cloud(50)) == pytest.approx(0.05**2 * 0.2, rel=1e-15)
    assert target_dx(cloud(100)) == target_dx(cloud(2000)) == pytest.approx(0.1**2 * 0.2, rel=1e-15)


def test_the_seeds_hundredth_of_a_metre_is_what_a_person_writes_or_what_many_bodies_of_a_metre_get() -> None:
    metres = {"count": 100, "radius": 1.0}
    assert target_dx(pair(time={"target_dx": 0.01})) == 0.01
    assert target_dx(Scene.from_dict({"group": [metres]})) == pytest.approx(0.01, rel=1e-15)


def test_the_reason_for_the_adaptive_step_names_its_distance() -> None:
    assert require(pair(time={"target_dx": 0.25})).adaptive_step.why == "target_dx = 0.25 m"
    assert "target_dx = 4e-06 m: for 2 bodies, 0.002 of a fall" in require(pair()).adaptive_step.why
