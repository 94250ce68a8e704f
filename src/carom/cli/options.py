"""Arguments and options that several commands share."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Annotated

import typer


def seconds(text: str) -> float:
    """Read a time. NaN is refused."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if isnan(value):
        raise typer.BadParameter(f"{text}: expected a time in seconds, such as 12.5")
    return value


def bundled(incomplete: str) -> list[str]:
    """Complete the name of a bundled scene; if none fits, the shell completes files."""
    from carom.scene.bundled import bundled_scenes, extreme_scenes

    return [name for name in (*bundled_scenes(), *extreme_scenes()) if name.startswith(incomplete)]


SceneArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENE", help="A scene file (.toml) or the name of a bundled scene.", autocompletion=bundled
    ),
]
RecordingArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A recording (.rrd).")]
ThreadsOption = Annotated[
    int | None,
    typer.Option(
        "--threads", metavar="N", help="Number of threads; results do not depend on it. Default: one per core.", min=1
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override one key of the scene. Repeatable."),
]
OutputOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FILE", help="File to write. Default: beside FILE, named after it."),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
LiveOption = Annotated[bool, typer.Option("--live", help="Show the run in a viewer window while it is recorded.")]
