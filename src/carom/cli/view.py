"""Commands that show a recording: `carom view`, `picture`, `movie` and `publish`."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from time import sleep
from typing import TYPE_CHECKING, Annotated

import typer

from carom.scene.units.dimension import TIME
from carom.scene.wording import counted
from carom.terminal.given_moment import AtOption, EventOption, GivenMoment, StepOption, typed_time_or_none
from carom.terminal.options import (
    ForceOption,
    JsonOption,
    OptionalTime,
    RecordingArgument,
    RecordingsArgument,
    output_option,
    seconds,
    time_option,
)
from carom.terminal.printing import bytes_text, duration_text, note, say, say_json

if TYPE_CHECKING:
    from carom.display.request import Request

_BODIES = "Bodies to show close up, by number or name: two, or one on a plane or wall."
_PLOT = "Plot bodies over time, such as top.z,3.speed: x y z, vx vy vz speed, wx wy wz omega."
_COLOUR = "Quantity shown by the colours of the bodies. Default: record.colour_by of the scene."
_EDGES = "Quantity shown by the colours of the contacts beside the bodies: their impulse, or the solver's stage."
_ARROWS = "Arrows of rotation at bodies: one, with both numbers, or both: torque and angular acceleration."
_THEME = "Theme of the viewer. The light theme needs Xvfb, as do names in non-Latin scripts."
_WEB = "Show the recording in a browser; the server listens on 127.0.0.1 only."
_PORT = "Port for --web. Default: any free one."
_CAMERA = (
    "Keep the camera still, follow the centre of the bodies, or orbit it once. Default: still with a plane, a wall or "
    "a field; otherwise follow bodies that move away."
)
_SLOW = "Slow down around the hardest impacts, or show the whole movie at one pace."
_PICTURE = "Picture to write. Default: FILE.png, or FILE-picture.png if another command wrote FILE.png."
_PAGE = "Folder to write. Default: FILE-page, beside FILE; of several recordings, recordings-page."
SMALLEST, LARGEST = 100, 8192  # pixels; software renderers support textures up to 8192
ColourBy = StrEnum("ColourBy", ["GROUP", "MATERIAL", "SPEED", "GRAPH", "ISLAND"])
Edges = StrEnum("Edges", ["IMPULSE", "STAGE"])
Arrows = StrEnum("Arrows", ["ONE", "BOTH"])
Theme = StrEnum("Theme", ["DARK", "LIGHT"])
Camera = StrEnum("Camera", ["STILL", "FOLLOW", "ORBIT"])  # the camera's motion in a movie
MovieView = StrEnum(
    "MovieView", {"BODIES": "bodies", "GRAPH": "graph", "CLOSE_UP": "close-up", "ENERGY": "energy", "ALL": "all"}
)
PictureView = StrEnum(
    "PictureView",
    {"BODIES": "bodies", "GRAPH": "graph", "CLOSE_UP": "close-up", "ENERGY": "energy", "PLOT": "plot", "ALL": "all"},
)

BodiesOption = Annotated[str | None, typer.Option("--bodies", metavar="A,B", help=_BODIES)]
PlotOption = Annotated[str | None, typer.Option("--plot", metavar="BODY.QUANTITY,…", help=_PLOT)]
ColourOption = Annotated[ColourBy | None, typer.Option("--colour-by", "--color-by", help=_COLOUR)]
EdgesOption = Annotated[Edges, typer.Option("--edges", help=_EDGES)]
ArrowsOption = Annotated[Arrows, typer.Option("--arrows", help=_ARROWS)]
ThemeOption = Annotated[Theme, typer.Option("--theme", help=_THEME)]
SizeOption = Annotated[str, typer.Option("--size", metavar="WxH", help="Width and height in pixels.")]


def view(
    file: RecordingArgument,
    at: AtOption = None,
    step: StepOption = None,
    event: EventOption = None,
    bodies: BodiesOption = None,
    plot: PlotOption = None,
    colour_by: ColourOption = None,
    edges: EdgesOption = Edges.IMPULSE,
    arrows: ArrowsOption = Arrows.ONE,
    web: Annotated[bool, typer.Option("--web", help=_WEB)] = False,
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help=_PORT, show_default=False)] = 0,
) -> None:
    """Open a recording in the Rerun viewer, paused at a moment.

    FILE may be the zip that `carom report` made.
    """
    if port and not web:
        raise typer.BadParameter("--port needs --web")
    given = GivenMoment(at, step, event)
    from carom.display.request import Request
    from carom.display.viewer import open_window
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import replaying

    with opened(file) as path:
        recording = Recording.open(path)
        with replaying(recording) as watch:
            moment = given.time(recording, watch)
            request = Request(moment, event, bodies, plot, colour_by, edges.value, arrows.value)
        announce_compilation()
        _announce_replay(path, plot)
        if web:
            _view_in_browser(path, request, port)
        else:
            open_window(path, request, say=_say_missing)


def _view_in_browser(file: Path, request: Request, port: int) -> None:
    """Host a recording until the interrupt key is pressed."""
    import contextlib
    import getpass
    import socket
    import webbrowser
    from urllib.parse import urlsplit

    from carom.display.keeper import has_screen
    from carom.display.presentation import asked
    from carom.display.web import hosted
    from carom.recording.read.recording import Recording

    recording = Recording.open(file)
    if recording.is_overlay:
        moment, supplement = recording.moment(request.at), None
    else:
        shown = asked(recording, request, dense=True)
        moment, supplement = shown.time, shown.supplement
        _say_missing(shown.missing)
    with contextlib.suppress(KeyboardInterrupt), hosted(recording, moment, supplement, port) as page:
        say(page.link)
        if not has_screen():
            taken = urlsplit(page.link).port
            say("This machine has no display. On the machine with the browser, run this command and open the link:")
            say(f"    ssh -N -L {taken}:127.0.0.1:{taken} {getpass.getuser()}@{socket.gethostname()}")
        elif not webbrowser.open(page.command_line):
            say("No browser was found; open the link in a browser.", err=True)
        say("Ctrl-C ends it.")
        while True:
            sleep(1.0)


def picture(
    file: RecordingArgument,
    output: Annotated[Path | None, output_option("PNG", _PICTURE)] = None,
    at: AtOption = None,
    step: StepOption = None,
    event: EventOption = None,
    bodies: BodiesOption = None,
    plot: PlotOption = None,
    colour_by: ColourOption = None,
    edges: EdgesOption = Edges.IMPULSE,
    arrows: ArrowsOption = Arrows.ONE,
    view: Annotated[PictureView, typer.Option("--view", help="View to render.")] = PictureView.ALL,
    theme: ThemeOption = Theme.DARK,
    size: SizeOption = "1600x1000",
    force: Annotated[
        bool, typer.Option("-f", "--force", help="Replace a file that `carom picture` did not write.")
    ] = False,
) -> None:
    """Render a moment of a recording to a PNG; needs no screen.

    FILE may be the zip that `carom report` made. Earlier pictures are replaced.
    """
    from carom.display.picture import is_picture_of_carom, render
    from carom.display.request import Request
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_output
    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import LiveLine, Patience, replaying

    given = GivenMoment(at, step, event)
    pixels, out = pixels_of(size), output or file.with_suffix(".png")
    if output is None and out.exists() and not is_picture_of_carom(out):
        out = out.with_name(f"{file.stem}-picture.png")
    refuse_output(out, force or is_picture_of_carom(out))
    with opened(file) as path:
        recording = Recording.open(path)
        with replaying(recording) as watch:
            moment = given.time(recording, watch)
            request = Request(moment, event, bodies, plot, colour_by, edges.value, arrows.value)
        announce_compilation()
        _announce_replay(path, plot, alone=view is PictureView.PLOT)
        with Patience("Rendering the picture", LiveLine()):
            made = render(path, request, out, pixels, view=view.value, theme=theme.value)
        when = recording.units.text(made.time, TIME, ".9g")
    typer.echo(f"{out} written, t = {when}.")
    _say_missing(made.missing)


def _announce_replay(file: Path, plot: str | None, *, alone: bool = False) -> None:
    """Announce that a plot of velocities takes as long to compute as the run did."""
    from carom.display.supplement import asked_quantities, needs_replay
    from carom.recording.read.recording import Recording

    if plot is None:
        return
    recording = Recording.open(file)
    recording.refuse_overlay()
    if needs_replay(asked_quantities(recording, plot, one_unit=alone)):
        took = recording.closing.get("wall_time")
        known = f", which took {duration_text(float(took))}" if took else ""
        note(f"Velocities and spins are not recorded at every frame: rerunning the scene{known} …")


def _say_missing(reason: str) -> None:
    if reason:
        typer.echo(
            f"This shows the last frame before that moment, because its step could not be recomputed: {reason}",
            err=True,
        )


def pixels_of(size: str) -> tuple[int, int]:
    """Parse WIDTHxHEIGHT."""
    from carom.errors import RecordingError

    if match := re.fullmatch(r"([0-9]+)x([0-9]+)", size):
        pixels = int(match[1][:9]), int(match[2][:9])
        if all(SMALLEST <= side <= LARGEST for side in pixels):
            return pixels
    raise RecordingError(
        f"--size {size}: expected WIDTHxHEIGHT, each from {SMALLEST} to {LARGEST} pixels, such as 1600x1000"
    )


def publish(
    files: RecordingsArgument,
    output: Annotated[Path | None, output_option("DIR", _PAGE)] = None,
    force: Annotated[bool, typer.Option("-f", "--force", help="Replace a folder that carom published before.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a web page with pictures, the viewer and the recording to a folder that any static host can serve.

    Several recordings get a page each, and an index with a card for each. FILE may be the zip that `carom report` made.
    """
    import shlex
    from contextlib import ExitStack
    from dataclasses import asdict

    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.sharing.publish import publish as make
    from carom.sharing.publish import refuse_folder
    from carom.terminal.compilation import announce_compilation

    one = files[0]
    folder = output or one.with_name(f"{one.stem}-page" if len(files) == 1 else "recordings-page")
    with ExitStack() as stack:
        recordings = [Recording.open(stack.enter_context(opened(file))) for file in files]
        for recording in recordings:
            recording.refuse_overlay()
        refuse_folder(folder, force)
        announce_compilation()
        made = make(recordings, folder, lambda what: note(f"Writing {what} …"))
    if as_json:
        say_json({**asdict(made), "path": str(folder)})
        return
    pages = f"{counted(len(files), 'page')}, " if len(files) > 1 else ""
    say(f"{folder} written, {bytes_text(made.size)}: {pages}{counted(made.moments, 'moment')}.")
    if made.picture:
        say(f"Without pictures: {made.picture}", err=True)
    say("Upload it to any web host. To view it locally, run this command and open http://127.0.0.1:8000:")
    say(f"    python3 -m http.server --bind 127.0.0.1 -d {shlex.quote(str(folder))}")


