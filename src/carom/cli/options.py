"""Arguments and options that several commands share."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Annotated

import typer


def seconds(text: str) -> float:
    """Read a time; anything but NaN, of which no question has an answer."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if isnan(value):
        raise typer.BadParameter(f"{text}: expected a time in seconds, such as 12.5")
    return value


def bundled(incomplete: str) -> list[str]:
    """Complete the name of a bundled scene; where none fits, the shell completes files."""
    from carom.scene.bundled import bundled_scenes, extreme_scenes

    return [name for name in (*bundled_scenes(), *extreme_scenes()) if name.startswith(incomplete)]


SceneArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENE", help="A scene file (.toml), or the name of a bundled scene.", autocompletion=bundled
    ),
]
RecordingArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A recording (.rrd).")]
ThreadsOption = Annotated[
    int | None,
    typer.Option("--threads", metavar="N", help="Default: one a core. The bits are the same.", min=1),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the scene; may be given again."),
]
OutputOption = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="FILE", help="Default: beside FILE, named after it.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace a file that exists.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print as JSON.")]
LiveOption = Annotated[bool, typer.Option("--live", help="Show the run in a viewer while it is written.")]
