"""Pictures of the bundled scenes at their hardest impact, and of orbits."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import carom
from carom.display.picture import render
from carom.display.request import Request
from carom.recording.layout import drawing
from carom.recording.schema import palette
from carom.scene.load import Scene
from needs import PICTURES
from picture_pixels import Pixels, of_colour, of_hue, view

SIZE = (1600, 1000)
SHARES = (3.0, 2.2, 2.0)  # widths of the views of bodies, graph and close-up
IMPACTS = {  # scenes with impacts, cut off after a hard one
    "two-spheres": 1.7,
    "rack-break": 0.06,
    "elastic-gas": 0.5,
    "planet-with-gravel": 300.0,
    "cloud-collapse": 2000.0,
}
SUN = """
title = "A sun with planetesimals at 1 au"
[time]
duration = 2e7
fixed_dt = 1e5
[gravity]
constant = 6.674e-11
[[body]]
radius = 6.96e8
mass = 1.989e30
"""
PLANETESIMAL = "[[body]]\nradius = 1e5\nposition = [{x}, {y}, 0]\nvelocity = [{u}, {v}, 0]\n"


def filled(pixels: Pixels) -> float:
    """Return the extent of the drawn content over the shorter side of the view, without a few stray pixels."""
    ground = np.median(pixels, axis=(0, 1))
    drawn = np.argwhere(np.abs(pixels - ground).sum(axis=2) > 56)
    low, high = np.percentile(drawn, [0.5, 99.5], axis=0)
    return float(np.max(high - low) / min(pixels.shape[:2]))


def picture(scene: Scene, folder: Path, *, view: str = "all", theme: str = "dark") -> Pixels:
    carom.run(scene, folder / "run.rrd")
    render(folder / "run.rrd", Request(), folder / "run.png", SIZE, view=view, theme=theme)
    return np.asarray(Image.open(folder / "run.png").convert("RGB"), dtype=np.int64)


@pytest.mark.slow
@pytest.mark.parametrize("name", IMPACTS)
@pytest.mark.needs(PICTURES)
def test_the_hardest_impact_of_a_scene_is_framed_with_its_edge_and_arrow(name: str, tmp_path: Path) -> None:
    pixels = picture(Scene.load(name, [f"time.duration={IMPACTS[name]}"]), tmp_path)
    bodies, graph, close = (view(pixels, number, SHARES) for number in range(3))
    for what, shown in (("bodies", bodies), ("graph", graph), ("close-up", close)):
        assert filled(shown) > 0.5, what
    if name != "elastic-gas":  # a thousand molecules hide the one edge of the instant
        assert sum(of_colour(graph, int(colour)) for colour in drawing.COLOURS) > 15, "edges of the graph"
    assert sum(of_colour(close, int(colour), 60) for colour in drawing.COLOURS) > 15, (
        "the edge, seen through the two bodies"
    )
    assert of_colour(close, palette.YELLOW, 60) > 100, "the arrow of the impulse"
    hues = max(of_hue(close, hue) for hue in palette.BODIES)
    assert hues > 0.01 * close.shape[0] * close.shape[1], "one of the two bodies"


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_orbits_are_seen_as_trails_in_the_light_theme_as_well(tmp_path: Path) -> None:
    pixels = picture(Scene.load("kepler-orbits"), tmp_path, theme="light")
    shown = view(pixels, 0, (3.0,))
    assert np.median(shown) == 255, "white paper"
    assert filled(shown) > 0.5
    for colour in palette.BODIES[1:5]:
        assert of_hue(shown, colour) > 200, "the trail of each planet"


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_bodies_whose_names_the_viewers_font_lacks_have_a_dark_picture_like_others(tmp_path: Path) -> None:
    scene = Scene.load("two-spheres", ["body.0.name=左", "body.1.name=🎱"])
    pixels = picture(scene, tmp_path)
    assert filled(view(pixels, 0, SHARES)) > 0.5
    assert np.median(pixels) < 40


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_no_box_of_the_mouse_pointer_covers_a_close_up_in_the_light_theme(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(palette.GROUNDS, "light", palette.BACKGROUND)  # on which the box, which is white, is seen
    pixels = picture(Scene.load("rack-break", ["time.duration=0.06"]), tmp_path, view="close-up", theme="light")
    white = np.mean(pixels.min(axis=2) > 250)
    assert white < 0.01, "labels cover 0.2 % of the picture; the box that says what the pointer is on covers 2 %"


GRAINS = """
title = "Grains of a millimetre"
[time]
duration = 0.03
fixed_dt = 1e-4
[gravity]
constant = 0.0
uniform = [0, 0, -9.81]
[[plane]]
[[body]]
radius = 1e-3
position = [0, 0, 4e-3]
[[body]]
radius = 1e-3
position = [5e-4, 0, 7e-3]
"""


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_grains_of_a_millimetre_are_framed_like_large_bodies(tmp_path: Path) -> None:
    file = tmp_path / "grains.toml"
    file.write_text(GRAINS)
    pixels = picture(Scene.load(str(file)), tmp_path)
    for number in range(3):
        assert filled(view(pixels, number, SHARES)) > 0.5, ("bodies", "graph", "close-up")[number]


PLANETS = """
title = "Two bodies of 10⁹ m"
[time]
duration = 2.0
fixed_dt = 1e-2
[gravity]
constant = 0.0
[[body]]
radius = 1e9
position = [-2e9, 0, 0]
velocity = [1e9, 0, 0]
[[body]]
radius = 1e9
position = [2e9, 3e8, 0]
velocity = [-15e8, 0, 0]
"""


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_edges_and_arrows_are_seen_between_bodies_larger_than_planets(tmp_path: Path) -> None:
    file = tmp_path / "planets.toml"
    file.write_text(PLANETS)
    pixels = picture(Scene.load(str(file)), tmp_path)
    graph, close = (view(pixels, number, SHARES) for number in (1, 2))
    assert sum(of_colour(graph, int(colour)) for colour in drawing.COLOURS) > 30, "the edge of the graph"
    assert of_hue(graph, palette.MAGENTA) > 100, "the arrows of the angular impulses"
    assert of_colour(close, palette.YELLOW, 60) > 100, "the arrow of the impulse"


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_bodies_far_smaller_than_a_pixel_are_seen_as_dots(tmp_path: Path) -> None:
    file = tmp_path / "sun.toml"
    turns = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    others = [PLANETESIMAL.format(x=1.5e11 * x, y=1.5e11 * y, u=-2.98e4 * y, v=2.98e4 * x) for x, y in turns]
    file.write_text(SUN + "".join(others))
    pixels = picture(Scene.load(str(file)), tmp_path, view="bodies")
    assert filled(pixels) > 0.5
    for hue in palette.BODIES[1:5]:
        assert of_hue(pixels, hue) > 100, "a dot and a trail"
