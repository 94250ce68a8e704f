"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the most similar known name; empty if none is similar."""
    return next(iter(difflib.get_close_matches(name, known, n=1, cutoff=0.5)), "")


def suggestion(name: str, known: Iterable[str]) -> str:
    """Name the most similar known name, and list all."""
    known = list(known)
    near = nearest(name, known)
    there = f"here are {', '.join(known)}"
    return f'did you mean "{near}"? T{there}' if near else f"t{there}"
