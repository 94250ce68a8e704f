"""Printing text from files without its control characters, which a terminal would obey."""

from __future__ import annotations

import re

import typer

# control characters except tab and line feed, marks that reverse the direction of writing, and lone surrogates
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def shown(text: str) -> str:
    """Write control characters as escapes, as JSON does."""
    return _UNSAFE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def say(text: str, *, err: bool = False) -> None:
    """Print a line, or a JSON document."""
    typer.echo(shown(text), err=err)
