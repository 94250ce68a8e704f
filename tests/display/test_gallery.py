"""The pictures of docs/gallery.md can be made by its commands, and show what a person would check in each of them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from carom.display import picture
from carom.recording.schema import palette
from gallery import FOLDER, entries, make
from needs import PICTURES
from picture_pixels import Pixels, hue_mask, largest_piece

MOST_BYTES = 1_500_000  # of all pictures, so that a clone stays small
LARGEST = 1000  # pixels: the page shows pictures 800 pixels wide, where smaller letters cannot be read
FEW = ("bounce", "cradle", "explosion", "incline", "materials", "orbits")  # bodies, all of which must be inside
DRAWN = 56  # sum of the differences of the channels from the ground
MEASURED = (*FEW, "pile")
Made = dict[str, Pixels]


def pixels_of(path: Path) -> Pixels:
    return np.asarray(Image.open(path).convert("RGB"), dtype=np.int64)


def test_every_picture_of_the_page_is_there_and_all_are_small() -> None:
    names = {entry.name for entry in entries()}
    files = {path.stem: path for path in FOLDER.glob("*.png")}
    assert len(names) >= 12 and files.keys() == names
    assert sum(path.stat().st_size for path in files.values()) < MOST_BYTES
    for path in files.values():
        with Image.open(path) as image:
            assert image.width <= LARGEST, path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The pictures in which something is measured, as they are made now."""
    folder, done = tmp_path_factory.mktemp("gallery"), set[str]()
    return {entry.name: pixels_of(make(entry, folder, done)) for entry in entries() if entry.name in MEASURED}


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_pictures_of_the_gallery_have_all_bodies_inside_no_empty_half_and_equal_balls_of_one_size(made: Made) -> None:
    for name in MEASURED:
        pixels = made[name]
        drawn = np.abs(pixels - np.median(pixels, axis=(0, 1))).sum(axis=2) > DRAWN
        height, width = drawn.shape
        halves = (drawn[: height // 2], drawn[height // 2 :], drawn[:, : width // 2], drawn[:, width // 2 :])
        assert min(int(half.sum()) for half in halves) > 0.02 * drawn.sum(), f"{name}: an empty half"
        if name in FEW:  # of more than 40 bodies, up to 5 % may be outside
            coloured = np.ptp(pixels, axis=2) > 40  # bodies and paths; floors, walls and letters are grey
            inner = coloured[2:-2, 2:-2]
            assert inner.sum() == coloured.sum(), f"{name}: a body leaves the picture"
    radii = []
    for colour in palette.BODIES[:5]:
        widths = largest_piece(hue_mask(made["cradle"], colour)).sum(axis=1)
        rows = np.arange(12)  # from the top of a ball, where no path crosses it
        chords = widths[np.flatnonzero(widths > 10)[0] + rows]
        # a chord at the depth h is c²/4 = 2 r h - h²: the slope of c²/4 + h² is 2 r, less twice the fraction of a row
        radii.append(float(np.polyfit(rows, chords**2 / 4 + rows**2, 1)[0]) / 2)
    assert min(radii) > 15
    assert max(radii) <= 1.05 * min(radii) + 1, "5 %, and a pixel of the depth"


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.needs("matplotlib", "mujoco", "trimesh")
def test_the_commands_of_the_other_pictures_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "render", lambda *_, **__: picture.Picture(0.0, ""))  # others measure such views
    done = set[str]()
    for entry in entries():
        if entry.name not in MEASURED:
            make(entry, tmp_path, done)
