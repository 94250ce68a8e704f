"""The notation of values that vary in a sweep."""

from __future__ import annotations

from typing import Any

import pytest

from carom.errors import SceneError
from carom.scene.load import Scene
from carom.scene.variation import combinations, override, values_of


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0.2,0.6", (0.2, 0.6)),
        ("0,0.5,1", (0.0, 0.5, 1.0)),
        ("5", (5,)),
        ("0.1:0.9:5", (0.1, 0.3, 0.5, 0.7, 0.9)),
        ("10:50:5", (10, 20, 30, 40, 50)),
        ("0:1:3", (0.0, 0.5, 1.0)),
        ("1e-3:1:4log", (1e-3, 1e-2, 1e-1, 1.0)),
        ("100:10000:3log", (100, 1000, 10000)),
        ("1:-1:3", (1, 0, -1)),
        ("euler,leapfrog", ("euler", "leapfrog")),
        ("true,false", (True, False)),
        ("[0,0,-9.8],[0,0,-1.6]", ([0, 0, -9.8], [0, 0, -1.6])),
        ('"a,b",c', ("a,b", "c")),
    ],
)
def test_lists_ranges_and_log_ranges(text: str, values: tuple[Any, ...]) -> None:
    found = values_of(text)
    assert found == values
    assert [type(value) for value in found] == [type(value) for value in values]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected a list"),
        ("1,,2", "expected a list"),
        ("0:1:1", "two values or more"),
        ("0:1:3log", "two ends above 0"),
        ("0.5,0.5", "twice"),
        ("2:2:2", "twice"),
        ("[1, 2],[1.0, 2.0]", "twice"),
        ("0:1:100001", "more than 100000 runs"),
        ("0:1:" + "9" * 5000, "more than 100000 runs"),
        ("0:1e999:3", "finite"),
        ("0.5:1", "a first and a last value and their count"),
        ("1 km : 5 km", "a first and a last value and their count"),
        ("1:2:3:4", "a first and a last value and their count"),
        ("1:2:few", "a first and a last value and their count"),
    ],
)
def test_a_mistake_says_what_would_be_right(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        values_of(text)


def test_equal_ratios_between_ends_whose_ratio_overflows() -> None:
    assert values_of("1e-300:1e300:3log") == (1e-300, 1.0, 1e300)


def test_keys_are_crossed_or_go_side_by_side() -> None:
    axes = {"a": (1, 2), "b": (3, 4)}
    crossed = [{"a": 1, "b": 3}, {"a": 1, "b": 4}, {"a": 2, "b": 3}, {"a": 2, "b": 4}]
    assert combinations(axes, zipped=False) == crossed
    assert combinations(axes, zipped=True) == [{"a": 1, "b": 3}, {"a": 2, "b": 4}]
    assert combinations({}, zipped=False) == combinations({}, zipped=True) == [{}]
    with pytest.raises(ValueError, match="a has 2, b has 1"):
        combinations({"a": (1, 2), "b": (3,)}, zipped=True)


def test_a_scene_may_say_what_is_to_vary() -> None:
    vary = {"contact": {"restitution": "0.1:0.9:5"}, "contact.static_friction": [0.2, 0.6], "title": "a,b"}
    scene = Scene.from_dict({"body": [{}], "sweep": {"vary": vary, "seeds": 3}})
    assert scene.sweep.vary["contact.restitution"] == (0.1, 0.3, 0.5, 0.7, 0.9)
    assert scene.sweep.vary["contact.static_friction"] == (0.2, 0.6)
    assert scene.sweep.vary["title"] == ("a", "b")
    assert scene.sweep.seeds == 3 and not scene.sweep.zip


@pytest.mark.parametrize(
    ("sweep", "said"),
    [
        ({"vary": {"contact.restitution": "0:1:1"}}, "sweep.vary: .*two values or more"),
        ({"vary": 3}, "sweep.vary"),
        ({"seeds": 0}, "must be at least 1"),
        ({"seed": 4}, 'did you mean "seeds"'),
    ],
)
def test_a_mistake_in_the_section_names_its_key(sweep: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        Scene.from_dict({"body": [{}], "sweep": sweep})


def test_a_parameter_is_written_as_set_takes_it() -> None:
    assert override("contact.restitution", 0.3) == "contact.restitution=0.3"
    assert override("time.integrator", "euler") == 'time.integrator="euler"'
    assert override("gravity.uniform", [0, 0, -9.8]) == "gravity.uniform=[0, 0, -9.8]"
