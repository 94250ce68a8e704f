import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from carom import Scene, run
from carom.display import viewer
from carom.display.letters import drawable
from carom.display.picture import _marked, is_picture_of_carom, render
from carom.display.request import Request
from carom.display.viewer import Viewer, broken_off, reason_of
from carom.errors import RecordingError
from carom.physics.placement.initial_state import place
from carom.recording.layout import LEGEND_SHARE, drawing
from carom.recording.schema import palette
from carom.recording.write.recorder import FrameRecorder
from carom.scene.scene_file import bundled_scenes
from carom_command import carom
from needs import PICTURES
from picture_pixels import Pixels, of_colour, of_hue, region, view
from scripted_run import ScriptedRun

SIZE = (1600, 1000)


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Pixels:
    folder = tmp_path_factory.mktemp("picture")
    scripted = ScriptedRun(60)
    with FrameRecorder(folder / "run.rrd", scripted.header) as recorder:
        for frame in scripted.frames(150):
            recorder.put(frame)
        recorder.finish("completed")
    assert render(folder / "run.rrd", Request(3.0), folder / "run.png", SIZE).time == 3.0
    return np.asarray(Image.open(folder / "run.png").convert("RGB"), dtype=np.int64)


def bodies_view(pixels: Pixels) -> Pixels:
    return view(pixels, 0)


def graph_view(pixels: Pixels) -> Pixels:
    return view(pixels, 1)


def plots(pixels: Pixels) -> Pixels:
    return region(pixels, 0.0, 0.58, 1.0 - LEGEND_SHARE, 0.8)


def test_a_picture_does_not_replace_what_is_no_picture(tmp_path: Path) -> None:
    run(Scene.load("two-spheres", ["time.duration=0.1"]), tmp_path / "run.rrd")
    before = (tmp_path / "run.rrd").read_bytes()
    for name in ("run.rrd", "run.jpg", "run"):
        with pytest.raises(RecordingError, match=f"cannot write .*{name}: a picture is a .png"):
            render(tmp_path / "run.rrd", Request(), tmp_path / name)
    assert (tmp_path / "run.rrd").read_bytes() == before


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_a_picture_of_another_command_is_not_replaced(tmp_path: Path) -> None:
    # as crosscheck.png, the figure of `carom crosscheck`, beside its crosscheck.rrd
    figure = tmp_path / "crosscheck.png"
    Image.new("RGB", (8, 8)).save(figure)
    drawn = figure.read_bytes()
    assert not is_picture_of_carom(figure)
    done = carom("picture", "crosscheck.rrd", "-o", "crosscheck.png", cwd=tmp_path)
    assert done.returncode == 2 and "crosscheck.png: exists; give --force to replace it" in done.stderr
    assert figure.read_bytes() == drawn
    marked = tmp_path / "picture.png"
    marked.write_bytes(_marked(drawn))
    assert is_picture_of_carom(marked)
    with Image.open(marked) as picture:
        picture.load()  # checks the sum of every chunk
        assert picture.size == (8, 8)


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_spheres_of_every_group_fill_the_first_view(picture: Pixels) -> None:
    shown = bodies_view(picture)
    for colour in palette.BODIES[:3]:
        assert of_hue(shown, colour) > 0.005 * shown.shape[0] * shown.shape[1]
    drawn = np.argwhere(shown.sum(axis=2) > 150)
    spread = np.ptp(drawn, axis=0) / shown.shape[:2]
    assert spread[0] > 0.6, "the bodies are to fill the view from top to bottom"


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_the_second_view_shows_wires_edges_and_arrows(picture: Pixels) -> None:
    shown = graph_view(picture)
    wires = sum(of_hue(shown, colour) for colour in palette.BODIES[:3])
    assert wires > 100, "wires of the bodies that touch, in their colours"
    assert of_hue(shown, palette.ORANGE) > 300, "torques"
    for stage in (palette.YELLOW, palette.PURPLE):
        assert of_colour(shown, stage) > 30, "contacts, by stage"


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_the_plots_show_their_series(picture: Pixels) -> None:
    view = plots(picture)
    for name in ("blue", "red", "purple", "grey"):
        assert of_colour(view, palette.LINES[name]) > 50, name


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_the_ground_is_dark(picture: Pixels) -> None:
    assert np.median(picture.sum(axis=2)) < 100


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_a_picture_at_no_time_shows_the_hardest_impact(tmp_path: Path) -> None:
    scripted = ScriptedRun(8)
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in scripted.frames(60):
            recorder.put(frame)
        recorder.finish("completed", {"moments.impact.time": 1.25})
    assert render(tmp_path / "run.rrd", Request(), tmp_path / "run.png", (800, 600)).time == 1.25
    assert Image.open(tmp_path / "run.png").size == (800, 600)


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_the_picture_of_the_bundled_collapse_shows_spheres_arrows_edges_and_plots(tmp_path: Path) -> None:
    carom = [sys.executable, "-m", "carom"]
    recording, png = str(tmp_path / "cloud.rrd"), tmp_path / "cloud.png"
    subprocess.run([*carom, "run", "cloud-collapse", "-o", recording], check=True)
    subprocess.run([*carom, "picture", recording, "--at", "7600", "-o", str(png)], check=True)
    pixels = np.asarray(Image.open(png).convert("RGB"), dtype=np.int64)
    shares = (3, 2.2, 2)  # with the close-up
    bodies, graph = view(pixels, 0, shares), view(pixels, 1, shares)
    assert of_hue(bodies, palette.SKY) > 0.05 * bodies.shape[0] * bodies.shape[1], "spheres"
    faint = of_colour(graph, palette.FAINTEST["dark"], 5)
    assert faint > 1000, "wires of a crowd in which more bodies touch than are drawn alone, fainter than its arrows"
    assert of_hue(graph, palette.ORANGE) > 300, "torques"
    assert sum(of_colour(graph, int(colour)) for colour in drawing.COLOURS) > 300, "contacts, by impulse"
    for name in ("blue", "red", "purple", "grey"):
        assert of_colour(plots(pixels), palette.LINES[name]) > 50, name


