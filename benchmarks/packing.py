"""Dense random packings: the time of `arrangement = "compressed"`, and the properties of its packings.

    python benchmarks/packing.py [--bodies N ...] [--packing P ...]

Equal spheres of radius 1 m in a periodic box. Times are CPU seconds with warm kernels, the random start included.
`near` is the mean number of neighbours nearer than 1.01 diameters; `overlap` is the deepest overlap over the radius.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import numpy as np

from carom.physics.placement import place
from carom.physics.placement.neighbours import overlapping_pairs
from carom.scene.load import Scene
from measurement import merge

SIZES, PACKINGS = [1000, 10_000, 100_000], [0.3, 0.4, 0.5, 0.6]


def measured(n: int, packing: float) -> dict[str, Any]:
    """Place spheres twice, and measure the packing."""
    side = float(np.cbrt(n * 4.0 / 3.0 * math.pi / packing))
    scene = Scene.from_dict(
        {
            "gravity": {"constant": 0.0},
            "domain": {"boundary": "periodic", "size": [side] * 3},
            "group": [
                {
                    "count": n,
                    "radius": 1.0,
                    "arrangement": "compressed",
                    "region": {"shape": "box", "size": [side] * 3},
                }
            ],
        }
    )
    began = time.process_time()
    x, again, spent = place(scene).position, place(scene).position, 0.5 * (time.process_time() - began)
    near = overlapping_pairs(x, np.full(n, 1.01), np.full(3, side))
    d = x[near[:, 1]] - x[near[:, 0]]
    d -= side * np.round(d / side)
    return {
        "bodies": n,
        "packing": f"{packing:g}",
        "seconds": spent,
        "overlap": 2.0 - min(2.0, float(np.sqrt((d * d).sum(axis=1)).min(initial=2.0))),
        "near": 2.0 * len(near) / n,
        "same_bits": bool((x == again).all()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Dense random packings.")
    parser.add_argument("--bodies", type=int, nargs="+", default=SIZES)
    parser.add_argument("--packing", type=float, nargs="+", default=PACKINGS)
    chosen = parser.parse_args()
    measured(100, 0.4)  # loads the kernels
    for n in chosen.bodies:
        for packing in chosen.packing:
            row = measured(n, packing)
            print(
                f"{n:>7} {row['packing']:>4} {row['seconds']:8.2f} CPU s, "
                f"overlap {row['overlap']:.1e}, {row['near']:.2f} near, same bits: {row['same_bits']}",
                flush=True,
            )
            merge("packing", {"rows": [row]})


if __name__ == "__main__":
    main()
