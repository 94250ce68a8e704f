"""Numbers of things, in words."""

from __future__ import annotations


def counted(count: int, noun: str) -> str:
    """Return a number with its noun in the singular or the plural, such as "1 body" and "2 bodies"."""
    plural = f"{noun[:-1]}ies" if noun.endswith("body") else f"{noun}{'es' if noun.endswith('s') else 's'}"
    return f"{count} {noun if count == 1 else plural}"
