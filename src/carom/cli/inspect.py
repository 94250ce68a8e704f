"""`carom inspect`: what is in a recording."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from carom.cli.options import RecordingArgument


def inspect(
    file: RecordingArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Say what is in a recording: outcome, energies, worst moments, versions."""
    import json

    from carom.recording.recording import Recording

    summary = Recording.open(file).summary()
    if as_json:
        typer.echo(json.dumps(summary, indent=2, ensure_ascii=False))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    for section, value in summary.items():
        _add_rows(table, section, value)
    Console(soft_wrap=True).print(table)


def _add_rows(table: Any, name: str, value: Any) -> None:
    """Show nested values as dotted names, one a row."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _add_rows(table, f"{name}.{key}", inner)
    elif isinstance(value, float):
        table.add_row(name, f"{value:.6g}")
    else:
        table.add_row(name, str(value))
