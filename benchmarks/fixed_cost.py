"""The fixed cost of a step: small scenes, and many bodies with few contacts, on one and two threads.

    python benchmarks/fixed_cost.py [--rounds 7] [--label 5f80859] [--dry]

The scenes: 10 spheres at rest on a floor, `cloud-collapse` when its pile has formed, `marbles-in-a-box`, 1000 spheres
of `heap.py` at rest, and 10⁴ and 10⁵ spheres of `step.py` in open space, with contacts only. Wall time, both numbers of
threads in turns. To compare versions, run this in turns with PYTHONPATH set to the `src` of another checkout and
``--label`` to its commit.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from carom.physics.space import Space
from carom.scene.load import Scene, load_scene
from heap import SETTINGS, in_carom
from measurement import medians, merge
from step import in_open_space

SCENES = Path(__file__).parents[1] / "configs"
QUIET = ["record.every=1e9", "record.check_every=1000000"]
THREADS = (1, 2)


def scene(name: str, threads: int) -> Callable[[], object]:
    space = Space(load_scene(str(SCENES / f"{name}.toml"), QUIET), threads)
    return lambda: space.compute_dynamics(space.step + 1)


def on_a_floor(n: int, threads: int) -> Callable[[], object]:
    """Lay rows of five spheres on a plane, one row upon the other."""
    spheres = [{"radius": 0.5, "mass": 1.0, "position": [k % 5, 0.0, 0.5 + k // 5]} for k in range(n)]
    document = {
        "time": {"duration": 1e9, "fixed_dt": 1.0 / 60.0},
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        "contact": {"restitution": 0.3, "static_friction": 0.5, "kinetic_friction": 0.5},
        "record": {"check_every": 1_000_000},
        "plane": [{"point": [0.0, 0.0, 0.0]}],
        "body": spheres,
    }
    space = Space(Scene.from_dict(document), threads)
    return lambda: space.compute_dynamics(space.step + 1)


def crowd(n: int, threads: int) -> Callable[[], object]:
    space = in_open_space(n, threads, 0.0)
    return lambda: space.compute_dynamics(space.step + 1)


CASES: dict[str, tuple[Callable[[int], Callable[[], object]], int, int]] = {  # how to make it, steps before, in a round
    "10 spheres on a floor": (lambda threads: on_a_floor(10, threads), 300, 300),
    "cloud-collapse": (lambda threads: scene("cloud-collapse", threads), 2000, 40),
    "marbles-in-a-box": (lambda threads: scene("marbles-in-a-box", threads), 400, 40),
    "heap of 1000 at rest": (lambda threads: in_carom(1000, threads, **SETTINGS["quick"]).step, 1200, 40),
    "10⁴ bodies, contacts only": (lambda threads: crowd(10**4, threads), 20, 40),
    "10⁵ bodies, contacts only": (lambda threads: crowd(10**5, threads), 20, 20),
}


def several(step: Callable[[], object], steps: int) -> Callable[[], None]:
    def go() -> None:
        for _ in range(steps):
            step()

    return go


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--label", default="now", help="the version that is measured")
    parser.add_argument("--dry", action="store_true", help="do not write the results")
    given = parser.parse_args()
    rows = []
    for name, (make, before, steps) in CASES.items():
        made = {threads: make(threads) for threads in THREADS}
        for step in made.values():
            several(step, before)()
        spent = medians({f"{threads}": several(step, steps) for threads, step in made.items()}, given.rounds)
        ms = {threads: float(f"{1e3 * seconds / steps:.4g}") for threads, seconds in spent.items()}
        rows.append({"scene": name, "version": given.label, "ms": ms, "gain": round(ms["1"] / ms["2"], 2)})
        print(rows[-1], flush=True)
    if not given.dry:
        merge("fixed-cost", {"steps": rows})


if __name__ == "__main__":
    main()
