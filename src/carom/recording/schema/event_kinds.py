"""The kinds of events, also of those in recordings that were made before events had a kind."""

from __future__ import annotations

import re

CLOSING = frozenset({"extreme", "end"})  # written when a run ends: a resumed run writes its own

_BY_TEXT = (  # how their texts began, or read, before there were kinds
    (re.compile(r"^end: "), "end"),
    (re.compile(r" of the run[,:.]"), "extreme"),
    (re.compile(r"^Energy rose"), "energy-rise"),
)


def kind_of(recorded: str, text: str) -> str:
    """Return the kind of an event as recorded or, where none was recorded, as far as its text tells; "" if unknown."""
    return recorded or next((kind for pattern, kind in _BY_TEXT if pattern.search(text)), "")
