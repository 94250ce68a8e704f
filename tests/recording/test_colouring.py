from pathlib import Path

import numpy as np
import pytest

import carom
from carom.display import supplement
from carom.display.presentation import presentation
from carom.errors import RecordingError
from carom.recording.layout import drawing
from carom.recording.layout.camera import ASPECT, CameraFit
from carom.recording.layout.canvas import CameraMotion
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.timelines import STEP
from carom.recording.write.encoder import graph_colours
from carom.runs.replay import replay
from carom.scene.load import Scene
from small_scenes import cloud

PAIRS = np.array([[0, 1], [1, 2], [3, 4], [5, 7]])  # of 7 bodies: 7 is a plane


@pytest.fixture(scope="module")
def clump(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return carom.run(cloud(12, time={"duration": 1.0}), tmp_path_factory.mktemp("clump") / "clump.rrd")


def colours_sent(recording: Recording, by: str) -> dict[int, list[int]]:
    """Return the colours that a viewer is sent, by step."""
    rows = presentation(recording, 0.0, colour_by=by).supplement.rows
    (sent,) = [each for each in rows if each.path == paths.BODIES]
    (column,) = sent.columns
    return dict(zip(sent.steps, column.as_arrow_array().to_pylist(), strict=True))


def test_bodies_that_touch_have_different_colours_and_the_others_are_grey() -> None:
    colours = graph_colours(PAIRS, 7)
    assert colours[0] != colours[1] != colours[2] and colours[3] != colours[4]
    assert colours[6] == palette.GREY


def test_bodies_of_an_island_have_one_colour_and_a_plane_joins_none() -> None:
    colours = drawing.island_colours(PAIRS, 7)
    assert colours[0] == colours[1] == colours[2] != colours[3] == colours[4]
    assert colours[5] == colours[6] == palette.GREY


def test_faster_bodies_are_nearer_to_the_end_of_the_scale() -> None:
    order = drawing.speed_colours(np.array([0.0, 1.0, 3.0, 1e9]), 1.0).tolist()
    scale = list(dict.fromkeys(drawing.speed_colours(np.geomspace(1e-9, 1e9, 2000), 1.0).tolist()))
    assert [scale.index(colour) for colour in order] == [0, len(scale) // 2, len(scale) * 3 // 4, len(scale) - 1]


@pytest.mark.parametrize("reference", [0.0, np.nan])
def test_bodies_at_rest_have_a_colour(reference: float) -> None:
    assert len(set(drawing.speed_colours(np.zeros(3), reference).tolist())) == 1


@pytest.mark.slow
@pytest.mark.parametrize("by", ["speed", "graph", "island"])
def test_a_recording_in_colours_of_each_frame_replays_with_the_same_bits(by: str, tmp_path: Path) -> None:
    recording = carom.run(cloud(12, time={"duration": 1.0}, record={"colour_by": by}), tmp_path / "cloud.rrd")
    (entry, *_) = [e for e in recording.store.entries if e.entity_path == paths.BODIES and not e.is_static]
    (chunk,) = recording.chunks([entry])
    assert any(name.endswith(":colors") for name in chunk.components)
    assert recording.info["colour_by"] == by
    assert replay(recording).same


def test_islands_are_found_in_a_recording_that_was_coloured_by_group(clump: Recording, tmp_path: Path) -> None:
    recorded = carom.run(cloud(12, time={"duration": 1.0}, record={"colour_by": "island"}), tmp_path / "island.rrd")
    sent = colours_sent(clump, "island")
    entries = [e for e in recorded.store.entries if e.entity_path == paths.BODIES and not e.is_static]
    compared = 0
    for chunk in recorded.chunks(entries):
        name = next((name for name in chunk.components if name.endswith(":colors")), None)
        if name is None:  # bodies at the moment of an impact, which keep their colours
            continue
        for step, colours in zip(chunk.batch[STEP].to_pylist(), chunk.batch[name].to_pylist(), strict=True):
            assert sent[step] == colours, step
            compared += 1
    assert compared == len(recorded.fingerprints())


def test_a_scene_without_contacts_has_no_islands(tmp_path: Path) -> None:
    recording = carom.run(Scene.load("figure-eight", ["time.duration=0.1"]), tmp_path / "eight.rrd")
    with pytest.raises(RecordingError, match="has no contacts to colour by island; use group or speed"):
        presentation(recording, 0.0, colour_by="island")


def test_trails_lead_from_frame_to_frame_and_are_framed_with_the_bodies(tmp_path: Path) -> None:
    recording = carom.run(Scene.load("kepler-orbits", ["time.duration=8"]), tmp_path / "orbits.rrd")
    header = header_of_recording(recording)
    found = supplement.Trails(recording, header, header.static_colours("group"))
    (rows,) = found.rows()
    assert list(rows.steps) == recording.fingerprints()[STEP].to_pylist()[1:]
    first = recording.drawn_positions(0)
    assert first is not None
    camera = CameraFit(header.radius, first.astype(np.float64))
    found.show(camera, 8.0)
    path = np.concatenate([column.reshape(-1, 3) for column in found._points(1)[:, 1]]).astype(np.float64)
    assert camera.view().holds(path, np.zeros(len(path)), ASPECT).all()
    assert camera.view().motion is CameraMotion.STILL, "the path of a body is no reason to follow it"