@pytest.mark.parametrize(
    ("log", "said"),
    [
        (
            "wgpu adapter backend: Vulkan\nthread 'main' panicked at 'No glyph for \"名\" (U+540D) in Proportional.",
            "名",
        ),
        ("wgpu adapter backend: Vulkan\nthread 'main' panicked at 'index out of bounds'\n", "index out of bounds"),
    ],
)
def test_a_viewer_that_breaks_off_is_not_said_to_lack_a_driver(log: str, said: str) -> None:
    told = broken_off(log)
    assert told is not None and said in told and "Vulkan" not in told
    assert broken_off("wgpu adapter backend: Vulkan\n") is None


@pytest.mark.parametrize(
    "log",
    [
        "thread 'main' panicked at 'Failed to get render context'",
        "thread 'main' panicked at 'Library libxkbcommon-x11.so could not be loaded.'",
        "thread 'main' panicked at 'something that nobody has seen yet'",
        "rerun: error while loading shared libraries: libX11.so.6: cannot open shared object file",
        "Xvfb, the virtual screen, did not start",
        "",
    ],
)
def test_a_viewer_that_draws_nothing_names_the_packages_that_it_may_lack(log: str) -> None:
    assert "mesa-vulkan-drivers" in reason_of(log)


def test_the_bundled_scenes_need_no_virtual_screen() -> None:
    assert all(drawable(text) for name in bundled_scenes() for text in place(Scene.load(name)).name)
    assert drawable("Ω–½ дом µm² →") and not drawable("名") and not drawable("🎱")


@pytest.mark.skipif(sys.platform != "linux", reason="macOS comes with a driver")
@pytest.mark.parametrize("hidden", [("LIBGL_DRIVERS_PATH",), (), ("__EGL_VENDOR_LIBRARY_FILENAMES",)])
def test_without_a_driver_the_packages_are_named(
    tmp_path: Path, scripted: ScriptedRun, monkeypatch: pytest.MonkeyPatch, hidden: tuple[str, ...]
) -> None:
    """Without Mesa's OpenGL there is no adapter; with it, one that the viewer cannot draw with."""
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        recorder.put(next(scripted.frames(1)))
        recorder.finish("completed")
    monkeypatch.setenv("VK_DRIVER_FILES", "/nowhere.json")  # the Vulkan loader then finds no driver
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nowhere.json")
    for name in hidden:
        monkeypatch.setenv(name, "/nowhere")
    with pytest.raises(RecordingError, match="mesa-vulkan-drivers"):
        render(tmp_path / "run.rrd", Request(0.0), tmp_path / "run.png")
    assert not (tmp_path / "run.png").exists()


def test_a_viewer_that_answers_late_is_asked_again_unless_that_would_do_something_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(viewer, "_DYING", 0.0)
    busy = Viewer.__new__(Viewer)
    busy._process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    tries = list[int]()

    def late() -> str:
        tries.append(len(tries))
        if len(tries) < 3:
            raise OSError("Deadline expired before operation could complete")
        return "the picture"

    try:
        assert busy._ask(late) == "the picture" and len(tries) == 3
        tries.clear()
        with pytest.raises(RecordingError, match="does not answer: Deadline"):
            busy._ask(late, again=False)
        assert len(tries) == 1
    finally:
        busy._process.communicate()
