"""The seed of tests that draw what they try at random: the same in every run, unless CAROM_SEED says otherwise."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable

import pytest

VARIABLE = "CAROM_SEED"
USUAL = 1

_DRAWN = "CAROM_SEED_DRAWN"  # the processes of pytest-xdist inherit it


ALL = "CAROM_EXAMPLES"  # "all": as many as a test names, as in the longer tests; otherwise a quarter of them


def examples(count: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Mark a test that draws with Hypothesis: how many examples the longer tests try; others try a quarter."""
    from hypothesis import settings

    everything = is_random() or os.environ.get(ALL) == "all"

    def mark(test: Callable[..., None]) -> Callable[..., None]:
        drawn: Callable[..., None] = pytest.mark.drawn(test)
        return settings(max_examples=count if everything else count // 4, deadline=None)(drawn)

    return mark


def is_random() -> bool:
    """Tell whether this run tries new random examples."""
    return os.environ.get(VARIABLE) == "random"


def chosen_seed() -> int:
    """Return the seed of this run: that of CAROM_SEED, or a new one if that is "random"."""
    if is_random():
        return int(os.environ.setdefault(_DRAWN, str(secrets.randbits(32))))
    return int(os.environ.get(VARIABLE) or USUAL)
