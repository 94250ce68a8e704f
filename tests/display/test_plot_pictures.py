"""Plots as the viewer draws them, in both of its themes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from carom.display.picture import render
from carom.display.request import Request
from carom.recording.layout.canvas import Area
from carom.recording.layout.plot_views import place_legend
from carom.recording.read.recorded_scene import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.schema.palette import LINES, PLOT_GROUNDS
from carom.recording.write.recorder import FrameRecorder
from needs import PICTURES
from scripted_run import ScriptedRun

Pixels = NDArray[np.int64]
SIZE = (800, 500)
LEGENDS = {"gravitational": "purple", "rotational": "red", "total": "grey", "translational": "blue"}
DOT = 80  # px, of a dot in the legend, with its soft edge


@pytest.fixture(scope="module", params=PLOT_GROUNDS)
def energy(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, Pixels]:
    """The theme, a recording, and the picture of its energies."""
    folder, theme = tmp_path_factory.mktemp("plots"), str(request.param)
    with FrameRecorder(folder / "run.rrd", ScriptedRun(20).header) as recorder:
        for frame in ScriptedRun(20).frames(150):
            recorder.put(frame)
        recorder.finish("completed")
    render(folder / "run.rrd", Request(7.4), folder / "energy.png", SIZE, view="energy", theme=theme)
    return theme, folder / "run.rrd", np.asarray(Image.open(folder / "energy.png").convert("RGB"), dtype=np.int64)


def of_colour(pixels: Pixels, colour: int, tolerance: int = 30) -> NDArray[np.bool_]:
    wanted = np.array([colour >> shift & 0xFF for shift in (24, 16, 8)])
    return np.asarray(np.all(np.abs(pixels - wanted) <= tolerance, axis=2))


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_the_ground_of_a_plot_is_that_which_contrasts_are_measured_on(energy: tuple[str, Path, Pixels]) -> None:
    theme, _, pixels = energy
    assert np.mean(of_colour(pixels, PLOT_GROUNDS[theme], 0)) > 0.5


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_every_curve_is_drawn_in_its_full_colour(energy: tuple[str, Path, Pixels]) -> None:
    _, _, pixels = energy
    for legend, name in LEGENDS.items():
        # a curve crosses the whole picture, right of the numbers
        columns = np.any(of_colour(pixels, LINES[name]), axis=0)
        assert np.mean(columns) > 0.6, legend


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_the_legend_covers_no_curve(energy: tuple[str, Path, Pixels]) -> None:
    _, path, pixels = energy
    curves = recorded_curves(Recording.open(path))
    shown = [curves[f"energy/{name}"] for name in LEGENDS]
    lines = [header_of_recording(Recording.open(path)).title, "t = 7.4 s", *(f"{name} (J)" for name in LEGENDS)]
    place = place_legend(lines, shown, Area(SIZE[0] - 60.0, SIZE[1] - 18.0))
    right, bottom = "Right" in place.corner.name, "Bottom" in place.corner.name
    wide, tall = 7 * max(map(len, lines)) + 44, 23 * len(lines) + 14  # px, as in plot_views.py
    height = SIZE[1] - 18  # without the times below the plot
    rows = slice(height - tall, height) if bottom else slice(0, tall)
    # on the left the numbers of the axis come first: they are as wide as they are
    columns = slice(SIZE[0] - wide, SIZE[0]) if right else slice(0, wide + 60)
    box = pixels[rows, columns]
    for legend, name in LEGENDS.items():
        if name == "grey":
            continue  # so are the letters
        count = int(np.sum(of_colour(box, LINES[name])))
        assert 10 < count < DOT, f"{legend}: its dot, and nothing of its curve"
