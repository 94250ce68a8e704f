"""Measures whether individual time steps, in powers of two, would make the tree faster in a cluster.

    python benchmarks/individual_steps.py

In Plummer spheres, each body gets the step that its own motion requires: a fraction of the shortest time of its pairs
(see `carom.physics.step_rule`) or of its fall to the centre. With a shared step, all bodies take the shortest one. With
individual steps, a body is advanced at its own power of two, but each shortest step builds the tree anew and predicts
the positions of all bodies. Groups of neighbours share a walk, so a group walks whenever one of its bodies is due. The
times of building, walking and predicting are measured, on one thread.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from carom.physics.forces.gravity.boxes import Boxes
from carom.physics.forces.gravity.tree import TreeGravity
from carom.physics.jit.team import SOLO

FloatArray = NDArray[np.float64]

ANGLE = 0.5  # rad
FRACTION = 0.02  # of the shortest time, that a step takes
ROWS = 500  # bodies whose pairs are examined at a time
CASES = ((1000, 0.0), (1000, 0.02), (10_000, 0.0), (10_000, 0.02))  # bodies, softening in units of the virial radius


def plummer(n: int, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities, (n, 3), with G = M = 1 and a virial radius of 1.

    After Aarseth, Hénon & Wielen (1974).
    """
    random = np.random.default_rng(seed)
    scale = 3.0 * np.pi / 16.0
    r = scale / np.sqrt((0.999 * random.random(n)) ** (-2.0 / 3.0) - 1.0)
    q = np.empty(n)
    for i in range(n):  # the speed over that of escape, by rejection
        q[i], y = random.random(), 0.1 * random.random()
        while y > q[i] ** 2 * (1.0 - q[i] ** 2) ** 3.5:
            q[i], y = random.random(), 0.1 * random.random()
    speed = q * np.sqrt(2.0) * (r * r + scale * scale) ** -0.25

    def turned(length: FloatArray) -> FloatArray:
        ray = random.standard_normal((n, 3))
        return np.asarray(length[:, None] * ray / np.linalg.norm(ray, axis=1)[:, None])

    return turned(r), turned(speed)


def required(x: FloatArray, v: FloatArray, softening: float) -> FloatArray:
    """Return the step that each body requires, (n,)."""
    n = len(x)
    shortest, acceleration = np.empty(n), np.empty(n)
    for begin in range(0, n, ROWS):
        rows = slice(begin, min(begin + ROWS, n))
        d, w = x[None] - x[rows, None], v[None] - v[rows, None]
        square = (d * d).sum(2) + softening * softening
        own = np.arange(rows.start, rows.stop)
        square[own - begin, own] = np.inf
        rate = (w * w).sum(2) / square + 2.0 / n / (square * np.sqrt(square))  # 1/τ²
        shortest[rows] = 1.0 / np.sqrt(rate.max(1))
        pull = (d / (square * np.sqrt(square))[..., None]).sum(1) / n
        acceleration[rows] = np.linalg.norm(pull, axis=1)
    fall = np.sqrt(np.linalg.norm(x - x.mean(0), axis=1) / acceleration)
    return np.asarray(FRACTION * np.minimum(shortest, fall))


def seconds(act: Callable[[], object]) -> float:
    """Return the least CPU time of a call in s."""
    spent = []
    for _ in range(9):
        began = time.process_time()
        act()
        spent.append(time.process_time() - began)
    return min(spent[2:])


def row(n: int, softening: float) -> str:
    """Measure one cluster."""
    x, v = plummer(n)
    step = required(x, v, softening)
    grid = 2.0 ** np.floor(np.log2(step))
    least = grid.min()
    mass, pull = np.full(n, 1.0 / n), np.empty((n, 3))
    gravity, boxes = TreeGravity(mass, 1.0, softening, ANGLE), Boxes(mass, SOLO)
    build, whole = seconds(lambda: boxes.sort(x)), seconds(lambda: gravity.accelerate(x, pull, False))
    predict = seconds(lambda: x + 0.1 * (v + 0.05 * pull))
    walk = whole - build  # with the moments, which are due at every shortest step, too
    active = float(np.mean(least / grid))
    # the part of the shortest steps at which a group has a body that is due
    groups = float(np.mean([least / grid[boxes.body[a:b]].min() for a, b in itertools.pairwise(boxes.groups.tolist())]))
    shared = (build + walk) * (least / step.min())  # a shared step needs no grid
    ideal, real = shared / (active * (build + walk)), shared / (build + predict + active * walk)
    as_is = shared / (build + predict + groups * walk)
    levels = int(np.log2(grid.max() / least)) + 1
    return (
        f"| {n} | {softening:g} | {levels} | {active:.3f} | {groups:.3f} | {1e3 * build:.2f} | {1e3 * walk:.2f} "
        f"| {1e3 * predict:.2f} | {ideal:.1f} | {real:.1f} | {as_is:.1f} |"
    )


def main() -> None:
    """Print the table."""
    heads = "bodies, softening, levels, bodies due, groups due, build in ms, walk in ms, predict in ms"
    heads += ", gain without overheads, gain, gain by groups"
    print(f"| {' | '.join(heads.split(', '))} |\n|{'---|' * len(heads.split(', '))}")
    for n, softening in CASES:
        print(row(n, softening), flush=True)


if __name__ == "__main__":
    main()
