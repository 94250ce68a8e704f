"""Testing every pair beside k-d trees, by number of bodies: where `scene.requirements` switches.

python benchmarks/search.py
"""

from __future__ import annotations

import statistics
import time

import numpy as np

from carom.physics.contact.search import find_pairs

ROUNDS = 41


def median_microseconds(n: int, broad_phase: bool) -> float:
    rng = np.random.default_rng(0)
    position, radius = rng.random((n, 3)) * n ** (1 / 3), np.full(n, 0.45)
    times = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        find_pairs(position, radius, np.zeros(3), broad_phase)
        times.append(time.perf_counter() - began)
    return statistics.median(times) * 1e6


def main() -> None:
    print(f"{'N':>6} {'every pair':>12} {'k-d trees':>12}")
    for n in (8, 32, 64, 128, 256, 512, 1024):
        print(f"{n:>6} {median_microseconds(n, False):>10.0f}µs {median_microseconds(n, True):>10.0f}µs")


if __name__ == "__main__":
    main()
