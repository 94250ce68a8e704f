"""`carom view` and `carom picture`: look at a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from time import sleep
from typing import Annotated

import typer

from carom.cli.options import RecordingArgument, seconds

AtOption = Annotated[float | None, typer.Option("--at", parser=seconds, metavar="T", help="Simulated time in seconds.")]


SMALLEST, LARGEST = 100, 8192  # pixels; textures of software renderers end at 8192


class PictureView(StrEnum):
    """What a picture shows."""

    BODIES = "bodies"
    GRAPH = "graph"
    ENERGY = "energy"
    ALL = "all"


class Theme(StrEnum):
    """The viewer's theme."""

    DARK = "dark"
    LIGHT = "light"


def view(
    file: RecordingArgument,
    at: AtOption = None,
    web: Annotated[bool, typer.Option("--web", help="Host it for a browser, on 127.0.0.1 only.")] = False,
    port: Annotated[
        int, typer.Option("--port", metavar="N", min=0, max=65535, help="With --web. Default: a free one.")
    ] = 0,
) -> None:
    """Open a recording in the Rerun viewer."""
    if web:
        _view_in_browser(file, at, port)
        return
    if port:
        raise typer.BadParameter("--port goes with --web")
    from carom.recording.view.viewer import open_viewer

    open_viewer(file, at)


def _view_in_browser(file: Path, at: float | None, port: int) -> None:
    """Host a recording until the interrupt key."""
    import contextlib
    import getpass
    import socket
    import webbrowser
    from urllib.parse import urlsplit

    from carom.cli.text import say
    from carom.recording.read.recording import Recording
    from carom.recording.view.viewer import has_screen
    from carom.recording.view.web.server import hosted

    recording = Recording.open(file)
    moment = None if at is None else recording.moment(at)
    with contextlib.suppress(KeyboardInterrupt), hosted(recording, moment, port) as link:
        say(link)
        if not has_screen():
            taken = urlsplit(link).port
            say("There is no display here. On the machine with the browser, run this and open the link there:")
            say(f"    ssh -N -L {taken}:127.0.0.1:{taken} {getpass.getuser()}@{socket.gethostname()}")
        elif not webbrowser.open(link):
            say("No browser was found; open the link in one.", err=True)
        say("Ctrl-C ends it.")
        while True:
            sleep(1.0)


def picture(
    file: RecordingArgument,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="PNG", help="Default: FILE with .png.")
    ] = None,
    at: AtOption = None,
    view: Annotated[PictureView, typer.Option("--view", help="What fills the picture.")] = PictureView.ALL,
    theme: Annotated[Theme, typer.Option("--theme", help="The viewer's; the light one needs Xvfb.")] = Theme.DARK,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Pixels.")] = "1600x1000",
) -> None:
    """Render a recording to a PNG, without a screen; by default at its most interesting moment."""
    from carom.recording.view.picture import render

    path = output or file.with_suffix(".png")
    render(file, at, path, _pixels(size), view=view.value, theme=theme.value)
    typer.echo(f"{path} written.")


def _pixels(size: str) -> tuple[int, int]:
    """Read WIDTHxHEIGHT."""
    from carom.recording.errors import RecordingError

    width, _, height = size.partition("x")
    if width.isascii() and width.isdigit() and height.isascii() and height.isdigit():
        pixels = int(width[:9]), int(height[:9])
        if all(SMALLEST <= side <= LARGEST for side in pixels):
            return pixels
    raise RecordingError(
        f"--size {size}: expected WIDTHxHEIGHT, each from {SMALLEST} to {LARGEST} pixels, such as 1600x1000"
    )
