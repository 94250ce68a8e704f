"""Printing text that came from a file: a title may hold anything, and a terminal does what it is told."""

from __future__ import annotations

import re

import typer

# control characters but tab and line feed, what reverses the direction of writing, and halves of surrogate pairs
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def shown(text: str) -> str:
    """Write control characters as escapes, as JSON does."""
    return _UNSAFE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def say(text: str, *, err: bool = False) -> None:
    """Print a line, or a JSON document."""
    typer.echo(shown(text), err=err)
