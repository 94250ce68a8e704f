"""Seeds of tests that try something else each time."""

from __future__ import annotations

import os
import secrets


def fresh_seed() -> int:
    """Return a new seed, or that of ``CAROM_SEED``, and print it: pytest shows it where the test fails."""
    seed = int(os.environ.get("CAROM_SEED") or secrets.randbits(32))
    print(f"CAROM_SEED={seed} repeats this")  # noqa: T201
    return seed
