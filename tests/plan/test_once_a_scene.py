"""Decisions about a scene that are made once."""

from __future__ import annotations

import gc
import weakref

import pytest

from carom.errors import SceneError
from carom.plan.auto import integrator
from carom.plan.once_a_scene import once_a_scene
from carom.scene.load import Scene
from small_scenes import scene_of


def three_bodies(**sections: dict[str, object]) -> Scene:
    return scene_of([{"position": [2.0 * k, 0.0, 0.0], "velocity": [1.0 - k, 0.0, 0.0]} for k in range(3)], **sections)


def test_a_decision_is_made_once_for_each_scene_and_again_for_an_equal_one() -> None:
    asked: list[int] = []

    @once_a_scene
    def count(scene: Scene) -> int:
        asked.append(id(scene))
        return scene.count

    one, equal = three_bodies(), three_bodies()
    assert [count(one), count(one), count(equal), count(one)] == [3, 3, 3, 3]
    assert asked == [id(one), id(equal)]


def test_a_changed_copy_of_a_scene_gets_a_decision_of_its_own() -> None:
    scene = three_bodies(gravity={"constant": 0.0})
    assert integrator(scene).name == "leapfrog"
    time = scene.time.model_copy(update={"integrator": "yoshida4"})
    assert integrator(scene.model_copy(update={"time": time})).name == "yoshida4"
    assert integrator(scene).name == "leapfrog"


def test_no_answer_outlives_its_scene() -> None:
    """Scenes follow each other at the same addresses, with other answers."""

    @once_a_scene
    def duration(scene: Scene) -> float:
        return scene.time.duration

    kept = duration.__closure__
    assert kept is not None
    for seconds in range(1, 30):
        assert duration(three_bodies(time={"duration": float(seconds)})) == seconds
    gc.collect()
    answers = next(cell.cell_contents for cell in kept if isinstance(cell.cell_contents, dict))
    last = three_bodies()
    duration(last)
    assert list(answers) == [id(last)]


def test_no_answer_is_dropped_by_a_callback_which_would_swallow_an_interrupt() -> None:
    @once_a_scene
    def count(scene: Scene) -> int:
        return scene.count

    scene = three_bodies()
    count(scene)
    assert [reference.__callback__ for reference in weakref.getweakrefs(scene)] == [None]


def test_a_refusal_is_repeated() -> None:
    @once_a_scene
    def refuse(scene: Scene) -> int:
        raise SceneError(f"{scene.count} bodies")

    scene = three_bodies()
    for _ in range(2):
        with pytest.raises(SceneError, match="3 bodies"):
            refuse(scene)
