"""`carom view` and `carom picture`: look at a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
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


def view(file: RecordingArgument, at: AtOption = None) -> None:
    """Open a recording in the Rerun viewer."""
    from carom.recording.view.viewer import open_viewer

    open_viewer(file, at)


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
