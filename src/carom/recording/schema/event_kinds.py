"""The kinds of events, including events of older recordings that have no kind."""

from __future__ import annotations

import re

CLOSING = frozenset({"extreme", "end"})  # written when a run ends: a resumed run writes its own

_BY_TEXT = (  # the texts, or their beginnings, of events in older recordings without kinds
    (re.compile(r"^end: "), "end"),
    (re.compile(r" of the run[,:.]"), "extreme"),
    (re.compile(r"^Energy rose"), "energy-rise"),
)


def kind_of(recorded: str, text: str) -> str:
    """Return the recorded kind of an event or, without one, the kind that its text implies; "" if unknown."""
    return recorded or next((kind for pattern, kind in _BY_TEXT if pattern.search(text)), "")
