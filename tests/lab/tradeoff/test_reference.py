"""The reference states its method and its uncertainty."""

from __future__ import annotations

import itertools
import math
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carom.lab.compared_run import sample_times
from carom.lab.tradeoff import event_driven_reference as exact
from carom.lab.tradeoff.event_driven_reference import solve
from carom.lab.tradeoff.reference import fineness, make_reference, refined
from carom.physics.space import Space
from carom.scene.load import Scene, scene_from_text
from small_scenes import cloud, pair, scene_of


def test_a_few_bodies_have_an_exact_reference() -> None:
    reference = make_reference(Scene.load("figure-eight"))
    assert reference.kind == "exact" and math.isinf(reference.fineness) and reference.whole
    assert reference.horizon == Scene.load("figure-eight").time.duration
    assert reference.uncertainty.position <= 1e-12
    assert "DOP853" in reference.text


def elastic_balls(count: int, order: Any = None) -> Scene:
    """Let elastic balls attract each other for 6 s: each meets ten others or more, and a sample takes one step."""
    rng = np.random.default_rng(3)
    places: list[Any] = []
    while len(places) < count:
        place = rng.uniform(-1.0, 1.0, 3) * 0.62 * count ** (1 / 3)
        if all(np.linalg.norm(place - other) > 0.65 for other in places):
            places.append(place)
    velocities = 0.5 * rng.standard_normal((count, 3))
    bodies = [
        {"position": places[k].tolist(), "velocity": velocities[k].tolist(), "radius": 0.3, "mass": 1.0}
        for k in (range(count) if order is None else order)
    ]
    smooth = {"restitution": 1.0, "static_friction": 0.0, "kinetic_friction": 0.0}
    return scene_of(bodies, gravity={"constant": 1.0}, contact=smooth, time={"duration": 6.0, "fixed_dt": 0.01})


@pytest.mark.slow
@pytest.mark.parametrize("count", [8, pytest.param(20, marks=pytest.mark.slow)])
def test_the_uncertainty_of_an_exact_course_covers_what_renumbering_the_bodies_changes(count: int) -> None:
    # the same physics with other rounding, which contacts amplify: of 20 balls to more than 1e-3 before the end
    scene = elastic_balls(count)
    reference = make_reference(scene)
    order = np.random.default_rng(1).permutation(count)
    other = solve(Space(elastic_balls(count, order)), sample_times(scene)).trajectory
    apart = other.position[: reference.samples, np.argsort(order)] - reference.trajectory.position[: reference.samples]
    rms = np.sqrt(np.mean(np.sum(apart**2, axis=2), axis=1)) / reference.scale.length
    assert 0.0 < np.sqrt(np.mean(rms**2)) <= reference.uncertainty.position, "other bits, and within the claim"
    assert rms.max() <= 1e-3, "the horizon comes before they part"
    if count == 20:
        assert 4.0 < reference.horizon < 6.0


def test_no_reference_claims_to_know_more_than_rounding_leaves() -> None:
    # dyadic numbers: every solution is the same to the last bit
    still = scene_of(
        [{"velocity": [0.5, 0.0, 0.0]}], gravity={"constant": 0.0}, time={"duration": 8.0, "fixed_dt": 0.5}
    )
    uncertainty = make_reference(still).uncertainty
    assert min(uncertainty.position, uncertainty.velocity, uncertainty.size, uncertainty.dispersion) >= 2.0**-52


def test_an_impact_at_a_round_time_leaves_the_velocities_certain() -> None:
    # the balls of the cradle meet at 0.7 s, which a 140th of its 600 samples would be, before or after by rounding
    assert make_reference(Scene.load("newtons-cradle")).uncertainty.velocity <= 1e-13


