"""`carom sweep`: many runs of one scene, and their table."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.errors import needing
from carom.scene.wording import command
from carom.terminal.answers import CommandAnswer, ShownColumn, ShownTable, Strong
from carom.terminal.console import LiveLine, bar
from carom.terminal.options import SetOption, bundled
from carom.terminal.printing import duration_text

if TYPE_CHECKING:
    from carom.lab.sweep.manifest import StoredSweep, SweepRun
    from carom.lab.sweep.sweep import SweepEnding
    from carom.lab.sweep.sweep_table import Row


class SweepProgress(LiveLine):
    """The numbers of completed and failed runs, the time left, and a permanent line for each failure."""

    def __init__(self, title: str, runs: int, quiet: bool = False) -> None:
        super().__init__(quiet)
        self._title, self._runs = title, runs
        self._found = self._ended = self._failed = 0
        self._first: float | None = None  # time at which the first run ended; this run had to wait for workers to start

    def begin(self, found: int) -> None:
        """Describe the task."""
        self._found = found
        self._restart()
        there = f", {found} already done" if found else ""
        self.say(f"{self._title}: {self._runs} runs{there}")

    def ended(self, run: SweepRun) -> None:
        """Count a run, and report a failed one."""
        self._ended += 1
        self._first = self._first or time.perf_counter()
        if not run.ok:
            self._failed += 1
            self.say(f"{run.name}: {run.outcome}: {' '.join(run.reason.split())}")

    def tick(self) -> None:
        """Show the progress of the sweep."""
        self._show(self._line)

    def _line(self, now: float) -> str:
        done = self._found + self._ended
        failed = f"  {self._failed} failed" if self._failed else ""
        # the first run waits for workers and kernels, so the time left is estimated from later runs
        spent, ended = (now - self._first, self._ended - 1) if self._first else (0.0, 0)
        left = f"{duration_text(now - self._began)} so far"
        if ended > 0 and spent > 0.0:
            left = f"{ended / spent:.2g} runs/s  {duration_text(spent / ended * (self._runs - done))} left"
        return f"{bar(done / max(1, self._runs))} {done} of {self._runs} runs{failed}  {left}"


SWEEPS = Path("recordings")
PlotOption = Annotated[
    tuple[str, str] | None,
    typer.Option(
        "--plot",
        metavar="x=KEY y=KEY",
        help="Plot column y against column x; the figure goes to the folder of the sweep.",
    ),
]


def sweep_command(
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
            help="Run each combination N times, with consecutive seeds from the seed of the scene.",
            min=1,
        ),
    ] = None,
    zipped: Annotated[
        bool | None,
        typer.Option(
            "--zip/--cross",
            help="Pair the values of all keys one by one, or combine every value with every other (default).",
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
    force: Annotated[
        bool, typer.Option("-f", "--force", help="Remove the sweep in the folder and start over.")
    ] = False,
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
            help='Show rows that satisfy a condition, such as "energy.final<0". Repeatable; rows must satisfy all.',
            rich_help_panel="Look",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            "--columns",
            metavar="KEY,KEY",
            help="Show these columns in addition to the varied keys.",
            rich_help_panel="Look",
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
    from carom.errors import ExperimentError

    if (scene is not None) + (table is not None) + (catalog is not None) != 1:
        raise ExperimentError("give one of SCENE, --table DIR and --catalog DIR; see carom sweep --help")
    if catalog is not None:
        serve(catalog)
        return
    if scene is None:
        assert table is not None
        figure = draw(table, plot, conditions or []) if plot is not None else None
        if figure is not None and not as_json:
            typer.echo(f"{figure} written.")
        else:
            _table(table, conditions or [], sort, columns).say(as_json)
        return

    from carom.lab.sweep.plan import plan
    from carom.lab.sweep.sweep import sweep as make
    from carom.runs.environment import command_line

    if plot is not None:
        # refuse an impossible figure before anything is computed
        _axes(plot)
        with needing("plot", "carom sweep --plot", "matplotlib"):
            import matplotlib  # noqa: F401
    if cluster is not None:
        with needing("cluster", "carom sweep --cluster", "distributed", "dask"):
            import carom.lab.sweep.cluster  # noqa: F401
    folder = output or SWEEPS / f"{Path(scene).stem}-sweep"
    planned = plan(scene, overrides or [], vary or [], seeds, zipped)
    with SweepProgress(planned.title, len(planned.points), as_json) as progress:
        ending = make(planned, folder, progress, address=cluster, workers=workers, force=force, command=command_line())
    _tell(ending, folder, None if plot is None else draw(folder, plot, conditions or []), as_json)
    if not ending.ok:
        raise typer.Exit(1)


def _tell(ending: SweepEnding, folder: Path, figure: Path | None, as_json: bool) -> None:
    """Describe how a sweep ended."""
    if ending.untabled:
        typer.echo(f"carom: {ending.untabled}", err=True)
    runs = ending.manifest.asked
    document = {
        "ok": ending.ok,
        "runs": len(runs),
        "found": ending.found,
        "failed": [run.name for run in ending.failed],
        "missed": [run.name for run in ending.missed],
        "left": ending.left,
        "stopped": ending.stopped,
        "units": ending.manifest.plan.units,
        "folder": str(ending.manifest.folder.root),
        "figure": str(figure) if figure else None,
        "entries": [asdict(run) for run in runs],
    }
    if ending.left and not as_json:
        why = f"{ending.stopped}: " if ending.stopped else ""
        typer.echo(f"carom: {why}{ending.left} runs remain; run the same command again to continue", err=True)
    CommandAnswer(document, _lines(ending, folder, figure)).say(as_json)


def _lines(ending: SweepEnding, folder: Path, figure: Path | None) -> Iterator[str]:
    runs = len(ending.manifest.asked)
    there = f", {ending.found} of them before" if ending.found else ""
    yield f"{runs - len(ending.failed) - ending.left} of {runs} runs done{there}; {folder / 'manifest.json'}"
    for what, count in (("failed", len(ending.failed)), ("missed a promise", len(ending.missed))):
        if count:
            yield f"{count} {what}"
    if figure is not None:
        yield f"{figure} written."
    yield f"next: {command('sweep', '--table', folder)}"


SHOWN = ("energy.final", "energy.max_error", "contacts.total", "contacts.max_overlap", "wall_time")


def _table(folder: Path, conditions: list[str], sort: str | None, columns: str | None) -> CommandAnswer:
    """Return the table of a sweep; the document has all columns, or only the chosen ones."""
    from carom.lab.sweep.sweep_table import chosen

    rows, stored = _rows(folder)
    keys = _keys(rows, stored, sort, columns or ",".join(key for key in SHOWN if key in rows[0]))
    found = chosen(rows, conditions, sort)
    kept = [{key: row[key] for key in keys} for row in found] if columns else found
    document = {"title": stored.title, "units": stored.units, "varied": stored.varied, "rows": kept}
    shown = ShownTable([_column(key, rows) for key in keys], found, keys=max(1, len(stored.varied)))
    counts = f"{len(found)} of {len(rows)} runs" if len(found) < len(rows) else f"{len(rows)} runs"
    units = f"; units of the results: {stored.units}, wall_time in s" if stored.units else ""
    files = f"recordings in {folder / 'runs'}, all columns in {folder / 'table.csv'}"
    return CommandAnswer(document, [stored.title, shown, f"{counts}{units}; {files}"])


def _column(key: str, rows: list[Row]) -> ShownColumn:
    """Return a column of the table, in which runs that are not done stand out."""

    def cell(row: Row) -> str | None:
        value = f"{row[key]:.6g}" if isinstance(row[key], float) else None if row[key] is None else str(row[key])
        return Strong(value) if value and row["status"] != "done" else value

    numeric = all(isinstance(row[key], (int, float)) for row in rows if row[key] is not None)
    return ShownColumn(key, cell, left=not numeric)


def _keys(rows: list[Row], stored: StoredSweep, sort: str | None, columns: str) -> list[str]:
    """Return the columns of a table: varied keys, requested columns, the sort key, and the outcome."""
    from carom.lab.sweep.sweep_table import known

    wanted = [known(key, rows) for key in columns.split(",") if key]
    sorted_by = [known(sort.removeprefix("-"), rows)] if sort else []
    return list(dict.fromkeys([*stored.varied, *wanted, *sorted_by, "outcome"]))


def draw(folder: Path, plot: tuple[str, str], conditions: list[str]) -> Path:
    """Draw a figure into the sweep's folder, and write a table of its points; return the path of the PNG."""
    from carom.lab.sweep.sweep_table import chosen, figure, known

    x, y = _axes(plot)
    rows, stored = _rows(folder)
    base, found = folder / f"{y}-over-{x}", chosen(rows, conditions, None)
    with needing("plot", "carom sweep --plot", "matplotlib"):
        return figure(found, known(x, rows), known(y, rows), stored.varied, stored.title, base)[0]


