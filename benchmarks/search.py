"""The search for contacts: carom's grids beside SciPy's k-d trees, in one run, by number of bodies and spread of radii.

python benchmarks/search.py
"""

from __future__ import annotations

import statistics
import time

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.search import Search, search_by

ROUNDS = 15
PACKING = 0.4
SPREADS = {"equal": 1.0, "1:3": 3.0, "1:100": 100.0}


def spheres(n: int, spread: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place spheres at random, radii by a power law of exponent -3.5, in a cube filled to ``PACKING``."""
    rng = np.random.default_rng(0)
    radius = (1.0 + rng.random(n) * (spread**-2.5 - 1.0)) ** (-1.0 / 2.5)
    side = np.cbrt(np.sum(4.0 / 3.0 * np.pi * radius**3) / PACKING)
    return rng.random((n, 3)) * side, radius


def median_milliseconds(searches: list[Search], position: NDArray[np.float64]) -> list[float]:
    """Time each search in turn, round after round."""
    times: list[list[float]] = [[] for _ in searches]
    for _ in range(ROUNDS):
        for index, search in enumerate(searches):
            began = time.perf_counter()
            search.pairs(position)
            times[index].append(time.perf_counter() - began)
    return [statistics.median(own) * 1e3 for own in times]


def main() -> None:
    print(f"{'bodies':>7} {'radii':>6} {'pairs':>7} {'grid, ms':>9} {'trees, ms':>10} {'ratio':>6}")
    for n in (10, 100, 1000, 10_000, 100_000):
        for name, spread in SPREADS.items():
            position, radius = spheres(n, spread)
            searches = [search_by(method, radius, np.zeros(3)) for method in ("grid", "k-d-tree")]
            found = len(searches[0].pairs(position))
            grid, trees = median_milliseconds(searches, position)
            print(f"{n:>7} {name:>6} {found:>7} {grid:>9.3f} {trees:>10.3f} {trees / grid:>6.1f}")


if __name__ == "__main__":
    main()
