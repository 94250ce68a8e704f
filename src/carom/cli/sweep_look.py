"""Looking at a sweep: its table, a figure, and Rerun's catalogue."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from carom.cli.extras import needing
from carom.cli.json_output import say_json

if TYPE_CHECKING:
    from carom.lab.sweep.table import Row

PIPE_WIDTH = 160  # characters of the table where the output is not a terminal
SHOWN = ("energy.final", "energy.max_error", "contacts.total", "contacts.max_overlap", "wall_time")


def show(folder: Path, conditions: list[str], sort: str | None, columns: str | None) -> None:
    """Print the table of a sweep."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from carom.cli.terminal import Terminal
    from carom.lab.sweep.table import chosen

    rows, stored = _rows(folder)
    keys = _keys(rows, stored, sort, columns or ",".join(key for key in SHOWN if key in rows[0]))
    found = chosen(rows, conditions, sort)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for key in keys:
        table.add_column(key, justify="right" if _is_numeric(rows, key) else "left", overflow="fold")
    for row in found:
        table.add_row(*(escape(_cell(row, key)) for key in keys), style=None if row["status"] == "done" else "red")
    console = Terminal(markup=True)
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    console.print(escape(stored["title"]))
    console.print(table)
    counts = f"{len(found)} of {len(rows)} runs" if len(found) < len(rows) else f"{len(rows)} runs"
    console.print(f"{counts}; recordings in {folder / 'runs'}, all columns in {folder / 'table.csv'}", soft_wrap=True)


def print_json(folder: Path, conditions: list[str], sort: str | None, columns: str | None) -> None:
    """Print the rows of a sweep, with all columns or with those that the table would have."""
    from carom.lab.sweep.table import chosen

    rows, stored = _rows(folder)
    found = chosen(rows, conditions, sort)
    if columns:
        keys = _keys(rows, stored, sort, columns)
        found = [{key: row[key] for key in keys} for row in found]
    say_json({"title": stored["title"], "units": stored.get("units"), "varied": stored["varied"], "rows": found})


def _keys(rows: list[Row], stored: dict[str, Any], sort: str | None, columns: str) -> list[str]:
    """Return the columns of a table: what varies, those asked for, what it is sorted by, and the outcome."""
    from carom.lab.sweep.table import known

    wanted = [known(key, rows) for key in columns.split(",") if key]
    sorted_by = [known(sort.removeprefix("-"), rows)] if sort else []
    return list(dict.fromkeys([*stored["varied"], *wanted, *sorted_by, "outcome"]))


def refuse_plot(plot: tuple[str, str]) -> None:
    """Refuse a figure that cannot be drawn, before anything is computed for it."""
    _axes(plot)
    with needing("plot", "carom sweep --plot", "matplotlib"):
        import matplotlib  # noqa: F401


def draw(folder: Path, plot: tuple[str, str], conditions: list[str]) -> Path:
    """Draw a figure into the sweep's folder; return its path."""
    from carom.lab.sweep.table import chosen, known

    x, y = _axes(plot)
    with needing("plot", "carom sweep --plot", "matplotlib"):
        from carom.lab.sweep.figure import figure
    rows, stored = _rows(folder)
    path = folder / f"{y}-over-{x}.png"
    figure(chosen(rows, conditions, None), known(x, rows), known(y, rows), stored["varied"], stored["title"], path)
    return path


def serve(folder: Path) -> None:
    """Serve a sweep's recordings to the viewer until the person closes it or interrupts.

    Rerun's server has no password. So this process moves, with its viewer, where other users of the machine cannot
    connect, before it loads libraries that start threads. Without a screen, the server is there for viewers elsewhere.
    """
    from carom.show.keeper import has_screen, isolate, screen_is_remote

    alone = has_screen() and not screen_is_remote() and isolate()
    from carom.lab.sweep.folder import Folder
    from carom.lab.sweep.manifest import stored_runs

    with needing("catalog", "carom sweep --catalog", "datafusion", "pandas"):
        from carom.show.catalog import serve_catalog
    paths = [folder / run.file for run in stored_runs(Folder(folder)) if run.file.startswith("runs/")]
    serve_catalog(folder.resolve().name, paths, typer.echo, alone)


def _rows(folder: Path) -> tuple[list[Row], dict[str, Any]]:
    """Return the rows of a sweep, and its manifest."""
    from carom.lab.sweep.folder import Folder
    from carom.lab.sweep.manifest import read, stored_runs
    from carom.lab.sweep.table import rows_of

    return rows_of(stored_runs(Folder(folder))), read(Folder(folder))


def _axes(plot: tuple[str, str]) -> tuple[str, str]:
    from carom.errors import ExperimentError

    given = dict(part.partition("=")[::2] for part in plot)
    if set(given) != {"x", "y"} or not all(given.values()):
        raise ExperimentError(f"--plot {' '.join(plot)}: expected x=KEY y=KEY, as x=contact.restitution y=energy.final")
    return given["x"], given["y"]


def _is_numeric(rows: list[Row], key: str) -> bool:
    return all(isinstance(row[key], (int, float)) for row in rows if row[key] is not None)


def _cell(row: Row, key: str) -> str:
    value: Any = row[key]
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
