"""Direct gravity beside REBOUND's basic gravity and a NumPy sum: one thread, the same bodies, in one run.

    python benchmarks/gravity.py [N ...]

Rounds are interleaved and medians are compared, so that another process or a hot processor slows all alike.
"""

from __future__ import annotations

import platform
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import rebound

from carom.experiment.environment import versions
from carom.physics.gravity.direct import DirectGravity

ROUNDS = 9


def carom_force(position: np.ndarray, mass: np.ndarray, potential: bool) -> Callable[[], object]:
    gravity = DirectGravity(mass, 1.0, 0.0, None, 1)
    acceleration = np.empty_like(position)
    return lambda: gravity.accelerate(position, acceleration, potential)


def rebound_force(position: np.ndarray, mass: np.ndarray) -> Callable[[], object]:
    """Return a leapfrog step of almost no length: one evaluation of the forces, and drifts that cost n."""
    simulation = rebound.Simulation()
    simulation.gravity = "basic"
    simulation.integrator = "leapfrog"
    simulation.dt = 1e-12
    for (x, y, z), m in zip(position, mass, strict=True):
        simulation.add(m=m, x=x, y=y, z=z)
    return lambda: simulation.steps(1)


def medians(contenders: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Return the median of the interleaved rounds in seconds."""
    spent: dict[str, list[float]] = {name: [] for name in contenders}
    for contender in contenders.values():
        contender()
    for _ in range(ROUNDS):
        for name, contender in contenders.items():
            began = time.perf_counter()
            contender()
            spent[name].append(time.perf_counter() - began)
    return {name: statistics.median(times) for name, times in spent.items()}


def main() -> None:
    sizes = [int(argument) for argument in sys.argv[1:]] or [1024, 4096, 16384]
    print(f"{platform.processor() or platform.machine()}, {versions()}, rebound {rebound.__version__}")
    print(f"{'N':>7} {'carom':>10} {'with potential':>15} {'REBOUND':>10} {'ratio':>7} {'pairs/s':>10}")
    for n in sizes:
        rng = np.random.default_rng(0)
        position, mass = rng.standard_normal((n, 3)), np.full(n, 1 / n)
        times = medians(
            {
                "carom": carom_force(position, mass, potential=False),
                "potential": carom_force(position, mass, potential=True),
                "rebound": rebound_force(position, mass),
            }
        )
        ratio, rate = times["rebound"] / times["carom"], n * n / times["carom"]
        print(
            f"{n:>7} {times['carom'] * 1e3:>8.2f}ms {times['potential'] * 1e3:>13.2f}ms "
            f"{times['rebound'] * 1e3:>8.2f}ms {ratio:>6.2f}x {rate:>10.3g}"
        )


if __name__ == "__main__":
    main()
