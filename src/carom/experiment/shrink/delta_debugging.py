"""Delta debugging (Zeller & Hildebrandt, IEEE TSE 28, 183, 2002): the fewest items that still fail."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TypeVar

Item = TypeVar("Item")


def fewest(items: Sequence[Item], fails: Callable[[list[Item]], bool]) -> list[Item]:
    """Return a part of the items that fails, and of which no item can be left out.

    Parameters
    ----------
    items
        They fail together.
    fails
        Tells whether some of them, in their order, fail.
    """
    kept, parts = list(items), 2
    while len(kept) > 1:
        pieces = _split(kept, min(parts, len(kept)))
        smaller = next((piece for piece in pieces if fails(piece)), None) if parts == 2 else None
        if smaller is not None:
            kept, parts = smaller, 2
            continue
        rest = next((rest for k in range(len(pieces)) if fails(rest := _without(pieces, k))), None)
        if rest is not None:
            kept, parts = rest, max(2, len(pieces) - 1)
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
