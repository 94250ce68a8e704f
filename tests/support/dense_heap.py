"""Runs `carom run` on a lattice of spheres that touch 12 others, more than random placement can make: as a program.

python dense_heap.py COUNT OUTPUT
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from carom.__main__ import main
from carom.physics.placement import random_placement
from carom.scene.schema import BodyGroup

SCENE = """
time = {{ duration = 0.01, fixed_dt = 1e-3 }}
gravity = {{ constant = 0.0, uniform = [0.0, 0.0, -9.81] }}
contact = {{ sweeps = 2 }}
record = {{ every = "step" }}
domain = {{ boundary = "walls", size = [{side}, {side}, {side}] }}
[[group]]
count = {count}
radius = 0.5
region = {{ shape = "box", size = [{side}, {side}, {side}] }}
"""


def lattice(count: int) -> np.ndarray:
    """Return centres (n, 3) m of spheres of radius 0.5 m in a face-centred cubic lattice about the origin."""
    cells = np.arange(np.ceil((count / 4) ** (1 / 3)))
    corner = np.array([[0, 0, 0], [0, 1, 1], [1, 0, 1], [1, 1, 0]]) / 2
    places = np.stack(np.meshgrid(cells, cells, cells, indexing="ij"), -1).reshape(-1, 1, 3) + corner
    # overlaps of 1e-5 of a diameter: all touch
    position = (places.reshape(-1, 3) * np.sqrt(2.0) * (1.0 - 1e-5))[:count]
    return np.asarray(position - position.mean(axis=0))


def arranged(mixture: Mapping[int, BodyGroup], *_: Any) -> np.ndarray:
    """Return the centres of a group on the lattice."""
    return lattice(sum(group.count for group in mixture.values()))


if __name__ == "__main__":
    count, output = int(sys.argv[1]), Path(sys.argv[2])
    scene = output.with_suffix(".toml")
    scene.write_text(SCENE.format(count=count, side=1.8 * count ** (1 / 3) + 2.0), encoding="utf-8")
    random_placement.RANDOM = random_placement.RANDOM._replace(arrange=arranged)  # type: ignore[arg-type]
    sys.argv = ["carom", "run", str(scene), "-o", str(output)]
    main()
