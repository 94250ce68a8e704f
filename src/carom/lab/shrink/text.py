"""The reduced scene as TOML, with comments that say what was asked, what is left, and how it was found."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

import tomlkit
from tomlkit.items import Array

from carom.lab.shrink.literal import BODIES, Document

WIDTH = 110  # characters of a comment


def commented(document: Document, comments: list[str]) -> str:
    """Write a scene with comments above it, one line for each body.

    Parameters
    ----------
    document
        The scene.
    comments
        Paragraphs.
    """
    written = tomlkit.document()
    for line in _wrapped(comments):
        written.add(tomlkit.comment(line))
    written.add(tomlkit.nl())
    for key in [key for key, value in document.items() if not isinstance(value, dict | list)]:
        written.add(key, document[key])
    for key in [BODIES, *(key for key, value in document.items() if isinstance(value, list) and key != BODIES)]:
        written.add(key, _rows(document[key]))
    for key, value in document.items():
        if isinstance(value, dict):
            written.add(key, _table(value))
    return tomlkit.dumps(written)


def _table(values: dict[str, Any]) -> tomlkit.items.Table:
    table = tomlkit.table()
    for key, value in values.items():
        table.add(key, value)
    return table


def _rows(tables: list[dict[str, Any]]) -> Array:
    """Write tables as one line each."""
    rows = tomlkit.array()
    for values in tables:
        row = tomlkit.inline_table()
        row.update(values)
        rows.append(row)
    return rows.multiline(True)


def _wrapped(paragraphs: list[str]) -> Iterator[str]:
    for paragraph in paragraphs:
        yield from textwrap.wrap(paragraph, WIDTH, break_long_words=False, break_on_hyphens=False)
