"""Likely mistakes in a scene are reported, and bundled scenes have none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from carom.errors import SceneError
from carom.plan.checks import doubts, refuse_impossible
from carom.scene.load import Scene, scene_from_text
from carom.scene.scene_file import bundled_scenes, extreme_scenes

STILL: dict[str, Any] = {"gravity": {"constant": 0}, "body": [{"mass": 2.0, "radius": 0.1}]}


def test_a_scene_without_forces_and_velocities_is_said_to_stay_as_it_is() -> None:
    text = "nothing can move: no force acts, and every velocity is 0"
    floor = {"plane": [{"normal": [0, 0, 1], "point": [0, 0, -1]}]}
    assert doubts(Scene.from_dict(STILL)) == doubts(Scene.from_dict(STILL | floor)) == [text]
    moved = (
        {"body": [{"velocity": [0, 1, 0], "mass": 2.0, "radius": 0.1}]},
        {"body": [{"angular_velocity": [0, 0, 1], "mass": 2.0, "radius": 0.1}]},
        {"gravity": {"constant": 0, "uniform": [0, 0, -9.81]}},
        {"group": [{"count": 2, "velocity": {"dispersion": 1.0}}]},
    )
    assert all(doubts(Scene.from_dict(STILL | change)) == [] for change in moved)


@pytest.mark.parametrize(("unit", "doubtful"), [("cm", True), ("m", False), ("km", True)])
def test_the_earths_number_in_another_unit_is_a_doubt(unit: str, doubtful: bool) -> None:
    body = {"body": [{"mass": "1 kg", "radius": "0.1 m"}]}
    field = {"gravity": {"uniform": [0, 0, -9.81]}, "units": {"length": unit}}
    found = doubts(Scene.from_dict(field | body))
    assert [text.endswith('field, write "9.81 m/s^2"') for text in found] == [True] * doubtful
    with_unit = {"gravity": {"uniform": [0, 0, "-9.81 m/s^2"]}, "units": {"length": unit}}
    assert doubts(Scene.from_dict(with_unit | body)) == []


def test_a_ball_of_50_g_without_a_radius_is_named_with_the_density_that_it_gets() -> None:
    bodies = [{"name": "ball", "mass": "50 g", "velocity": [1, 0, 0]}, {"mass": 0.05}]
    (text,) = doubts(Scene.from_dict({"body": bodies}))
    assert text == (
        'body.0 ("ball") has no radius and uses the default, 1 m: with its mass, the density is 0.012 kg/m³; '
        "the same holds for 1 more body"
    )


def test_no_bundled_scene_is_doubted() -> None:
    paths: dict[str, Path] = bundled_scenes() | extreme_scenes()
    assert {name: found for name in paths if (found := doubts(Scene.load(name)))} == {}


@pytest.mark.parametrize("section", ["", "[contact.rolling_resistance]"])
def test_a_law_without_a_coefficient_is_refused(section: str) -> None:
    scene = _with_rolling_resistance(section)
    with pytest.raises(SceneError) as refused:
        refuse_impossible(scene)
    assert str(refused.value).endswith(
        'contact.law = "rolling_resistance" without a coefficient has no effect; give rolling_friction or '
        "twisting_friction in [contact.rolling_resistance], or remove the law"
    )


@pytest.mark.parametrize(
    "section",
    [
        "[contact.rolling_resistance]\nrolling_friction = 0",  # stated, as in a sweep
        '[[plane]]\nname = "floor"\n[plane.rolling_resistance]\nrolling_friction = 0.1',
    ],
)
def test_a_coefficient_in_any_section_is_enough_for_a_law(section: str) -> None:
    refuse_impossible(_with_rolling_resistance(section))


def _with_rolling_resistance(section: str) -> Scene:
    return scene_from_text(
        f'[contact]\nlaw = "rolling_resistance"\n{section}\n[[body]]\nposition = [0, 0, 1]\n', "scene"
    )