def serve(folder: Path) -> None:
    """Serve a sweep's recordings to the viewer until the user closes it or presses Ctrl-C.

    Rerun's server has no password. Before libraries start threads, this process and its viewer therefore move into a
    network namespace that other users of the machine cannot reach. Without a screen, the user's own viewers reach the
    table through a port of the machine.
    """
    from carom.display import keeper

    door = None if keeper.has_screen() else keeper.Door()
    wanted = not keeper.screen_is_remote() if door is None else door.knows_us()
    alone = wanted and keeper.isolate()
    from carom.lab.sweep.manifest import Folder, read

    with needing("catalog", "carom sweep --catalog", "datafusion", "pandas"):
        from carom.display.catalog import serve_catalog
    paths = [folder / run.file for run in read(Folder(folder)).runs if run.file.startswith("runs/")]
    serve_catalog(folder.resolve().name, paths, typer.echo, alone, door if alone else None)


def _rows(folder: Path) -> tuple[list[Row], StoredSweep]:
    """Return the rows of a sweep, and its manifest."""
    from carom.lab.sweep.manifest import Folder, read
    from carom.lab.sweep.sweep_table import rows_of

    stored = read(Folder(folder))
    return rows_of(stored.runs), stored


def _axes(plot: tuple[str, str]) -> tuple[str, str]:
    from carom.errors import ExperimentError

    given = dict(part.partition("=")[::2] for part in plot)
    if set(given) != {"x", "y"} or not all(given.values()):
        raise ExperimentError(f"--plot {' '.join(plot)}: expected x=KEY y=KEY, as x=contact.restitution y=energy.final")
    return given["x"], given["y"]
