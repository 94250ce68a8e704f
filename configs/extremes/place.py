"""Write the bodies of those extremes that are too many to write by hand: `python configs/extremes/place.py`.

Everything above the marker in a scene is written by a person; everything below it is replaced.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
MARKER = "# The bodies are written by place.py.\n"

Bodies = Iterator[dict[str, Any]]


def overlapped() -> Bodies:
    """27 spheres on a cubic lattice of 1.5 radii."""
    for cell in product((-1.5, 0.0, 1.5), repeat=3):
        yield {"position": list(cell), "radius": 1.0}


def elastic_chain() -> Bodies:
    """Place a striker, and a hundred balls at rest that touch: quarters and eighths are exact in binary."""
    for k in range(100):
        yield {"name": f"ball {k}", "position": [0.25 * k, 0.0, 0.0], "radius": 0.125}
    yield {"name": "striker", "position": [-1.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0], "radius": 0.125}


def collapse_10() -> Bodies:
    """Five beads from each side, at distances that are not symmetric."""
    gaps = (0.5, 0.7, 0.9, 0.6, 0.8)
    for side, shift in ((-1.0, 0.0), (1.0, 0.3)):
        at = 1.5 + shift
        for gap in gaps:
            yield {"position": [side * round(at, 3), 0.0, 0.0], "velocity": [-side, 0.0, 0.0], "radius": 1.0}
            at += 2.0 + gap


def dense_gas() -> Bodies:
    """500 spheres on a face-centred cubic lattice, Maxwellian velocities without a mean."""
    cells, box = 5, 8.114
    corners = ((0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5), (0.5, 0.5, 0.0))
    velocities = np.random.default_rng(0).standard_normal((4 * cells**3, 3))
    velocities -= velocities.mean(axis=0)
    for k, (*cell, corner) in enumerate(product(range(cells), range(cells), range(cells), corners)):
        position = [round(box * ((c + o) / cells - 0.5), 6) for c, o in zip(cell, corner, strict=True)]
        yield {
            "position": position,
            "velocity": [round(float(v), 6) for v in velocities[k]],
            "radius": 0.5,
            "mass": 1.0,
        }


def hub_25() -> Bodies:
    """Place a hub and 25 pebbles on a Fibonacci sphere around it."""
    yield {"name": "hub", "radius": 10.0, "density": 3000.0}
    for k in range(25):
        z = 1.0 - (2 * k + 1) / 25
        angle = k * np.pi * (3.0 - np.sqrt(5.0))
        across = np.sqrt(1.0 - z * z)
        position = [round(float(12.0 * part), 6) for part in (across * np.cos(angle), across * np.sin(angle), z)]
        yield {"name": f"pebble {k}", "position": position, "radius": 1.0, "density": 3000.0}


def column(count: int, lowest: float, pitch: float) -> Bodies:
    """Place balls above each other, of which the last is the top."""
    for k in range(count):
        name = {"name": "top"} if k == count - 1 else {}
        yield name | {"position": [0.0, 0.0, round(lowest + pitch * k, 6)], "radius": 1.0}


def stack_20() -> Bodies:
    """Place twenty balls in a column, 5 cm above each other and the floor."""
    yield from column(20, 1.05, 2.05)


def stack_200() -> Bodies:
    """Place two hundred balls that touch in a column on the floor."""
    yield from column(200, 1.0, 2.0)


def stack_dropped() -> Bodies:
    """Place fifty balls in a column, 5 cm above each other and the floor."""
    yield from column(50, 1.05, 2.05)


def table(body: dict[str, Any]) -> str:
    """Write one [[body]] of a scene."""
    lines = [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in body.items()]
    return "\n".join(["[[body]]", *lines])


def main() -> None:
    """Replace what is below the marker in each scene."""
    for place in (overlapped, elastic_chain, collapse_10, dense_gas, hub_25, stack_20, stack_200, stack_dropped):
        path = HERE / f"{place.__name__.replace('_', '-')}.toml"
        head, _, _ = path.read_text(encoding="utf-8").partition(MARKER)
        path.write_text(head + MARKER + "\n" + "\n\n".join(map(table, place())) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