LONGEST = 3600.0  # s, longest movie
FASTEST = 120.0  # largest number of pictures per second
GIF_FPS, MP4_FPS = 20.0, 30.0  # many viewers play GIFs with more frames per second too slowly


def movie(
    file: RecordingArgument,
    start: Annotated[OptionalTime, time_option("--from", "Start at this simulated time.")] = None,
    end: Annotated[OptionalTime, time_option("--to", "End at this simulated time.")] = None,
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
    camera: Annotated[Camera | None, typer.Option("--camera", help=_CAMERA)] = None,
    slow: Annotated[bool, typer.Option("--slow/--even", help=_SLOW)] = True,
    theme: ThemeOption = Theme.DARK,
    size: SizeOption = "960x540",
    output: Annotated[
        Path | None, output_option("FILE", "Movie to write, .mp4 or .gif. Default: FILE with .mp4.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Make a movie of a recording; needs no screen."""
    from carom.display.movie import FORMATS, frame_times, pictures
    from carom.errors import RecordingError, needing
    from carom.recording.export import refuse_format
    from carom.recording.layout.canvas import CameraMotion
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import claimed_output
    from carom.terminal.console import MovieProgress

    path = output or file.with_suffix(".mp4")
    pixels, rate = pixels_of(size), fps if fps is not None else GIF_FPS if path.suffix == ".gif" else MP4_FPS
    refuse_format(path, FORMATS)
    if path.suffix == ".mp4" and (pixels[0] % 2 or pixels[1] % 2):
        raise RecordingError(f"--size {pixels[0]}x{pixels[1]}: width and height of an .mp4 must be even numbers")
    if not 0.0 < length <= LONGEST:
        raise RecordingError(f"--seconds {length:g}: expected more than 0 and at most {LONGEST:g}")
    if not 0.0 < rate <= FASTEST:
        raise RecordingError(f"--fps {rate:g}: expected more than 0 and at most {FASTEST:g}")
    for option, given in (("--event", event), ("--bodies", bodies)):
        if given is not None and view != MovieView.CLOSE_UP:
            raise RecordingError(f"{option} {given}: selects the bodies of a close-up; add --view close-up")
    if camera is not None and view in (MovieView.CLOSE_UP, MovieView.ENERGY):
        raise RecordingError(f"--camera {camera}: has no effect on --view {view}; remove one of the two options")
    with needing("movie", "carom movie", "imageio_ffmpeg", "PIL"):
        from carom.display.movie_file import require_encoder, write_movie

    recording = Recording.open(file)
    first, last = (typed_time_or_none(recording, time) for time in (start, end))
    times = frame_times(recording, first, last, max(2, round(length * rate)), slowed=slow)
    with claimed_output(path, force):
        require_encoder(path)
        motion = None if camera is None else CameraMotion(camera.value)
        shots = pictures(
            recording, times, pixels, view.value, theme=theme.value, event=event, bodies=bodies, camera=motion
        )
        with MovieProgress(path, times, recording.units, len(recording.shown)) as progress:
            write_movie(path, progress.watched(shots), len(times), pixels, rate)
        say(f"{path} written, {bytes_text(path.stat().st_size)}: {progress.summary()}.")
