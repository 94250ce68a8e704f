"""Delta debugging (Zeller & Hildebrandt, IEEE TSE 28, 183, 2002): the fewest items that still fail."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TypeVar

Item = TypeVar("Item")


def fewest(items: Sequence[Item], first: Callable[[list[list[Item]]], int | None]) -> list[Item]:
    """Return a part of the items that fails, and of which no item can be left out.

    Parameters
    ----------
    items
        They fail together.
    first
        Returns the number of the first of several parts that fails; items keep their order in each.
    """
    kept, parts = list(items), 2
    while len(kept) > 1:
        pieces = _split(kept, min(parts, len(kept)))
        found = first(pieces) if parts == 2 else None
        if found is not None:
            kept, parts = pieces[found], 2
            continue
        rests = [_without(pieces, k) for k in range(len(pieces))]
        found = first(rests)
        if found is not None:
            kept, parts = rests[found], max(2, len(pieces) - 1)
        elif len(pieces) == len(kept):
            break
        else:
            parts = 2 * parts
    return kept


def _split(items: list[Item], parts: int) -> list[list[Item]]:
    """Split items into parts of nearly equal lengths."""
    ends = [len(items) * k // parts for k in range(parts + 1)]
    return [items[lo:hi] for lo, hi in itertools.pairwise(ends)]


def _without(pieces: list[list[Item]], k: int) -> list[Item]:
    return [item for piece in pieces[:k] + pieces[k + 1 :] for item in piece]
