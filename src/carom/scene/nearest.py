"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def suggestion(name: str, known: Iterable[str]) -> str:
    """Name the most similar known name, and list all."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    there = f"here are {', '.join(known)}"
    return f'did you mean "{near[0]}"? T{there}' if near else f"t{there}"
