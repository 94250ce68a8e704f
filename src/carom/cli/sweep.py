"""`carom sweep`: many runs of one scene, and a look at them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.cli.json_output import say_json
from carom.cli.options import SetOption, bundled
from carom.scene.wording import command

if TYPE_CHECKING:
    from carom.lab.sweep.sweep import Ending

SWEEPS = Path("recordings")
PlotOption = Annotated[
    tuple[str, str] | None,
    typer.Option(
        "--plot",
        metavar="x=KEY y=KEY",
        help="Plot column y against column x; the figure goes to the folder of the sweep.",
    ),
]


def sweep(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE", help="A scene file (.toml), or the name of a bundled scene.", autocompletion=bundled
        ),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=VALUES",
            help="Values: a list a,b,c; first:last:count, evenly spaced; or first:last:count followed by log, in equal "
            "ratios, such as 1e-3:1:4log. Repeatable. Default: \\[sweep] of the scene.",
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds",
            metavar="N",
            help="Run each combination N times, with seeds counting up from that of the scene.",
            min=1,
        ),
    ] = None,
    zipped: Annotated[
        bool | None,
        typer.Option(
            "--zip/--cross", help="Vary all keys together, value by value, or combine each with each (default)."
        ),
    ] = None,
    overrides: SetOption = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder to write. Default: recordings/SCENE-sweep."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", metavar="N", help="Number of processes on this machine. Default: one per core.", min=1
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option("--cluster", metavar="ADDRESS", help="Run on this Dask scheduler, such as tcp://host:8786."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Remove the sweep in the folder and start over.")] = False,
    table: Annotated[
        Path | None,
        typer.Option("--table", metavar="DIR", help="Print the table of a sweep; run nothing.", rich_help_panel="Look"),
    ] = None,
    sort: Annotated[
        str | None,
        typer.Option(
            "--sort",
            metavar="KEY",
            help="Sort the table by this column; -KEY for descending order.",
            rich_help_panel="Look",
        ),
    ] = None,
    conditions: Annotated[
        list[str] | None,
        typer.Option(
            "--filter",
            metavar="CONDITION",
            help='Show rows that meet this, such as "energy.final<0". Repeatable; all must hold.',
            rich_help_panel="Look",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            "--columns", metavar="KEY,KEY", help="Show these columns besides what varies.", rich_help_panel="Look"
        ),
    ] = None,
    plot: PlotOption = None,
    catalog: Annotated[
        Path | None,
        typer.Option(
            "--catalog",
            metavar="DIR",
            help="Show the recordings of a sweep as a table in the Rerun viewer.",
            rich_help_panel="Look",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Run a scene many times with different values and seeds, here or on a Dask cluster; continue where it stopped."""
    from carom.cli import sweep_look as look
    from carom.errors import ExperimentError

    if (scene is not None) + (table is not None) + (catalog is not None) != 1:
        raise ExperimentError("give one of SCENE, --table DIR and --catalog DIR; see carom sweep --help")
    if catalog is not None:
        look.serve(catalog)
        return
    folder = table
    ending = None
    if scene is not None:
        if plot is not None:
            look.refuse_plot(plot)
        folder = output or SWEEPS / f"{Path(scene).stem}-sweep"
        ending = _run(scene, folder, vary or [], overrides or [], seeds, zipped, workers, cluster, force, as_json)
    assert folder is not None
    figure = look.draw(folder, plot, conditions or []) if plot is not None else None
    if ending is not None:
        _tell(ending, folder, figure, as_json)
        if not ending.ok:
            raise typer.Exit(1)
    elif as_json:
        look.print_json(folder, conditions or [], sort, columns)
    elif figure is not None:
        typer.echo(f"{figure} written.")
    else:
        look.show(folder, conditions or [], sort, columns)


def _run(
    scene: str,
    folder: Path,
    vary: list[str],
    overrides: list[str],
    seeds: int | None,
    zipped: bool | None,
    workers: int | None,
    cluster: str | None,
    force: bool,
    quiet: bool,
) -> Ending:
    from carom.cli.extras import needing
    from carom.cli.sweep_progress import SweepProgress
    from carom.lab.sweep.plan import plan
    from carom.lab.sweep.sweep import sweep as make
    from carom.runs.environment import command_line

    if cluster is not None:
        with needing("cluster", "carom sweep --cluster", "distributed", "dask"):
            import carom.lab.sweep.cluster  # noqa: F401
    planned = plan(scene, overrides, vary, seeds, zipped)
    with SweepProgress(planned.title, len(planned.points), quiet) as progress:
        return make(planned, folder, progress, address=cluster, workers=workers, force=force, command=command_line())


def _tell(ending: Ending, folder: Path, figure: Path | None, as_json: bool) -> None:
    """Say how a sweep ended."""
    if ending.untabled:
        typer.echo(f"carom: {ending.untabled}", err=True)
    if as_json:
        say_json(_document(ending, figure))
        return
    runs = ending.manifest.asked
    done = len(runs) - len(ending.failed) - ending.left
    there = f", {ending.found} of them before" if ending.found else ""
    typer.echo(f"{done} of {len(runs)} runs done{there}; {folder / 'manifest.json'}")
    for what, count in (("failed", len(ending.failed)), ("missed a promise", len(ending.missed))):
        if count:
            typer.echo(f"{count} {what}")
    if figure is not None:
        typer.echo(f"{figure} written.")
    if ending.left:
        why = f"{ending.stopped}: " if ending.stopped else ""
        typer.echo(f"carom: {why}{ending.left} runs are left; run the same command again to continue", err=True)
    typer.echo(f"next: {command('sweep', '--table', folder)}")


def _document(ending: Ending, figure: Path | None) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "ok": ending.ok,
        "runs": len(ending.manifest.asked),
        "found": ending.found,
        "failed": [run.name for run in ending.failed],
        "missed": [run.name for run in ending.missed],
        "left": ending.left,
        "stopped": ending.stopped,
        "units": ending.manifest.plan.units,
        "folder": str(ending.manifest.folder.root),
        "figure": str(figure) if figure else None,
        "entries": [asdict(run) for run in ending.manifest.asked],
    }
