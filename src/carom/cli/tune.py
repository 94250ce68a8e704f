"""`carom tune`: the cheapest settings of a scene that keep its errors within a limit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.options import SceneArgument, SetOption, ThreadsOption
from carom.cli.tradeoff import RepeatsOption, VaryOption, measured, table_of


def tune(
    scene: SceneArgument,
    error: Annotated[
        list[str],
        typer.Option(
            "--error", metavar="NAME=LIMIT", help="A limit, such as energy=1e-4 or position=1e-3; may be given again."
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Default: the scene's name and -tuned.toml.")
    ] = None,
    vary: VaryOption = None,
    repeats: RepeatsOption = 3,
    folder: Annotated[
        Path | None,
        typer.Option("--study", metavar="DIR", help="Where the measurements are; as for `carom tradeoff`."),
    ] = None,
    overrides: SetOption = None,
    threads: ThreadsOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE, or the study of another scene.")] = False,
) -> None:
    """Find the cheapest settings of a scene that keep every limit, measured, and write them as a scene file."""
    from rich.console import Console

    from carom.experiment.output import refuse_output
    from carom.experiment.tune import cheapest, limits, nearest, write

    asked = limits(error)
    path = output or Path(f"{Path(scene).stem}-tuned.toml")
    refuse_output(path, force)
    study, finished = measured(scene, vary, repeats, folder, overrides, threads, force, quiet=False)
    Console(highlight=False, width=None if Console().is_terminal else 200).print(table_of(study))
    if not finished:
        typer.echo("carom: stopped; what is measured is kept, and the same command goes on with it", err=True)
        raise typer.Exit(1)
    best = cheapest(study, asked)
    if best is None:
        typer.echo(f"carom: none of the settings keeps {', '.join(error)}: {nearest(study, asked)}", err=True)
        raise typer.Exit(1)
    write(study, best, asked, path)
    typer.echo(f"{best.setting.name}: {best.cost:.3g} s, written to {path}")
