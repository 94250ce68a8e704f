"""Where a fourth-order integrator is worth its three sums of forces a step: clusters of few bodies that cannot touch.

python benchmarks/integrators.py                        prints the table of docs/trade.md

Yoshida's method with multiples of leapfrog's step is compared with leapfrog. Errors are those of the positions,
relative to the exact motion; the cost is the number of force sums. Both are medians of the ratios over clusters.
Nothing is timed, so the table is the same on any machine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.lab.compared_run import Trajectory, follow, sample_times
from carom.lab.tradeoff.event_driven_reference import solve
from carom.lab.tradeoff.reference import scale_of
from carom.physics.space import Space
from carom.plan.auto import pull_fraction
from carom.scene.integrators import INTEGRATORS
from carom.scene.load import Scene

SEEDS = range(1, 9)
COUNTS = (2, 3, 5, 8, 10, 14, 20)
STEPS = (1.0, 2.0, 4.0)


def cluster(count: int, seed: int) -> Scene:
    """Scatter bodies of a total mass of 1 in a ball of radius 1, G = 1, nearly in virial equilibrium, for 2 s."""
    group = {"count": count, "mass": 1.0 / count, "radius": 0.02, "region": {"radius": 1.0}}
    return Scene.from_dict(
        {
            "seed": seed,
            "time": {"duration": 2.0, "integrator": "leapfrog"},
            "gravity": {"constant": 1.0},
            "contact": {"enabled": False},
            "group": [{**group, "velocity": {"dispersion": 0.4}}],
        }
    )


def with_step(scene: Scene, integrator: str, factor: float) -> Scene:
    """Return the scene with an integrator, and a multiple of leapfrog's automatic step."""
    fraction = pull_fraction(scene)
    assert fraction is not None, "a cluster of points that pull each other"
    keys = {"integrator": integrator, "pull_fraction": factor * fraction}
    return scene.model_copy(update={"time": scene.time.model_copy(update=keys)})


def measure(scene: Scene, exact: Trajectory, integrator: str, factor: float) -> tuple[float, float, float]:
    """Return the rms error of the positions over the size, the largest energy error, and the number of force sums."""
    run = follow(Space(with_step(scene, integrator, factor), 1), sample_times(scene))
    apart, _ = scale_of(scene, exact).apart(run, exact)
    return float(np.sqrt(np.mean(apart**2))), run.energy_error, float(run.steps * INTEGRATORS[integrator].force_sums)


def ratios(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return medians over the clusters: leapfrog's errors and sums, (3,), and Yoshida's over these, (steps, 3)."""
    own, fourth = [], []
    for seed in SEEDS:
        scene = cluster(count, seed)
        exact = solve(Space(scene, 1), sample_times(scene)).trajectory
        own.append(measure(scene, exact, "leapfrog", 1.0))
        fourth.append([measure(scene, exact, "yoshida4", step) for step in STEPS])
    first, others = np.array(own), np.array(fourth)
    return np.median(first, axis=0), np.median(others / first[:, None, :], axis=0)


def main() -> None:
    heads = [f"{step:g} × the step: position | energy | force sums" for step in STEPS]
    print("| bodies | leapfrog: position | energy |", *(f"{head} |" for head in heads))
    print("|---" * (3 + 3 * len(STEPS)) + "|")
    for count in COUNTS:
        own, fourth = ratios(count)
        cells = [f"{row[0]:.2g} | {row[1]:.2g} | {row[2]:.2f}" for row in fourth]
        print(f"| {count} | {own[0]:.1e} | {own[1]:.1e} |", *(f"{cell} |" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
