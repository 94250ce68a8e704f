"""Printing text from files without its control characters, which a terminal would obey."""

from __future__ import annotations

import typer

from carom.scene.wording import escaped


def say(text: str, *, err: bool = False) -> None:
    """Print a line, or a JSON document."""
    typer.echo(escaped(text), err=err)
