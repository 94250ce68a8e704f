"""The texts in a recording, for readers who have Rerun but not carom."""

from __future__ import annotations

import re

import pytest

import carom
from carom.display.letters import drawable
from carom.recording.layout import turning_arrows
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.scene.load import Scene

SCENES = {
    "two-spheres": ["time.duration=1.7"],
    "incline": ["time.duration=0.1"],
    "elastic-gas": ["group.0.count=30", "time.duration=0.2"],
    "kepler-orbits": ["time.duration=1"],
}


@pytest.fixture(scope="module", params=SCENES)
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    scene = Scene.load(request.param, SCENES[request.param])
    return carom.run(scene, tmp_path_factory.mktemp("documents") / "run.rrd")


def text(recording: Recording, path: str) -> str:
    return str(recording._entities.static(path)["TextDocument:text"][0])


def test_about_names_every_entity_and_where_its_numbers_are(recording: Recording) -> None:
    about = text(recording, paths.ABOUT)
    named = {path for row in about.splitlines() for path in re.findall(r"^\| `/([a-z_/]+)`", row)}
    texts = {paths.ABOUT, paths.LEGEND, paths.SCENE, paths.WORLD}  # named in a sentence, or empty
    found = {entry.entity_path.strip("/") for entry in recording.store.entries}
    found = {path for path in found if not path.startswith(("__", "magnified"))}
    missing = {path for path in found - named - texts if not path.startswith(f"{paths.MOVING}/")}
    assert not missing
    if recording.records_contacts and recording.impacts().num_rows:
        assert named <= found, "it names nothing that the file lacks"
    for path in turning_arrows(header_of_recording(recording)):
        assert f"`{paths.MAGNITUDES[path]}` (" in about


def test_the_legend_explains_torques_and_impacts_where_there_are_any(recording: Recording) -> None:
    legend, header = text(recording, paths.LEGEND), header_of_recording(recording)
    assert ("torque" in legend) == header.has_torque
    assert ("does not depend on the length of the step" in legend) == (header.has_torque and header.records_contacts)
    assert legend.startswith("# Legend") and "Bodies:" in legend


def test_the_font_of_the_viewer_has_every_character(recording: Recording) -> None:
    for path in (paths.ABOUT, paths.LEGEND, paths.SCENE):  # a viewer without a screen ends at any other
        assert {letter for letter in text(recording, path) if not drawable(letter)} == set()


def test_the_command_of_about_reads_the_file(recording: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", text(recording, paths.ABOUT), re.DOTALL)
    exec(code.replace("FILE.rrd", str(recording.path)), {})
    assert "Scalars:scalars" in capsys.readouterr().out


def test_names_of_series_have_units(recording: Recording) -> None:
    for path, unit in (("energy/total", "J"), ("step/dt", "s")):
        (name,) = recording._entities.static(path)["SeriesLines:names"]
        assert str(name).endswith(f" ({unit})") or recording.units.own
