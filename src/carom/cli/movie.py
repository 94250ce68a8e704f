"""`carom movie`: a recording as a video."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.cli.options import ForceOption, RecordingArgument, seconds, simulated_or_none
from carom.cli.printing import say
from carom.cli.view import BodiesOption, Theme, pixels_of

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording

LONGEST = 3600.0  # s, of a movie
FASTEST = 120.0  # pictures a second
GIF_FPS, MP4_FPS = 20.0, 30.0  # many viewers slow down faster GIFs


class Camera(StrEnum):
    """How a movie's camera moves."""

    STILL = "still"
    FOLLOW = "follow"
    ORBIT = "orbit"


class MovieView(StrEnum):
    """What a movie shows."""

    BODIES = "bodies"
    GRAPH = "graph"
    CLOSE_UP = "close-up"
    ENERGY = "energy"
    ALL = "all"


def movie(
    file: RecordingArgument,
    start: Annotated[
        float | None, typer.Option("--from", parser=seconds, metavar="T", help="Start at this simulated time.")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", parser=seconds, metavar="T", help="End at this simulated time.")
    ] = None,
    length: Annotated[
        float, typer.Option("--seconds", parser=seconds, metavar="S", help="Length of the movie in seconds.")
    ] = 10.0,
    fps: Annotated[
        float | None,
        typer.Option("--fps", parser=seconds, metavar="N", help="Frames per second. Default: 30, or 20 for a GIF."),
    ] = None,
    view: Annotated[MovieView, typer.Option("--view", help="View to render.")] = MovieView.BODIES,
    event: Annotated[
        str | None,
        typer.Option("--event", metavar="NAME", help="Event whose bodies a close-up follows, such as impact:3."),
    ] = None,
    bodies: BodiesOption = None,
    camera: Annotated[
        Camera | None,
        typer.Option(
            "--camera",
            help="Keep the camera still, follow the centre of the bodies, or orbit it once. Default: still with a "
            "plane, a wall or a field; otherwise follow bodies that move away.",
        ),
    ] = None,
    theme: Annotated[
        Theme,
        typer.Option(
            "--theme", help="Theme of the viewer. The light theme needs Xvfb, as do names in non-Latin scripts."
        ),
    ] = Theme.DARK,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Width and height in pixels.")] = "1280x720",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Movie to write, .mp4 or .gif. Default: FILE with .mp4."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Make a movie of a recording; needs no screen."""
    from carom.cli.printing import bytes_text
    from carom.cli.terminal import MovieProgress
    from carom.install import needing
    from carom.recording.layout.canvas import CameraMotion
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import claimed_output
    from carom.show.movie import frame_times, pictures

    path = output or file.with_suffix(".mp4")
    pixels, rate = pixels_of(size), fps if fps is not None else GIF_FPS if path.suffix == ".gif" else MP4_FPS
    _check(path, pixels, length, rate)
    _check_view(view, event, bodies, camera)
    with needing("movie", "carom movie", "imageio_ffmpeg", "PIL"):
        from carom.show.movie_file import require_encoder, write_movie

    recording = Recording.open(file)
    first, last = _ends(recording, *(simulated_or_none(time, recording.units) for time in (start, end)))
    times = frame_times(recording, first, last, max(2, round(length * rate)))
    with claimed_output(path, force):
        require_encoder(path)
        motion = None if camera is None else CameraMotion(camera.value)
        shots = pictures(
            recording, times, pixels, view.value, theme=theme.value, event=event, bodies=bodies, camera=motion
        )
        with MovieProgress(path, times, recording.units) as progress:
            write_movie(path, progress.watched(shots), len(times), pixels, rate)
        say(f"{path} written, {bytes_text(path.stat().st_size)}: {progress.summary()}.")


def _check(path: Path, size: tuple[int, int], length: float, fps: float) -> None:
    """Refuse recordings and options from which no movie can be made."""
    from carom.errors import RecordingError
    from carom.show.movie import FORMATS

    if path.suffix not in FORMATS:
        raise RecordingError(f"{path}: a movie is a {' or a '.join(FORMATS)}")
    if path.suffix == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise RecordingError(f"--size {size[0]}x{size[1]}: width and height of an .mp4 must be even numbers")
    if not 0.0 < length <= LONGEST:
        raise RecordingError(f"--seconds {length:g}: expected more than 0 and at most {LONGEST:g}")
    if not 0.0 < fps <= FASTEST:
        raise RecordingError(f"--fps {fps:g}: expected more than 0 and at most {FASTEST:g}")


def _check_view(view: MovieView, event: str | None, bodies: str | None, camera: Camera | None) -> None:
    """Refuse a choice of two bodies for other views than the close-up, and a choice of camera for the close-up."""
    from carom.errors import RecordingError

    for option, given in (("--event", event), ("--bodies", bodies)):
        if given is not None and view != MovieView.CLOSE_UP:
            raise RecordingError(f"{option} {given}: selects the bodies of a close-up; add --view close-up")
    if camera is not None and view in (MovieView.CLOSE_UP, MovieView.ENERGY):
        raise RecordingError(f"--camera {camera}: has no effect on --view {view}; remove one of the two options")


def _ends(recording: Recording, start: float | None, end: float | None) -> tuple[float, float]:
    """Return the times (s) of the first and the last picture."""
    from carom.errors import RecordingError

    times = recording.fingerprints()["time"].to_numpy()
    if len(times) < 2:
        raise RecordingError(
            f"{recording.path} has {len(times)} frames, too few for a movie; `carom picture` renders a single frame"
        )
    return float(times[0]) if start is None else start, float(times[-1]) if end is None else end
