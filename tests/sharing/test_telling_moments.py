"""The moments that explain a recording, and their captions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import carom
from carom.recording.read.recording import Recording
from carom.runs.outcome import description, problems
from carom.scene.load import Scene
from carom.scene.scene_file import starter
from carom.sharing.publish import telling_moments


def ball(**changes: Any) -> Scene:
    """A ball of 1 kg that falls 1 m and bounces at 0.45, 1.17, 1.75, 2.21, 2.58 and 2.88 s."""
    document: dict[str, Any] = {
        "title": "A ball",
        "body": [{"name": "ball", "position": [0, 0, 1.1], "radius": 0.1, "mass": 1.0}],
        "plane": [{"name": "floor", "point": [0, 0, 0], "normal": [0, 0, 1]}],
        "gravity": {"uniform": [0, 0, -9.81]},
        "contact": {"restitution": 0.8},
        "time": {"duration": 3.0, "fixed_dt": 0.01},
    }
    return Scene.from_dict(document | changes)


@pytest.fixture(scope="module")
def bounces(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return carom.run(ball(), tmp_path_factory.mktemp("ball") / "ball.rrd")


def test_each_of_six_bounces_explains_the_run_and_then_its_end(bounces: Recording) -> None:
    moments = telling_moments(bounces)
    assert [moment.request.event for moment in moments] == [*(f"impact:{k}" for k in range(1, 7)), None]
    assert moments[-1].heading == "At the end" and moments[-1].time == 3.0
    assert [moment.close for moment in moments] == [*6 * [True], False]
    table = bounces.impacts()
    assert [moment.time for moment in moments[:-1]] == table["time"].to_pylist()
    first = moments[0]
    assert first.heading == 'Impact 1: body 0 "ball" and floor'
    assert first.details[:2] == ["approach 4.429 m/s", "impulse 7.973 N s"]  # sqrt(2 g h), 1.8 of it times 1 kg
    assert first.details[2] == "energy lost 3.532 J"  # (1 - 0.8^2) m g h


def test_impacts_that_are_faint_beside_the_hardest_explain_nothing(tmp_path: Path) -> None:
    """Of restitution 0.05 each bounce has 1/20 of the impulse before: two have 1/100 of the first."""
    recording = carom.run(
        ball(contact={"restitution": 0.05}, time={"duration": 0.6, "fixed_dt": 0.001}), tmp_path / "ball.rrd"
    )
    assert recording.impacts().num_rows > 2
    assert [moment.request.event for moment in telling_moments(recording)] == ["impact:1", "impact:2", None]


def test_many_impacts_are_explained_by_the_hardest_and_the_most_contacts(cloud_run: Recording) -> None:
    moments = telling_moments(cloud_run)
    assert cloud_run.impacts().num_rows > 10
    assert [moment.time for moment in moments] == sorted(moment.time for moment in moments)
    told = "\n".join(text for moment in moments for text in (moment.heading, *moment.details))
    for text in ("Hardest impact", "Most contacts", "At the end"):
        assert told.count(text) == 1, text
    assert sum(moment.close for moment in moments) == 3


def test_what_went_wrong_is_said(tmp_path: Path) -> None:
    """With impacts at the ends of steps, the ball is 0.01 s 4.4 m/s deep in the floor at most."""
    contact = {"restitution": 0.8, "timing": "end-of-step"}
    recording = carom.run(ball(contact=contact, expect={"max_overlap": 1e-3}), tmp_path / "ball.rrd")
    told = problems(recording, 5)
    assert told[0].startswith("promise max_overlap missed: ")
    assert any("overlap" in f"{moment.heading} {moment.details}" for moment in telling_moments(recording))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "# A ball.\n#\n# Look for: the height\n# of each.\n# Change: g.\n\nseed = 1",
            ["A ball.", "Look for: the height\nof each.", "Change: g."],
        ),
        ("#:schema scene.schema.json\nseed = 1", []),
        (starter(), []),
        ('# A ball.\ndescription = "Its own words."', ["Its own words."]),
        ("# no scene\n[[", []),
    ],
    ids=["comment", "schema", "starter", "own", "not TOML"],
)
def test_a_scene_without_a_description_is_described_by_its_comment(text: str, said: list[str]) -> None:
    assert [part for part in description(text).split("\n\n") if part] == said
