"""`carom warmup`: compile every kernel ahead."""

from __future__ import annotations

import typer

from carom.cli.json_output import say_json
from carom.cli.options import JsonOption


def warmup(as_json: JsonOption = False) -> None:
    """Compile all kernels now, so that later runs start at once."""
    from dataclasses import asdict

    from carom.cli.compiling import NO_CACHE
    from carom.cli.units import duration_text
    from carom.runs.warmup import warm_up

    if not as_json:
        typer.echo("Compiling what is not in the cache …", err=True)
    warmth = warm_up()
    if as_json:
        say_json(asdict(warmth))
    else:
        where = f"cache: {warmth.cache}" if warmth.cache else NO_CACHE
        typer.echo(f"{warmth.compiled} kernels compiled in {duration_text(warmth.seconds)}; {where}")
