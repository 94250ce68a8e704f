"""A heap of spheres in a box, falling, settling and at rest, in carom and in Box3D with four substeps.

    python benchmarks/heap.py [--bodies 1000 10000] [--threads 1 2] [--rounds 5] [--calm 20] [--only NAME ...] [--dry]

Spheres of radius 0.1 m fall from a jittered lattice into a box that they fill to about its width; friction 0.5,
restitution 0, 60 steps a second, sleep off in Box3D and in all but one of carom's runs. carom runs with its defaults
and with the settings of `SETTINGS`, of which `--only` selects some. "Falling" is the first three seconds, and "at rest"
the time after `--calm` seconds. The engines take turns in one process. A step's time is the median of the rounds: CPU
time of the process with one thread, wall time with more. Residual motion is the root mean square of the speeds at rest,
mostly of rolling spheres. Overlaps are the deepest observed ones, in radii.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import robox3d
from numpy.typing import NDArray

from carom.physics.space import Space
from carom.scene.load import Scene
from measurement import merge

FloatArray = NDArray[np.float64]

RADIUS, SPACING, FRICTION = 0.1, 2.4, 0.5  # m, radii, 1
RATE, FALL, TURN = 60, 180, 10  # steps a second; steps; steps before the next engine's turn
SUBSTEPS = 4  # of Box3D
WARM_UP = 1000  # bodies of a heap that loads the kernels and is not measured
SETTINGS: dict[str, dict[str, Any]] = {  # sections [contact] of carom's runs
    "carom": {},
    "converged": {"sweeps": "converged"},
    "as needed": {"sweeps": "as-needed"},
    "as needed, impacts at the end": {"timing": "end-of-step", "sweeps": "as-needed"},
    "asleep": {"sweeps": "as-needed", "sleep": {"speed": 0.02}},
    "quick": {"timing": "end-of-step", "sweeps": "quick"},
}


class Heap(NamedTuple):
    """A heap in one of the engines."""

    step: Callable[[], object]
    positions: Callable[[], FloatArray]
    speeds: Callable[[], FloatArray]


def lattice(n: int) -> tuple[FloatArray, float]:
    """Return about n jittered positions above the floor z = 0, and the side of the box around x = y = 0, in m."""
    rng = np.random.default_rng(0)
    k = round(n ** (1 / 3))
    sites = np.stack(np.meshgrid(*[np.arange(k)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * SPACING * RADIUS
    side = k * SPACING * RADIUS
    sites[:, :2] -= 0.5 * (k - 1) * SPACING * RADIUS
    sites[:, 2] += 2.0 * RADIUS
    return sites + rng.uniform(-0.19, 0.19, sites.shape) * RADIUS, side


def in_carom(n: int, threads: int, **contact: Any) -> Heap:
    position, side = lattice(n)
    height = 2.0 * side
    space = Space(
        Scene.from_dict(
            {
                "body": [{"position": [x, y, z - 0.5 * height], "mass": 1.0, "radius": RADIUS} for x, y, z in position],
                "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
                "contact": {
                    "restitution": 0.0,
                    "static_friction": FRICTION,
                    "kinetic_friction": FRICTION,
                    **contact,
                },
                "domain": {"boundary": "walls", "size": [side, side, height]},
                "time": {"duration": 1e6, "fixed_dt": 1.0 / RATE},
                "record": {"every": 1e6, "check_every": 10**6},
            }
        ),
        threads,
    )
    state = space.state
    return Heap(
        lambda: space.compute_dynamics(space.step + 1),
        lambda: state.position + np.array([0.0, 0.0, 0.5 * height]),
        lambda: np.linalg.norm(state.velocity, axis=1),
    )


def in_box3d(n: int, threads: int) -> Heap:
    position, side = lattice(n)
    world = robox3d.World(gravity=(0.0, 0.0, -9.81), substeps=SUBSTEPS, worker_count=threads, enable_sleep=False)
    half = 4.0 * side
    for normal in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)):
        offset = 0.0 if normal[2] else -0.5 * side
        wall = world.create_body(position=tuple((offset - half) * np.array(normal)), kind="static")
        wall.add_box((half, half, half), friction=FRICTION, restitution=0.0)
    density = 1.0 / (4.0 / 3.0 * np.pi * RADIUS**3)
    balls = []
    for place in position:
        ball = world.create_body(position=place.tolist())
        ball.add_sphere(RADIUS, density=density, friction=FRICTION, restitution=0.0)
        balls.append(ball)
    return Heap(
        lambda: world.step(1.0 / RATE),
        lambda: np.array([ball.position for ball in balls]),
        lambda: np.linalg.norm([ball.linear_velocity for ball in balls], axis=1),
    )


def deepest(position: FloatArray, side: float) -> float:
    """Return the deepest overlap of two spheres, or of one with the floor or a wall, in radii."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

    pairs = cKDTree(position).query_pairs(2.0 * RADIUS, output_type="ndarray")
    gap = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1) - 2.0 * RADIUS
    walls = 0.5 * side - np.abs(position[:, :2]).max() - RADIUS
    return float(-min(gap.min(initial=0.0), position[:, 2].min() - RADIUS, walls)) / RADIUS


