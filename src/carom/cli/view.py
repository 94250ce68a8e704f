"""`carom view` and `carom picture`: look at a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.options import RecordingArgument, seconds

AtOption = Annotated[float | None, typer.Option("--at", parser=seconds, metavar="T", help="Simulated time in seconds.")]


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
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Pixels.")] = "1600x1000",
) -> None:
    """Render a recording to a PNG, without a screen; by default at its most interesting moment."""
    from carom.recording.errors import RecordingError
    from carom.recording.view.picture import render

    width, _, height = size.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) > 0 and int(height) > 0):
        raise RecordingError(f"--size {size}: expected WIDTHxHEIGHT in pixels, such as 1600x1000")
    path = output or file.with_suffix(".png")
    render(file, at, path, (int(width), int(height)))
    typer.echo(f"{path} written.")
