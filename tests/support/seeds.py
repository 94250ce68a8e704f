"""The seed of tests that draw what they try at random: the same in every run, unless CAROM_SEED says otherwise."""

from __future__ import annotations

import os
import secrets

VARIABLE = "CAROM_SEED"
USUAL = 1

_DRAWN = "CAROM_SEED_DRAWN"  # the processes of pytest-xdist inherit it


def is_random() -> bool:
    """Tell whether this run is to try what no earlier one has tried."""
    return os.environ.get(VARIABLE) == "random"


def chosen_seed() -> int:
    """Return the seed of this run: that of CAROM_SEED, or a new one if that is "random"."""
    if is_random():
        return int(os.environ.setdefault(_DRAWN, str(secrets.randbits(32))))
    return int(os.environ.get(VARIABLE) or USUAL)