def compare(n: int, threads: int, rounds: int, calm: int, only: list[str]) -> dict[str, Any]:
    """Let the heaps of both engines fall in turns, several times, then lie."""
    side = lattice(n)[1]
    clock = time.process_time if threads == 1 else time.perf_counter
    engines: dict[str, Callable[[int], Heap]] = {
        name: partial(in_carom, threads=threads, **contact) for name, contact in SETTINGS.items() if name in only
    }
    engines["Box3D"] = partial(in_box3d, threads=threads)
    for make in engines.values():
        _timed(clock, make(WARM_UP).step, FALL)  # loads the kernels
    falls: dict[str, list[float]] = {name: [] for name in engines}
    rests: dict[str, list[float]] = {name: [] for name in engines}
    for _ in range(max(1, rounds // 2)):
        heaps = {name: make(n) for name, make in engines.items()}
        spent, sunk = dict.fromkeys(heaps, 0.0), dict.fromkeys(heaps, 0.0)
        for _ in range(0, FALL, TURN):
            for name, heap in heaps.items():
                spent[name] += _timed(clock, heap.step, TURN)
                sunk[name] = max(sunk[name], deepest(heap.positions(), side))
        for name in heaps:
            falls[name].append(1e3 * spent[name] / FALL)
    for heap in heaps.values():
        for _ in range(calm * RATE - FALL):
            heap.step()
    squares = dict.fromkeys(heaps, 0.0)
    for _ in range(rounds):
        for name, heap in heaps.items():
            rests[name].append(1e3 * _timed(clock, heap.step, RATE) / RATE)
            squares[name] += float(np.mean(heap.speeds() ** 2)) / rounds
    return {
        "bodies": len(lattice(n)[0]),
        "threads": threads,
        "settings": "; ".join(heaps),
        "ms, falling": {name: _rounded(statistics.median(times)) for name, times in falls.items()},
        "ms, at rest": {name: _rounded(statistics.median(times)) for name, times in rests.items()},
        "overlap, falling": {name: _rounded(sunk[name]) for name in heaps},
        "overlap, at rest": {name: _rounded(deepest(heap.positions(), side)) for name, heap in heaps.items()},
        "m/s, at rest": {name: _rounded(np.sqrt(squares[name])) for name in heaps},
    }


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _timed(clock: Callable[[], float], step: Callable[[], object], steps: int) -> float:
    began = clock()
    for _ in range(steps):
        step()
    return clock() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", type=int, nargs="+", default=[1000, 10_000])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--calm", type=int, default=20, help="seconds until the heap counts as at rest")
    parser.add_argument("--only", nargs="+", default=list(SETTINGS), choices=list(SETTINGS), help="settings of carom")
    parser.add_argument("--dry", action="store_true", help="write no results")
    given = parser.parse_args()
    rows = []
    for n in given.bodies:
        for threads in given.threads:
            rows.append(compare(n, threads, given.rounds, given.calm, given.only))
            print(rows[-1], flush=True)
    if not given.dry:
        print(merge("heap", {"rows": rows}, "robox3d"))


if __name__ == "__main__":
    main()
