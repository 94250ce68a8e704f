"""The reference says what it is, and how far it is to be trusted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carom.experiment.reference import fineness, make_reference, refined
from carom.scene.load import scene_from_text
from carom.scene.schema import Scene
from examples import cloud, pair


def test_a_few_bodies_have_an_exact_reference() -> None:
    reference = make_reference(Scene.load("figure-eight"))
    assert reference.kind == "exact" and math.isinf(reference.fineness) and reference.whole
    assert reference.horizon == Scene.load("figure-eight").time.duration
    assert reference.uncertainty.position <= 1e-12
    assert "DOP853" in reference.text


def test_an_exact_course_that_ends_early_says_so_and_is_compared_up_to_there() -> None:
    scene = pair(gravity={"constant": 1.0}, time={"duration": 20.0}, contact={"restitution": 0.3})
    reference = make_reference(scene)
    assert reference.kind == "exact" and not reference.whole
    assert 0.0 < reference.horizon < 20.0 and "it ends early: bodies 0 and 1 stay in contact" in reference.text


def test_many_bodies_are_refined_until_they_part_and_the_horizon_is_there() -> None:
    said: list[str] = []
    reference = make_reference(cloud(time={"duration": 1.5}), finest=1.0, budget=0.0, tell=said.append)
    assert reference.kind == "refined" and reference.fineness == 4.0
    assert said == [f"reference: steps {factor} times smaller" for factor in (2, 4)]
    assert 0.0 < reference.horizon < 1.5 and reference.uncertainty.position <= 1e-3
    assert "40 bodies are more than 20" in reference.text


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


def test_the_reference_of_a_tree_sums_directly() -> None:
    # steps alone would leave the error of the opening angle in both, and nothing would show it
    direct, tree = (
        cloud(30, time={"duration": 0.2}, contact={"enabled": False}, gravity={"method": method})
        for method in ("direct", "tree")
    )
    held, other = make_reference(tree), make_reference(direct)
    assert np.array_equal(held.trajectory.position, other.trajectory.position)
    assert "times smaller, and a direct sum (" in held.text and "direct" not in other.text