def test_a_course_that_takes_too_long_ends_where_the_budget_does(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count()
    monkeypatch.setattr(exact, "clock", SimpleNamespace(thread_time=lambda: 1e-3 * next(ticks)))  # 1 ms a step
    e = 0.9999
    sun = {"mass": 1.0, "radius": 1e-3}
    comet = {"mass": 1e-12, "radius": 1e-3, "position": [1 + e, 0, 0], "velocity": [0, math.sqrt((1 - e) / (1 + e)), 0]}
    scene = scene_of(
        [sun, comet],
        gravity={"constant": 1.0},
        contact={"enabled": False},
        time={"duration": 200 * math.pi, "fixed_dt": 0.01},
    )
    reference = make_reference(scene, budget=0.9)
    assert reference.kind == "exact" and not reference.whole
    assert 0.0 < reference.horizon < 20 * math.pi
    assert "it ends early: after 0.3 s of computing it had reached t = " in reference.text


def test_an_exact_course_that_ends_early_says_so_and_is_compared_up_to_there() -> None:
    scene = pair(gravity={"constant": 1.0}, time={"duration": 20.0}, contact={"restitution": 0.3})
    reference = make_reference(scene)
    assert reference.kind == "exact" and not reference.whole
    assert 0.0 < reference.horizon < 20.0 and "it ends early: body 0 and body 1 stay in contact" in reference.text


def test_bodies_that_press_on_each_other_from_the_start_have_a_refined_reference() -> None:
    touching = [{"position": [x, 0.0, 0.0], "radius": 1.0, "mass": 1.0} for x in (-1.0, 1.0)]
    scene = scene_of(touching, gravity={"constant": 1.0}, time={"duration": 1.0, "fixed_dt": 0.1})
    reference = make_reference(scene, budget=0.0)
    assert reference.kind == "refined" and reference.is_complete
    assert "body 0 and body 1 stay in contact from t = 0 s on" in reference.text


def test_many_bodies_are_refined_until_they_part_and_the_horizon_is_there() -> None:
    said: list[str] = []
    reference = make_reference(cloud(time={"duration": 1.5}), finest=1.0, budget=0.0, tell=said.append)
    assert reference.kind == "refined" and reference.fineness == 2.0, "half its step is beyond the budget"
    assert said == ["reference: steps 2 times smaller", "reference: its check, with twice the step"]
    assert 0.0 < reference.horizon < 1.5 and reference.uncertainty.position <= 1e-3
    assert "40 bodies, more than 20" in reference.text


@pytest.mark.parametrize(("budget", "fineness", "cost"), [(14.0, 4.0, 10.0), (16.0, 8.0, 16.0)])
def test_the_reference_of_a_pile_leaves_time_for_the_runs_with_other_seeds(
    monkeypatch: pytest.MonkeyPatch, budget: float, fineness: float, cost: float
) -> None:
    said: list[str] = []

    class Clock:
        """A run of the scene takes a second, and one with steps k times smaller k seconds."""

        @property
        def seconds(self) -> float:
            factors = [re.search(r"(\d+) times smaller", text) for text in said]
            return sum(
                (float(found[1]) if found else 2.0 if "its check" in text else 1.0)
                for found, text in zip(factors, said, strict=True)
            )

    monkeypatch.setattr("carom.lab.tradeoff.reference.Stopwatch", Clock)
    pile = scene_of(
        [],
        group=[
            {"count": 4, "radius": 0.05, "region": {"shape": "box", "size": [0.4, 0.4, 0.4], "centre": [0, 0, 0.25]}}
        ],
        plane=[{}],
        contact={"restitution": 0.3},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        time={"duration": 0.5},
    )
    monkeypatch.setattr("carom.lab.tradeoff.reference.Reference.is_complete", property(lambda reference: False))
    reference = make_reference(pile, finest=2.0, budget=budget, tell=said.append)
    assert (reference.fineness, Clock().seconds) == (fineness, cost)
    assert sum("seed" in text for text in said) == 4


def test_where_nothing_pulls_the_reference_has_times_of_impact() -> None:
    # the same impacts whatever the step: two refinements are apart by rounding, and by what four collisions make of it
    reference = make_reference(Scene.load("elastic-gas", ["time.duration=1"]), finest=0.125, budget=0.0)
    assert reference.kind == "refined" and reference.horizon == 1.0
    assert reference.uncertainty.impact <= 1e-9 and reference.trajectory.overlap <= 1e-12


@pytest.mark.parametrize("rule", [{"fixed_dt": 0.02}, {"max_dt": 0.3, "cfl": 0.2}, {"target_dx": 0.01}])
def test_a_refined_scene_has_smaller_steps_whatever_sets_them(rule: dict[str, float]) -> None:
    scene = pair(gravity={"constant": 1.0}, time=rule)
    half = scene_from_text(scene.toml, "half", refined(scene, 2.0))
    assert fineness(scene, half) == pytest.approx(2.0)


def test_a_setting_that_chooses_its_steps_by_its_error_asks_for_no_finer_reference() -> None:
    bodies = [{"position": [float(k), 0.1 * k * k, 0.0], "mass": 1e9} for k in range(40)]
    scene = scene_of(bodies, contact={"enabled": False}, time={"integrator": "leapfrog", "duration": 1e3})
    assert fineness(scene, scene.changed(["time.integrator=gauss-radau15"])) == 1.0
    assert fineness(scene, scene.changed(["time.max_dt=0.25"])) == pytest.approx(4.0)


def test_the_reference_of_a_tree_sums_directly() -> None:
    # steps alone would leave the error of the opening angle in both, and nothing would show it
    direct, tree = (
        cloud(30, time={"duration": 0.2}, contact={"enabled": False}, gravity={"method": method})
        for method in ("direct", "tree")
    )
    held, other = make_reference(tree), make_reference(direct)
    assert np.array_equal(held.trajectory.position, other.trajectory.position)
    assert "times smaller, and a direct sum (" in held.text and "direct" not in other.text
