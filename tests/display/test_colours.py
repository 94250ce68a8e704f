"""One colour, one body: in every view, in the close-up, on its trail and on its curve."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.display import body_colours, close_up, movie
from carom.display.body_colours import BodyColours
from carom.display.presentation import Presentation, asked
from carom.display.request import Request
from carom.recording.edit.clip import clip
from carom.recording.layout import TRAILS, faint_bodies
from carom.recording.layout.canvas import Canvas
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from small_scenes import scene_of

BODIES = [
    {"name": "idle", "position": [0, 5, 0], "material": "wood"},
    {"name": "left", "position": [-2, 0, 0], "velocity": [1, 0, 0], "material": "steel"},
    {"name": "right", "position": [2, 0, 0], "velocity": [-1, 0, 0], "material": "wood"},
]
MATERIALS = [{"name": "steel", "colour": "yellow"}, {"name": "wood", "colour": "#b08968"}]
SETTINGS: dict[str, Any] = {
    "gravity": {"constant": 0.0},
    "material": MATERIALS,
    "time": {"duration": 2.0, "fixed_dt": 0.1},
}


@pytest.fixture(scope="module", params=["group", "material", "island"])
def collision(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Three bodies, of which the second and the third meet; recorded in colours of each kind."""
    scene = scene_of(BODIES, **SETTINGS, record={"colour_by": request.param, "every": "step"})
    return carom.run(scene, tmp_path_factory.mktemp("collision") / "run.rrd")


def colours_in(archetype: Any) -> list[int]:
    return [int(colour) for colour in archetype.colors.as_arrow_array().to_pylist()]


def recorded_colours(recording: Recording) -> list[int]:
    return [int(colour) for colour in recording._entities.static(paths.BODIES)["Ellipsoids3D:colors"]]


def sent_colours(path: str, shown: Presentation) -> dict[int, list[int]]:
    """Return the colours that an entity is sent, by step."""
    found: dict[int, list[int]] = {}
    for rows in shown.supplement.rows:
        for column in rows.columns if rows.path == path else ():
            if str(column.component_descriptor()).endswith(":colors"):
                found |= dict(zip(rows.steps.tolist(), column.as_arrow_array().to_pylist(), strict=True))
    return found


def test_a_body_has_the_same_colour_in_the_close_up_on_its_trail_and_on_its_curve(collision: Recording) -> None:
    shown = asked(collision, Request(bodies="1,2", plot="left.x,right.x"))
    statics = dict(shown.supplement.statics)
    if collision.info["colour_by"] == "island":  # in every frame
        sent = sent_colours(close_up.BODIES, shown)
        touching = {colours[1] for colours in sent.values()} - {palette.GREY}
        assert len(sent) >= collision.frames and len(touching) == 1, "grey, and one colour when they touch"
        assert all(left == right for left, right in sent.values())
        return
    recorded = recorded_colours(collision)
    assert colours_in(statics[close_up.BODIES]) == recorded[1:]
    assert colours_in(statics[TRAILS]) == recorded
    curves = [colours_in(statics[f"plot/body{body}/x"])[0] for body in (1, 2)]
    assert curves == palette.legible(recorded[1:]).tolist()


def test_the_trails_of_a_movie_have_the_colours_of_its_bodies(collision: Recording) -> None:
    layout = movie._layout(collision, [0.0, 1.0, 2.0], Canvas(480, 300, rendered=True), "bodies")
    if collision.info["colour_by"] != "island":  # which changes with the contacts
        assert colours_in(dict(layout.statics)[TRAILS]) == recorded_colours(collision)


def test_the_graph_draws_bodies_in_their_own_colours(collision: Recording) -> None:
    drawn = faint_bodies(header_of_recording(collision))[paths.BODIES]
    assert "colors" not in str(drawn), "no other colour is laid over the recorded one"


def test_colours_that_are_asked_for_are_those_of_the_close_up_too(collision: Recording) -> None:
    shown = asked(collision, Request(bodies="1,2", colour_by="graph"))
    bodies, pair = sent_colours(paths.BODIES, shown), sent_colours(close_up.BODIES, shown)
    assert bodies and {step: colours[1:] for step, colours in bodies.items()} == pair


def test_colours_that_change_with_time_are_read_for_the_bodies_of_the_close_up_only(
    collision: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    if collision.info["colour_by"] != "island":
        pytest.skip("its colours do not change with time")
    read = list[list[int]]()

    def rows(_: Recording, places: list[int]) -> list[Any]:
        read.append(places)
        return []

    monkeypatch.setattr(body_colours, "_as_recorded", rows)
    asked(collision, Request(bodies="1,2"))
    assert read == [[1, 2]]
    header = header_of_recording(collision)
    assert body_colours.recorded_colours(collision, header, []).colours.shape[1] == 0 and len(read) == 1, (
        "of none, none"
    )


def test_curves_of_one_body_or_of_bodies_alike_can_be_told_apart(collision: Recording) -> None:
    for text in ("left.x,left.y,right.x", "idle.x,right.x"):
        shown = asked(collision, Request(plot=text))
        curves = [one for path, one in shown.supplement.statics if path.startswith("plot/")]
        assert len({colours_in(curve)[0] for curve in curves}) == len(curves)


def test_a_close_up_of_a_clip_has_the_colours_of_the_whole(collision: Recording, tmp_path: Path) -> None:
    if collision.info["colour_by"] != "group":
        pytest.skip("one way of colouring is enough")
    clip(collision.path, tmp_path / "clip.rrd", 0.5, 1.5, bodies=[1, 2])
    shown = asked(Recording.open(tmp_path / "clip.rrd"), Request(bodies="1,2"))
    assert colours_in(dict(shown.supplement.statics)[close_up.BODIES]) == recorded_colours(collision)[1:]


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_two_shades_of_one_hue_are_two_colours_in_a_close_up(theme: str) -> None:
    shades = palette.legible(palette.body_colours(np.zeros(200, dtype=np.int64)), theme)
    for pair in (shades[[0, 1]], shades[[3, 3]]):
        told = close_up._told_apart(BodyColours(np.zeros(1, np.int64), np.zeros(1), pair[None]), theme).fixed
        assert told is not None and told[0] == pair[0] and told[1] not in shades
    apart = palette.legible([palette.SKY, palette.CLAY], theme)
    kept = close_up._told_apart(BodyColours(np.zeros(1, np.int64), np.zeros(1), apart[None]), theme).fixed
    assert kept is not None and kept.tolist() == apart.tolist(), "bodies that differ keep their colours"
