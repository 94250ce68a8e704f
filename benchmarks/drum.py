"""Spheres in a rotating drum, beside a heap of as many spheres in a box.

    python benchmarks/drum.py [--bodies 10000] [--only NAME ...] [--seconds 1] [--rounds 3] [--dry]

Both have spheres of radius 0.1 m, friction 0.5, restitution 0 and 60 steps a second, and fall from a jittered lattice.
The drum is as wide as twenty spheres and has two discs at its ends. It rotates at 0.3 rad/s, so its spheres flow for
ever, while those of the heap come to rest. Therefore the falls are compared, in the first ``--seconds``: in the first
second both are in motion, and after it the heap settles. The drum that flows is compared with the heap that falls, too.
The runs take turns of ten steps on one thread. Times are CPU time of a step: the mean of the fall, and the median of
``--rounds`` seconds after it.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

from carom.physics.space import Space
from carom.scene.load import Scene
from heap import FRICTION, RADIUS, RATE, SPACING, TURN, lattice
from measurement import merge

WIDTH = 20  # of the drum, in diameters
FILLED, PACKING = 0.4, 0.6  # of the drum, and of the space between the spheres
ROTATION = 0.3  # rad/s; the Froude number Ω² R/g is 0.03
CONTACT: dict[str, dict[str, Any]] = {  # thin walls need impacts at their own times
    "carom": {},
    "as needed": {"sweeps": "as-needed"},
    "quick, impacts at their own times": {"sweeps": "quick"},
}
CLEARANCE = 1.3  # radii from the wall to a site of the lattice, with the jitter


def drum(n: int, setting: str) -> Space:
    """Return n spheres in a drum."""
    width = WIDTH * 2.0 * RADIUS
    radius = np.sqrt(n * 4.0 / 3.0 * np.pi * RADIUS**3 / (PACKING * FILLED * np.pi * width))
    k = int(2.0 * radius / (SPACING * RADIUS))
    across = (np.arange(k) - 0.5 * (k - 1)) * SPACING * RADIUS
    slices = int((width - 2.0 * CLEARANCE * RADIUS) / (SPACING * RADIUS)) + 1
    along = (np.arange(slices) - 0.5 * (slices - 1)) * SPACING * RADIUS
    sites = np.stack(np.meshgrid(across, along, across, indexing="ij"), axis=-1).reshape(-1, 3)
    sites = sites[np.hypot(sites[:, 0], sites[:, 2]) < radius - CLEARANCE * RADIUS]
    sites = sites[np.argsort(sites[:, 2], kind="stable")[:n]]
    sites += np.random.default_rng(0).uniform(-0.19, 0.19, sites.shape) * RADIUS
    ends = [
        {"disc": {"radius": 1.02 * radius, "centre": [0, -sign * width / 2, 0], "normal": [0, sign, 0]}}
        for sign in (1, -1)
    ]
    rotates = {"cylinder": {"radius": radius, "axis": [0, 1, 0]}, "motion": {"rotation": ROTATION}}
    return _space(sites, setting, {"wall": [rotates, *ends]})


def heap(n: int, setting: str) -> Space:
    """Return the heap of `heap.py`."""
    position, side = lattice(n)
    box = {"boundary": "walls", "size": [side, side, 2.0 * side]}
    return _space(position - np.array([0.0, 0.0, side]), setting, {"domain": box})


def _space(position: Any, setting: str, sections: dict[str, Any]) -> Space:
    document = {
        "body": [{"position": [x, y, z], "mass": 1.0, "radius": RADIUS} for x, y, z in position.tolist()],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        "contact": {
            "restitution": 0.0,
            "static_friction": FRICTION,
            "kinetic_friction": FRICTION,
            **CONTACT[setting],
        },
        "time": {"duration": 1e6, "fixed_dt": 1.0 / RATE},
        "record": {"every": 1e6, "check_every": 10**6},
    }
    return Space(Scene.from_dict(document | sections), 1)


def compare(n: int, setting: str, seconds: int, rounds: int) -> dict[str, Any]:
    """Let both fall and go on in turns."""
    heap_of = heap(n, setting)
    spaces = {"drum": drum(len(heap_of.state.mass), setting), "heap": heap_of}
    falling: dict[str, list[float]] = {name: [] for name in spaces}
    later: dict[str, list[float]] = {name: [] for name in spaces}
    for stage, turns in ((falling, seconds * RATE // TURN), (later, rounds * RATE // TURN)):
        for _ in range(turns):
            for name, space in spaces.items():
                began = time.process_time()
                for _ in range(TURN):
                    space.compute_dynamics(space.step + 1)
                stage[name].append(1e3 * (time.process_time() - began) / TURN)
    fall = {name: statistics.mean(times[1:]) for name, times in falling.items()}  # the first turn loads kernels
    then = {name: statistics.median(times) for name, times in later.items()}
    return {
        "bodies": len(spaces["drum"].state.mass),
        "setting": setting,
        "seconds": seconds,
        "contacts": {name: float(len(space.contacts)) for name, space in spaces.items()},
        "ms, falling": {name: round(value, 2) for name, value in fall.items()},
        "ms, later": {name: round(value, 2) for name, value in then.items()},
        "drum over heap, falling": round(fall["drum"] / fall["heap"], 3),
        "drum flowing over heap falling": round(then["drum"] / fall["heap"], 3),
        "drum flowing over heap at rest": round(then["drum"] / then["heap"], 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", type=int, default=10_000)
    parser.add_argument("--only", nargs="+", default=list(CONTACT), choices=list(CONTACT), help="settings of carom")
    parser.add_argument("--seconds", type=int, default=1, help="of the fall")
    parser.add_argument("--rounds", type=int, default=3, help="seconds that are measured afterwards")
    parser.add_argument("--dry", action="store_true", help="write no results")
    given = parser.parse_args()
    for setting in given.only:
        row = compare(given.bodies, setting, given.seconds, given.rounds)
        print(row, flush=True)
        if not given.dry:
            print(merge("drum", {"rows": [row]}))


if __name__ == "__main__":
    main()
