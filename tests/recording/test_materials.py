"""A recording keeps the materials of its bodies: their colours, and the coefficients of their contacts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.display.presentation import presentation
from carom.errors import RecordingError
from carom.recording.edit.clip import clip
from carom.recording.layout import drawing
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import ShownMaterials
from carom.runs.replay import replay
from carom.scene.load import Scene
from carom.scene.schema.contact import BODY_COLOURS, COLOURS
from carom_command import carom as command
from small_scenes import scene_of

SKY, SAND, GREY = palette.SKY, 0xB08968FF, palette.GREY


@pytest.fixture(scope="module")
def hops(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return carom.run(Scene.load("five-materials", ["time.duration=0.6"]), tmp_path_factory.mktemp("hops") / "hops.rrd")


def recorded_colours(recording: Recording) -> list[int]:
    return [int(colour) for colour in recording._entities.static(paths.BODIES)["Ellipsoids3D:colors"]]


def test_bodies_have_the_colours_of_their_materials(hops: Recording) -> None:
    assert hops.info["colour_by"] == "material"
    assert recorded_colours(hops) == [SKY, GREY, palette.INDIGO, palette.MINT, SAND]


def test_the_texts_of_a_recording_name_materials_colours_and_coefficients(hops: Recording) -> None:
    legend, text = (str(hops._entities.static(path)["TextDocument:text"][0]) for path in (paths.LEGEND, paths.SCENE))
    assert "by material, glass sky blue, steel grey, rubber indigo, wood mint, clay #b08968" in legend
    assert "| glass and plate (steel) | 0.93 | 0.3 | 0.2 |" in text
    assert "| rubber on rubber | 0.8 | 1 | 0.8 |" in text


def test_a_replay_has_the_same_bits_and_a_clip_the_same_materials(hops: Recording, tmp_path: Path) -> None:
    assert replay(hops).same
    piece = Recording.open(clip(hops.path, tmp_path / "piece.rrd", 0.4, 0.5, bodies=[1, 4]).path)
    header = header_of_recording(piece)
    assert header.coloured_by == "material"
    assert header.static_colours("material")[piece.shown].tolist() == [GREY, SAND]
    assert replay(piece).same


def test_a_viewer_may_colour_by_group_and_by_material(hops: Recording) -> None:
    def sent(by: str) -> list[int]:
        (rows,) = [each for each in presentation(hops, 0.0, colour_by=by).supplement.rows if each.path == paths.BODIES]
        (column,) = rows.columns
        return [int(colour) for colour in column.as_arrow_array().to_pylist()[0]]

    assert sent("group") == palette.body_colours(np.full(5, -1)).tolist()


def test_a_recording_without_materials_is_not_coloured_by_them(tmp_path: Path) -> None:
    recording = carom.run(Scene.load("two-spheres", ["time.duration=0.1"]), tmp_path / "two.rrd")
    assert header_of_recording(recording).materials is None
    with pytest.raises(RecordingError, match=r"has no \[\[material\]\] to colour by; use group"):
        presentation(recording, 0.0, colour_by="material")


def test_inspect_lists_the_contacts_of_each_material(hops: Recording, tmp_path: Path) -> None:
    listed = json.loads(command("inspect", str(hops.path), "--json", cwd=tmp_path).stdout)["materials"]
    assert [material["name"] for material in listed] == ["glass", "steel", "rubber", "wood", "clay"]
    assert listed[0]["contacts"]["plate (steel)"] == {
        "restitution": 0.93,
        "static_friction": 0.3,
        "kinetic_friction": 0.2,
    }


@pytest.mark.parametrize(
    ("colours", "shown"),
    [
        ([None, None], [*palette.BODIES[:2]]),
        (["sky-blue", None], [*palette.BODIES[:2]]),
        (["#12AbeF", "white"], [0x12ABEFFF, palette.WHITE]),
    ],
)
def test_materials_without_a_colour_take_one_that_is_left(colours: list[str | None], shown: list[int]) -> None:
    given: list[dict[str, Any]] = [{} if colour is None else {"colour": colour} for colour in colours]
    names = ["a", "b"]
    scene = scene_of(
        [{"position": [3 * k, 0, 0], "material": name} for k, name in enumerate(names)],
        material=[{"name": name, **colour} for name, colour in zip(names, given, strict=True)],
    )
    found = ShownMaterials.of(scene)
    assert found is not None
    assert found.colours == shown


def test_every_colour_that_a_scene_may_name_is_in_the_palette() -> None:
    assert tuple(palette.NAMED) == COLOURS


def test_no_material_of_a_bundled_scene_has_a_colour_of_arrows_or_edges() -> None:
    """Nor has any name of a colour of bodies."""
    taken = {*palette.ARROWS.values(), *palette.STAGES[:1], *drawing.COLOURS.tolist()}
    scenes = [Scene.load(name) for name in ("five-materials", "incline")]
    given = [material.colour for scene in scenes for material in scene.material]
    assert len(given) > 6 and taken.isdisjoint(palette.material_colours(given))
    assert taken.isdisjoint(palette.NAMED[name] for name in BODY_COLOURS)
