"""Movies of recordings."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from PIL import Image

import carom as carom_package
from carom.display.movie import clock_of, frame_times
from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.schema import palette
from carom.recording.write.recorder import FrameRecorder
from carom.scene.load import Scene
from carom_command import carom
from needs import PICTURES
from picture_pixels import hue_mask, largest_piece
from scripted_run import ScriptedRun

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
from carom.display.movie_file import delays_of, require_encoder, write_movie  # noqa: E402 - it imports the encoder

pytestmark = pytest.mark.needs("imageio_ffmpeg")

SIZE = (64, 48)
COLOURS = [(200, 40, 40), (40, 200, 40), (40, 40, 200)]


def pngs(count: int) -> Iterator[bytes]:
    for number in range(count):
        file = io.BytesIO()
        Image.new("RGB", SIZE, COLOURS[number % 3]).save(file, "PNG")
        yield file.getvalue()


def frames_of(path: Path) -> NDArray[np.int64]:
    """Read a movie back, (frames, height, width, 3)."""
    if path.suffix == ".gif":
        with Image.open(path) as movie:
            return np.array([_frame(movie, number) for number in range(getattr(movie, "n_frames", 1))])
    frames = imageio_ffmpeg.read_frames(str(path))
    width, height = next(frames)["size"]
    return np.array([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in frames], dtype=np.int64)


def _frame(movie: Image.Image, number: int) -> NDArray[np.int64]:
    movie.seek(number)
    return np.asarray(movie.convert("RGB"), dtype=np.int64)


@pytest.mark.parametrize("name", ["movie.mp4", "movie.gif"])
def test_a_movie_has_each_picture_once_and_in_order(tmp_path: Path, name: str) -> None:
    write_movie(tmp_path / name, pngs(12), 12, SIZE, 10.0)
    frames = frames_of(tmp_path / name)
    assert frames.shape == (12, SIZE[1], SIZE[0], 3)
    for number, frame in enumerate(frames):
        assert np.abs(frame - COLOURS[number % 3]).max() < 12, "colours are rounded when they become YUV"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("fps", [7.0, 20.0, 24.0, 30.0])
def test_the_delays_of_a_gif_add_up_to_its_length(fps: float) -> None:
    delays = delays_of(60, fps)
    assert len(delays) == 60 and all(delay % 10 == 0 for delay in delays)
    assert abs(sum(delays) - 60_000 / fps) <= 5, "half of its unit of 10 ms"


@pytest.mark.parametrize("name", ["movie.mp4", "movie.gif"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), RecordingError("the viewer has ended")])
def test_a_movie_that_fails_leaves_no_torn_file_and_the_old_movie(
    tmp_path: Path, name: str, error: BaseException
) -> None:
    def torn() -> Iterator[bytes]:
        yield from pngs(3)
        raise error

    (tmp_path / name).write_bytes(b"the old movie")
    with pytest.raises(type(error)):
        write_movie(tmp_path / name, torn(), 6, SIZE, 10.0)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"the old movie"


def test_without_ffmpeg_one_sentence_names_the_remedies(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> str:
        raise RuntimeError("No ffmpeg exe could be found.")

    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", missing)
    with pytest.raises(RecordingError, match=r"apt-get install ffmpeg.*IMAGEIO_FFMPEG_EXE.*write a \.gif"):
        require_encoder(Path("movie.mp4"))
    require_encoder(Path("movie.gif"))


def test_without_the_extra_one_sentence_names_it(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.delitem(sys.modules, "carom.display.movie_file", raising=False)
    done = carom("movie", str(recorded), "-o", "movie.mp4", cwd=tmp_path)
    assert done.returncode == 2 and "pip install 'imageio-ffmpeg>=" in done.stderr and " 'pillow>=" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "movie.avi"], 'movie.avi: the format ".avi" is unknown; there are .mp4, .gif'),
        (["--size", "641x400"], "even numbers"),
        (["--size", "big"], "expected WIDTHxHEIGHT"),
        (["--seconds", "0"], "--seconds 0: expected more than 0"),
        (["--fps", "1000"], "--fps 1000: expected more than 0"),
        (["--bodies", "0,1"], "--bodies 0,1: selects the bodies of a close-up"),
        (["--view", "close-up", "--bodies", "0,77"], "77"),
        (["--from", "3", "--to", "2"], "from an earlier time to a later one"),
        (["--to", "99"], "99 s is outside"),
        (["-o", "taken.gif"], "taken.gif: exists; give --force"),
        (["-o", "no/folder.gif"], "there is no folder no"),
    ],
)
def test_a_mistake_is_one_sentence(recorded: Path, tmp_path: Path, arguments: list[str], said: str) -> None:
    (tmp_path / "taken.gif").touch()
    output = [] if "-o" in arguments else ["-o", "movie.mp4"]
    done = carom("movie", str(recorded), *output, *arguments, cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["taken.gif"]


def test_a_picture_shows_the_last_recorded_frame_before_its_time(recorded: Path) -> None:
    recording = Recording.open(recorded)  # frames 0.05 s apart
    assert np.allclose(frame_times(recording, 1.0, 1.2, 9), [1.0, 1.0, 1.05, 1.05, 1.1, 1.1, 1.15, 1.15, 1.2])


def test_a_movie_slows_down_around_impacts_and_its_clock_says_so(tmp_path: Path) -> None:
    """The wave of a rack takes a millisecond of a quarter of a second: one of 300 pictures, if they were even."""
    rack = carom_package.run(Scene.load("rack-break", ["time.duration=0.25"]), tmp_path / "rack.rrd")
    even, slowed = (frame_times(rack, None, None, 300, slowed=slowed) for slowed in (False, True))
    instants = np.unique(rack.impacts()["time"].to_numpy())
    wave = instants[:20]
    assert wave[-1] - wave[0] < 0.25 / 100, "twenty impacts within three pictures"
    assert np.sum((even >= wave[0]) & (even <= wave[-1])) <= 4
    assert set(wave.tolist()) <= set(slowed.tolist()), "each instant is shown"
    assert np.all(np.diff(slowed) >= 0.0) and (slowed[0], slowed[-1]) == (even[0], even[-1])
    assert len(np.unique(slowed)) >= 100, "the rest of the run is shown, too"
    clock = clock_of(rack, slowed)
    assert clock.texts[0].startswith("t = 0.0") and not any("slow" in text for text in clock_of(rack, even).texts)
    assert "slow motion 1 : " in clock.texts[int(np.searchsorted(clock.times, wave[10]))]
    assert len({text.partition(",")[0] for text in clock.texts}) == len(clock.texts), "no two moments read alike"


def test_a_movie_of_a_few_bounces_shows_the_whole_flight_as_well(tmp_path: Path) -> None:
    ball = carom_package.run(Scene.load("bouncing-ball", ["time.duration=1.3"]), tmp_path / "ball.rrd")  # two bounces
    times = frame_times(ball, None, None, 100, slowed=True)
    bounces = ball.impacts()["time"].to_numpy()
    assert set(bounces.tolist()) <= set(times.tolist())
    around = np.abs(times[:, None] - bounces).min(axis=1) < 0.02 * 1.3
    assert 0.1 <= around.mean() < 0.25, "a twentieth of the movie for each, and their even share"


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_the_command_makes_a_movie_in_which_the_bodies_move(tmp_path: Path) -> None:
    scripted = ScriptedRun(12)
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in scripted.frames(60):
            recorder.put(frame)
        recorder.finish("completed")
    asked = ["--seconds", "0.5", "--fps", "10", "--size", "480x300", "--to", "2"]
    done = carom("movie", "run.rrd", *asked, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert re.search(r"5 pictures, rendered in [\d.]+ s each", done.stdout)
    assert "from 0 to 2 s" in done.stderr
    frames = frames_of(tmp_path / "run.mp4")
    assert frames.shape == (5, 300, 480, 3)
    for frame in frames:
        coloured = np.ptp(frame, axis=2) > 40
        assert coloured.mean() > 0.05, "bodies in the colours of their groups"
        assert np.ptp(np.nonzero(coloured.any(axis=1))) > 100, "they fill a third of the height"
    for before, after in pairwise(frames):
        assert np.mean(np.abs(after - before).max(axis=2) > 40) > 0.02, "they move"


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_a_close_up_movie_keeps_its_two_bodies_in_the_middle(tmp_path: Path) -> None:
    assert carom("run", "rack-break", "--set", "time.duration=0.2", "-o", "rack.rrd", cwd=tmp_path).returncode == 0
    asked = ["--view", "close-up", "--event", "impact:5", "--seconds", "0.4", "--fps", "10", "--size", "480x360"]
    done = carom("movie", "rack.rrd", *asked, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for frame in frames_of(tmp_path / "rack.mp4"):
        bodies = [hue_mask(frame, palette.BODIES[k]) for k in (0, 4)]  # of balls 7 and 4: hues take turns
        for body in bodies:
            assert body.mean() > 0.03, "each fills more than a thirtieth of the picture"
        middle = np.mean([np.mean(np.nonzero(body), axis=1) for body in bodies], axis=0)
        assert np.all(np.abs(middle / (360, 480) - 0.5) < 0.25), "the camera follows both"


@pytest.mark.slow
@pytest.mark.parametrize(
    "number",
    [*(pytest.param(one, marks=pytest.mark.nightly) for one in (signal.SIGINT, signal.SIGTERM)), signal.SIGKILL],
)
@pytest.mark.needs(PICTURES)
def test_a_movie_that_is_ended_leaves_neither_viewer_nor_temporary_files(
    recorded: Path, tmp_path: Path, number: signal.Signals
) -> None:
    output, temporary = tmp_path / "output", tmp_path / "temporary"
    output.mkdir()
    temporary.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-m", "carom", "movie", str(recorded), "-o", "movie.mp4"],
        cwd=output,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(temporary)},
    )
    assert process.stderr is not None
    for line in process.stderr:  # the second line comes after 5 s, when pictures are taken
        if "picture " in line:
            break
    children = psutil.Process(process.pid).children(recursive=True)
    assert [child for child in children if child.name() == "rerun"]
    assert list(temporary.rglob("rerun-data-*"))
    process.send_signal(number)
    said = process.communicate(timeout=60)[1]
    assert not psutil.wait_procs(children, timeout=30)[1]
    assert not list(temporary.rglob("rerun-data-*"))
    if number == signal.SIGKILL:
        return
    assert process.returncode == (130 if number == signal.SIGINT else 143) and "Traceback" not in said
    assert not list(output.iterdir()) and not list(temporary.iterdir())


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_a_ball_bounces_in_a_movie_whose_camera_stands_still(tmp_path: Path) -> None:
    assert carom("run", "bouncing-ball", "-o", "ball.rrd", cwd=tmp_path).returncode == 0
    # a picture at the instant of an impact has its mark, which covers a part of the ball
    asked = ["--seconds", "0.4", "--fps", "10", "--size", "480x300", "--to", "1.2", "--even"]
    done = carom("movie", "ball.rrd", *asked, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    heights, sizes = [], []
    for frame in frames_of(tmp_path / "ball.mp4"):
        blue = largest_piece(frame[..., 2] - frame[..., 0] > 40)
        wide = np.flatnonzero(blue.sum(axis=1) > 15)  # rows of the ball; its trail has two or three pixels
        heights.append(float(np.mean(wide)))
        sizes.append(np.ptp(wide))
        grey = (np.ptp(frame, axis=2) < 30) & (frame.min(axis=2) > 90)
        assert grey.mean() > 0.01, "the floor"
    assert np.ptp(heights) > 100, "it crosses a third of the picture"
    assert np.ptp(sizes) <= 3, "two rows of pixels, and compression"
