"""Only what a scene requires is modelled, and the reason is given."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from carom.errors import SceneError
from carom.physics.space import Space
from carom.plan import interactions
from carom.plan.auto import (
    TREES,
    cfl,
    frame_interval,
    gravity_method,
    integrator,
    largest_step,
    pull_fraction,
    smoothing,
    step_limits,
    target_dx,
    timing,
)
from carom.plan.checks import refuse_impossible
from carom.plan.features import require
from carom.plan.known_errors import ended_bounces, inexact_impacts, inexact_orbits
from carom.scene.forces import FORCES, ForceKind
from carom.scene.load import Scene
from carom.scene.parts import OWN_FORCES, PARTS
from carom.scene.schema import Promise
from carom.scene.wording import suggestion
from small_scenes import cloud, pair, scene_of

MOVING: list[dict[str, Any]] = [{"position": [0, 0, 0]}, {"position": [5, 0, 0], "velocity": [1, 0, 0]}]
RESTING: list[dict[str, Any]] = [{"position": [0, 0, 0]}, {"position": [5, 0, 0]}]
POST: dict[str, Any] = {"position": [9, 0, 0], "fixed": True}
FALLING = {"constant": 0, "uniform": [0, 0, -9.81]}
SMOOTH = {"static_friction": 0}
ELASTIC = {"restitution": 1.0}
ROUGH = {"point": [0, 0, -1], "static_friction": 0.5}

CASES: list[tuple[str, Any, str, bool]] = [
    ("no constant, no gravity", scene_of(MOVING, gravity={"constant": 0}), "gravity", False),
    ("a single body attracts nothing", scene_of(MOVING[:1]), "gravity", False),
    ("two bodies attract", scene_of(MOVING), "gravity", True),
    ("nothing moves, nothing meets", scene_of(RESTING, gravity={"constant": 0}), "contact", False),
    ("one moves, so they may meet", scene_of(MOVING, gravity={"constant": 0}), "contact", True),
    ("disabled contact", scene_of(MOVING, contact={"enabled": False}), "contact", False),
    ("what may meet is searched", pair(), "broad_phase", True),
    ("what cannot meet is not", scene_of(RESTING, gravity={"constant": 0}), "broad_phase", False),
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
    ("what pulls has a potential", scene_of(MOVING), "potential", True),
    ("what does not pull has none", pair(), "potential", False),
    ("spin without friction is seen", cloud(contact=SMOOTH), "orientation", True),
    ("spin without friction never changes", cloud(contact=SMOOTH), "torque", False),
    ("gravity presses bodies together", scene_of(MOVING), "resting", True),
    ("without it every contact is an impact", pair(), "resting", False),
    ("nor does a field that pulls all alike", pair(gravity=FALLING), "resting", False),
    ("a wall does that curves towards them", pair(wall=[{"sphere": {"radius": 9.0}}]), "resting", True),
    ("unless they bounce on it for ever", pair(wall=[{"sphere": {"radius": 9.0}}], contact=ELASTIC), "resting", False),
    ("or it is flat", pair(wall=[{"disc": {"radius": 9.0, "centre": [0, 0, -9]}}]), "resting", False),
    ("a field and a floor do", pair(gravity=FALLING, plane=[{"point": [0, 0, -2]}]), "resting", True),
    ("no bounce, no restitution", pair(contact={"restitution": 0}), "restitution", False),
    (
        "unless it is a plane's",
        pair(contact={"restitution": 0}, plane=[{"point": [0, 0, -2], "restitution": 1.0}]),
        "restitution",
        True,
    ),
    ("what may meet is looked at", pair(), "narrow_phase", True),
    ("overlaps that are let be", pair(contact={"stabilisation": "none"}), "stabilisation", False),
]


@pytest.mark.parametrize(("sentence", "scene", "part", "modelled"), CASES, ids=[case[0] for case in CASES])
def test_a_part_is_modelled_where_it_is_required(sentence: str, scene: Scene, part: str, modelled: bool) -> None:
    decision = getattr(require(scene), part)
    assert decision.modelled is modelled
    assert decision.why


@pytest.mark.parametrize(
    ("count", "gravity", "method", "why"),
    [
        (2, {}, "direct", "2 bodies, fewer than 5000: a direct sum"),
        (4999, {}, "direct", "4999 bodies, fewer than 5000: a direct sum"),
        (5000, {}, "tree", "5000 bodies, at least 5000; opening angle 0.5"),
        (5000, {"method": "direct"}, "direct", 'gravity.method = "direct": a direct sum'),
        (9, {"method": "tree", "opening_angle": 0.3}, "tree", 'gravity.method = "tree"; opening angle 0.3'),
        (9, {"method": "fast-multipole"}, "fast-multipole", 'gravity.method = "fast-multipole"; opening angle 0.5'),
        (1, {"method": "tree"}, "none", "no gravity between bodies"),
        (9, {"method": "tree", "constant": 0}, "none", "no gravity between bodies"),
        (9, {"method": "tree", "constant": 0, "force": True}, "tree", 'gravity.method = "tree"'),
    ],
)
def test_many_bodies_are_summed_by_a_tree(count: int, gravity: dict[str, Any], method: str, why: str) -> None:
    forced = {"force": "gravity"} if gravity.pop("force", False) else {}
    scene = Scene.from_dict({"group": [{"count": count}], "gravity": gravity, "model": forced})
    assert gravity_method(scene) == method
    assert require(scene).tree.modelled == (method in TREES)
    assert why in require(scene).tree.why


POINTS = {"enabled": False}


@pytest.mark.parametrize(
    ("scene", "chosen", "why"),
    [
        (cloud(8, contact=POINTS), "yoshida4", "8 bodies attract each other, and no contact is modelled"),
        (cloud(100, contact=POINTS, time={"cfl": "auto"}), "gauss-radau15", "100 bodies attract each other"),
        (cloud(100, contact=POINTS, time={"cfl": "auto", "pull_fraction": 0.01}), "yoshida4", "100 bodies attract"),
        (cloud(8, contact=POINTS, time={"cfl": "auto"}, gravity={"method": "tree"}), "yoshida4", "8 bodies attract"),
        (cloud(101, contact=POINTS), "leapfrog", "101 bodies, whose encounters the step does not resolve"),
        (cloud(9, contact=POINTS, time={"fixed_dt": 0.1}), "leapfrog", "9 bodies, whose encounters"),
        (cloud(9, contact=POINTS, time={"target_dx": 0.1}), "leapfrog", "9 bodies, whose encounters"),
        (cloud(8), "leapfrog", "contacts are detected in the single drift of a step"),
        (cloud(8, contact=POINTS, gravity={"constant": 0.0}), "leapfrog", "exact between impacts"),
        (cloud(8, contact=POINTS, time={"integrator": "euler"}), "euler", 'time.integrator = "euler"'),
        (cloud(8, time={"integrator": "yoshida4"}), "yoshida4", 'time.integrator = "yoshida4"'),
        (cloud(3, contact=POINTS, time={"fixed_dt": 0.1}), "yoshida4", "3 bodies"),
    ],
)
def test_the_integrator_is_of_a_high_order_where_nothing_is_sudden(scene: Scene, chosen: str, why: str) -> None:
    assert integrator(scene).name == chosen
    assert why in require(scene).integrator.why


def earth_and_moon(distance: float = 384_400e3, speed: float = 1022.0, **sections: Any) -> Scene:
    """Two bodies that pull each other and can touch; the sum of their radii is 8108 km."""
    earth = {"mass": 6.0e24, "radius": 6371e3}
    moon = {"mass": 7.3e22, "radius": 1737e3, "position": [distance, 0, 0], "velocity": [0, speed, 0]}
    return Scene.from_dict({"body": [earth, moon], **sections})


@pytest.mark.parametrize(
    ("scene", "chosen"),
    [
        (earth_and_moon(), "gauss-radau15"),
        (earth_and_moon(64_900e3), "gauss-radau15"),
        (earth_and_moon(64_800e3), "leapfrog"),  # less than eight sums of radii
        (earth_and_moon(speed=0.0), "leapfrog"),  # they fall together
        (earth_and_moon(time={"target_dx": 1e3}), "leapfrog"),
        (earth_and_moon(contact={"timing": "end-of-step"}), "leapfrog"),
        (earth_and_moon(gravity={"constant": 0.0}), "leapfrog"),
        (earth_and_moon(gravity={"uniform": [0, 0, -1.0]}), "leapfrog"),
        (earth_and_moon(gravity={"method": "tree"}), "leapfrog"),
        (earth_and_moon(drag={"relaxation_time": 1e9}), "leapfrog"),
        (earth_and_moon(plane=[{"normal": [0, 0, 1], "point": [0, 0, -1e9]}]), "leapfrog"),
        (earth_and_moon(domain={"boundary": "walls", "size": [1e10] * 3}), "leapfrog"),
        (earth_and_moon(group=[{"count": 1, "region": {"radius": 1e3}}]), "leapfrog"),  # its place is not known yet
    ],
)
def test_few_bodies_that_begin_far_apart_are_integrated_to_rounding_up_to_their_impacts(
    scene: Scene, chosen: str
) -> None:
    assert integrator(scene).name == chosen
    seldom = "start far apart and seldom collide" in require(scene).integrator.why
    assert seldom == (chosen == "gauss-radau15")


def ring(count: int, centre: float) -> Scene:
    """Bodies on circular orbits about a centre of a mass, which can touch; the Sun has 2 × 10³⁰ kg."""
    bodies: list[dict[str, Any]] = [{"mass": centre, "radius": 7e8}]
    for k in range(count):
        r = 1.5e11 * (1.0 + 0.05 * k)
        bodies.append(
            {"mass": 1e20, "radius": 1e5, "position": [r, 0, 0], "velocity": [0, math.sqrt(6.7e-11 * centre / r), 0]}
        )
    return Scene.from_dict({"body": bodies, "time": {"duration": 3e7}})


def test_many_bodies_that_orbit_a_dominant_one_are_integrated_like_few() -> None:
    """With leapfrog, the velocity limit of 1.7 s and steps of at most a second gave 120 bodies 3 × 10⁷ steps a year."""
    assert integrator(ring(120, 2e30)).name == "gauss-radau15"
    assert integrator(ring(220, 2e30)).name == "leapfrog"  # each impact restarts all of them
    assert integrator(ring(120, 1e21)).name == "leapfrog"  # the centre is not dominant


def circles(count: int, **time: Any) -> Scene:
    """Points on circles about a dominant one, with G = 1; the innermost completes 20 revolutions."""
    bodies: list[dict[str, Any]] = [{"mass": 1.0, "radius": 1e-3}]
    for k in range(count - 1):
        r, angle = 1.0 + 0.01 * k, 2.4 * k
        x, y, v = math.cos(angle), math.sin(angle), 1.0 / math.sqrt(r)
        place = {"position": [r * x, r * y, 0.0], "velocity": [-v * y, v * x, 0.0]}
        bodies.append({"mass": 1e-12, "radius": 1e-6} | place)
    rule = {"duration": 40.0 * math.pi} | time
    return Scene.from_dict({"body": bodies, "gravity": {"constant": 1.0}, "contact": {"enabled": False}, "time": rule})


def test_hundreds_of_points_that_orbit_a_dominant_one_far_apart_are_integrated_to_rounding() -> None:
    assert integrator(circles(150)).name == "gauss-radau15"
    assert integrator(circles(1001)).name == "leapfrog"
    assert integrator(circles(150, pull_fraction=0.02)).name == "leapfrog", "the scene sets the step"


@pytest.mark.parametrize("steps", [300.0, 1000.0])
def test_orbits_lag_as_the_note_says(steps: float) -> None:
    scene = circles(12, integrator="leapfrog", fixed_dt=2.0 * math.pi / steps)
    said = re.search(r"by about (\S+) rad in 20 revolutions", inexact_orbits(scene))
    assert said
    space = Space(scene, threads=1)
    for _ in space.run():
        pass
    sun, innermost = space.state.position[:2]
    lag = -math.atan2(innermost[1] - sun[1], innermost[0] - sun[0])  # it began on the x axis
    assert float(said[1]) == pytest.approx(lag, rel=0.5), "the note has one digit"
    assert lag == pytest.approx(40.0 * math.pi * (2.0 * math.pi / steps) ** 2 / 3.0, rel=0.01), "the next order is dt⁴"


def test_no_note_says_that_orbits_lag_where_they_do_not() -> None:
    assert inexact_orbits(circles(150)) == ""
    assert inexact_orbits(circles(12, integrator="leapfrog", fixed_dt=1e-3)) == ""


def test_the_longest_step_leaves_a_run_a_million_steps() -> None:
    def longest(**time: float) -> float:
        return largest_step(Scene.from_dict({"body": [{"radius": 1.0}], "time": time}))

    assert longest(duration=1e6) == 1.0
    assert longest(duration=3e7) == 30.0
    assert longest(duration=3e7, max_dt=2.0) == 2.0


def test_radii_limit_the_step_only_where_bodies_can_touch() -> None:
    touching, points = cloud(8, time={"cfl": "auto"}), cloud(8, time={"cfl": "auto"}, contact=POINTS)
    assert (cfl(touching), pull_fraction(touching)) == (0.5, None)
    assert target_dx(touching) == pytest.approx(0.008**2 * 0.2, rel=1e-15)
    assert (cfl(points), target_dx(points), pull_fraction(points)) == (None, None, 0.01)
    assert pull_fraction(cloud(101, contact=POINTS)) == 0.02
    limited = cloud(8, time={"cfl": "auto", "integrator": "yoshida4"}, contact=POINTS)
    assert "pull_fraction = 0.01 of the shortest time of a pair" in require(limited).adaptive_step.why
    assert "own estimate of its error" in require(points).adaptive_step.why


def test_limits_that_are_given_hold_wherever_they_are_given() -> None:
    given = cloud(8, time={"cfl": 0.1, "target_dx": 1e-3}, contact=POINTS)
    assert (cfl(given), target_dx(given), pull_fraction(given), smoothing(given)) == (0.1, 1e-3, None, 0.2)
    assert pull_fraction(cloud(8, time={"pull_fraction": 0.3})) == 0.3
    assert smoothing(cloud(8, time={"cfl": "auto"}, contact=POINTS)) == 1.0
    assert smoothing(cloud(8, time={"smoothing": 0.7}, contact=POINTS)) == 0.7


AUTO, NOW = {"timing": "auto"}, {"timing": "time-of-impact"}


@pytest.mark.parametrize(
    ("scene", "chosen", "why", "step"),
    [
        (pair(contact=AUTO), "time-of-impact", "impacts are resolved at their exact times", 1.0),
        (pair(contact=AUTO, gravity=FALLING), "time-of-impact", "impacts are resolved at their exact times", 1.0),
        (pair(contact=AUTO, time={"integrator": "euler"}), "time-of-impact", "at their exact times", 1.0),
        (pair(contact=AUTO, time={"cfl": 0.2}), "time-of-impact", "at their exact times", 0.2),
        (scene_of(MOVING, contact=AUTO), "time-of-impact", "impacts are resolved at their exact times", 0.5),
        (cloud(8, contact=AUTO, time={"cfl": "auto"}), "time-of-impact", "at their exact times", 0.5),
        (pair(contact=AUTO, gravity=FALLING, plane=[{}]), "time-of-impact", "at their exact times", 0.5),
        (pair(contact=AUTO, time={"integrator": "yoshida4"}), "end-of-step", "yoshida4 is more than one drift", 0.5),
        (scene_of(RESTING, gravity={"constant": 0}, contact=AUTO), "end-of-step", "no contact is possible", None),
        (pair(contact={"timing": "end-of-step"}), "end-of-step", 'contact.timing = "end-of-step"', 0.5),
        (scene_of(MOVING, contact=NOW), "time-of-impact", 'contact.timing = "time-of-impact"', 0.5),
    ],
)
def test_impacts_are_at_their_own_times_whatever_presses_wherever_a_step_is_one_drift(
    scene: Scene, chosen: str, why: str, step: float | None
) -> None:
    assert timing(scene) == chosen
    assert require(scene).impact_time.modelled == (chosen == "time-of-impact")
    assert why in require(scene).impact_time.why
    assert cfl(scene) == step


def test_times_of_impact_can_be_forced_on_where_a_step_is_one_drift() -> None:
    still = scene_of(RESTING, gravity={"constant": 0}, contact=AUTO, model={"force": "time-of-impact"})
    part = require(still).impact_time
    assert part.modelled and part.why.startswith("forced; otherwise not: no contact is possible")
    with pytest.raises(SceneError, match=r'set time\.integrator = "leapfrog"'):
        require(cloud(contact=AUTO, time={"integrator": "yoshida4"}, model={"force": "time-of-impact"}))


def test_the_parts_are_those_that_have_names() -> None:
    assert tuple(part.name for part in require(pair()).parts) == PARTS


def forced(*parts: str, **sections: Any) -> dict[str, str]:
    """Force parts on; return why each part that was forced is modelled."""
    scene = pair(contact=SMOOTH, model={"force": list(parts)}, **sections)
    return {part.name: part.why for part in require(scene).parts if part.why.startswith("forced")}


def test_a_forced_part_says_so_and_why_it_was_left_out() -> None:
    assert forced("spin") == {"spin": "forced; otherwise not: no friction, and nothing spins at the start"}


def test_a_forced_part_brings_what_it_cannot_be_without() -> None:
    assert set(forced("torque")) == {"torque", "spin"}
    assert set(forced("orientation")) == {"orientation", "spin"}
    assert set(forced("potential")) == {"potential", "gravity"}
    assert forced("potential")["gravity"] == "forced by potential; otherwise not: gravity.constant = 0"


def test_a_forced_part_requires_the_parts_that_it_needs() -> None:
    needs = require(pair(contact=SMOOTH, model={"force": "friction"}))
    assert needs.torque.why == needs.spin.why == "friction turns bodies"


def test_to_force_what_is_required_changes_nothing() -> None:
    assert forced("contact", "integrator", "restitution") == {}


@pytest.mark.parametrize(
    ("part", "sections", "instead"),
    [
        ("contact", {"contact": {"enabled": False}}, "contact.enabled = false; set it to true"),
        ("friction", {"contact": {"enabled": False}}, "friction cannot be forced on: contact.enabled = false"),
        ("accuracy", {}, "it needs a value; set time.accuracy"),
        ("gravity", {"gravity": {"method": "none"}}, 'gravity.method = "none"; remove it'),
        ("tree", {}, 'set gravity.method = "tree"'),
        ("restitution", {"contact": {"restitution": 0}}, "set contact.restitution"),
        ("stabilisation", {"contact": {"stabilisation": "none"}}, 'set it to "split"'),
        ("adaptive-step", {"time": {"fixed_dt": 0.1}}, "time.fixed_dt sets the step; remove it"),
    ],
)
def test_a_part_that_the_scene_excludes_cannot_be_forced(part: str, sections: dict[str, Any], instead: str) -> None:
    scene = pair(**sections, model={"force": part})
    for refuse in (require, Space):
        with pytest.raises(SceneError, match=r"^model\.force: .* cannot be forced on") as refusal:
            refuse(scene)
        assert instead in str(refusal.value)


def test_an_unknown_part_is_refused_with_the_nearest(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text('[[body]]\n\n[model]\nforce = ["spin", "tork"]\n')
    with pytest.raises(SceneError) as refusal:
        Scene.load(path)
    assert str(refusal.value) == f'{path}:4: model.force: no part "tork"; {suggestion("tork", PARTS)}'
    assert 'did you mean "torque"?' in str(refusal.value)
    with pytest.raises(SceneError, match=r'model\.force: no part "quux"; there are warm-up, '):
        Scene.load(path, ["model.force=quux"])


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


def test_the_reason_for_the_adaptive_step_names_what_it_follows() -> None:
    assert require(pair(time={"target_dx": 0.25, "cfl": 0.1})).adaptive_step.why == "cfl = 0.1, target_dx = 0.25 m"
    assert "target_dx = 4e-06 m: 0.002 of the time of a fall" in require(pair()).adaptive_step.why


def test_a_force_that_differs_between_bodies_at_rest_lets_them_meet_and_press(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not require(scene_of(RESTING, gravity={"constant": 0})).contact.modelled
    trap = ForceKind("gravity-well", lambda scene: (True, "of this test"), differs=True)
    monkeypatch.setattr(interactions, "kinds_of", lambda scene: (*FORCES, trap))
    needs = require(scene_of(RESTING, gravity={"constant": 0}))
    assert needs.contact.modelled and needs.resting.modelled
    assert needs.resting.why.startswith("well presses")
    assert needs.impact_time.modelled


def test_a_second_force_that_depends_on_velocities_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    brake = ForceKind("brake", lambda scene: (True, "of this test"), loss="brake", damps=True)
    monkeypatch.setattr(interactions, "kinds_of", lambda scene: (*FORCES, brake))
    refuse_impossible(pair())
    with pytest.raises(SceneError, match=r"^\[drag\] and \[brake\]: a scene has at most one force"):
        refuse_impossible(pair(drag={"relaxation_time": 2.0}))


@pytest.mark.parametrize(
    ("part", "unknown"),
    [
        ({"contact": {"allow_overlap": True}}, "overlap at the start"),
        ({"gravity": {"method": "tree"}}, "the tree method"),
    ],
)
def test_an_accuracy_by_leapfrog_says_what_gauss_radau_does_not_know(part: dict[str, Any], unknown: str) -> None:
    scene = scene_of(MOVING, **part, time={"accuracy": 1e-6})
    chosen = next(part for part in require(scene).parts if part.name == "integrator")
    assert chosen.why == f"leapfrog: gauss-radau15 does not support {unknown}"


@pytest.mark.parametrize(
    ("refinement", "expected"),
    [
        (0.5, "steps 2 times longer than usual; kept to the end"),
        (1.0, "steps of the usual length; kept to the end"),
        (8.0, "steps 8 times shorter than usual; kept to the end"),
    ],
)
def test_the_step_of_an_accuracy_is_told_beside_the_usual_one(refinement: float, expected: str) -> None:
    scene = scene_of(MOVING, time={"accuracy": 1e-6})
    promise = Promise(refinement=refinement, until=scene.time.duration, lyapunov=0.0, error=(0.0,))
    accuracy = next(part for part in require(scene.promising(promise)).parts if part.name == "accuracy")
    assert accuracy.why == expected


def test_the_limits_that_an_accuracy_sets_are_told_not_the_usual_ones() -> None:
    promise = Promise(refinement=8.0, until=1.0, lyapunov=0.0, error=(0.0,))
    scene = scene_of(MOVING, time={"accuracy": 1e-6, "integrator": "leapfrog"}).promising(promise)
    told = next(part for part in require(scene).parts if part.name == "adaptive-step")
    assert f"cfl = {step_limits(scene).cfl:.3g}, " in told.why
    assert step_limits(scene).cfl != cfl(scene)


def test_a_run_says_where_impacts_are_not_exact() -> None:
    ball = {"radius": 0.0285, "mass": 0.17}
    balls = [{**ball, "position": [-0.31, 0.0285, 0], "velocity": [1.0, 0, 0]}, ball]
    billiards = Scene.from_dict({"body": balls})  # their gravity, 10⁻¹⁰ N, changes the approach by 2 × 10⁻¹⁰
    assert inexact_impacts(billiards) == ""
    assert inexact_impacts(pair(gravity=FALLING, plane=[{}])) == ""
    assert "err by up to about 1e-04; time.accuracy keeps" in inexact_impacts(cloud(8, time={"cfl": "auto"}))
    dragged = billiards.changed(["drag.relaxation_time=1"])
    assert inexact_impacts(dragged) == ""
    assert "set time.max_dt = 0.8 s for exact impacts" in inexact_impacts(dragged.changed(["drag.relaxation_time=0.1"]))
    assert inexact_impacts(dragged.changed(["drag.relaxation_time=0.1", "time.max_dt=0.8"])) == ""
    blown = {"domain": {"boundary": "periodic", "size": [4, 4, 4]}, "gravity": {"constant": 0.0}}
    blown |= {"body": [balls[0], {**ball, "fixed": True}], "drag": {"relaxation_time": 1, "medium_velocity": [1, 0, 0]}}
    assert "straight within a step in a periodic box" in inexact_impacts(Scene.from_dict(blown))
    assert "up to a step late" in inexact_impacts(billiards.changed(["time.integrator=yoshida4"]))
    assert inexact_impacts(cloud(8, time={"accuracy": 1e-6, "cfl": "auto"})) == ""


def test_bounces_that_end_at_rest_are_said_where_forces_press() -> None:
    heap = cloud(99, gravity=FALLING, plane=[{}])
    assert ended_bounces(cloud(99, gravity={"constant": 0.0})) == ""
    assert ended_bounces(heap.changed(["contact.restitution=0"])) == ""
    assert "end at rest" in ended_bounces(heap) and "faster than 2 × the pressing" in ended_bounces(heap)
    stepped = heap.changed(["time.fixed_dt=0.01", "gravity.uniform=[0, 0, -9.81]"])
    assert ", here at most 0.2 m/s" in ended_bounces(stepped), "2 × 9.81 m/s² × 0.01 s"
    assert "2 × the pressing" in ended_bounces(heap.changed(["contact.timing=end-of-step"]))


def test_the_parts_name_the_forces_in_the_order_of_their_sum() -> None:
    assert tuple(kind.name for kind in FORCES) == OWN_FORCES
