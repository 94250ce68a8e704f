"""Spheres in a hopper of triangles, beside the same spheres in a cone.

    python benchmarks/mesh.py [--bodies 10000] [--triangles 10000] [--seconds 1] [--calm 15] [--rounds 3] [--dry]

Spheres of radius 0.1 m fall from a jittered lattice into a hopper that stands on a floor; friction 0.5, restitution 0,
60 steps a second. The mesh has rings of triangles with their corners on the cone. The runs take turns of ten steps on
one thread. Times are CPU time of a step: the mean of the fall, in the first ``--seconds``, and the median of
``--rounds`` seconds at rest, after ``--calm`` seconds.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from carom.physics.space import Space
from carom.scene.load import Scene
from heap import FRICTION, RADIUS, RATE, SPACING, TURN, WARM_UP
from measurement import merge

OUTLET, SLOPE = 10.0 * RADIUS, 1.5  # m, radius of the hopper at the floor; its height over its width
CLEARANCE = 1.3  # radii from the wall to a site of the lattice, with the jitter


def sites(n: int) -> tuple[Any, float]:
    """Return n jittered positions in a hopper, and its height in m."""
    step = SPACING * RADIUS
    layers, height, count = list[Any](), 2.0 * RADIUS, 0
    while count < n:
        width = OUTLET + height / SLOPE - CLEARANCE * RADIUS * np.hypot(1.0, 1.0 / SLOPE)
        k = int(width / step)
        at = np.arange(-k, k + 1) * step
        layer = np.stack(np.meshgrid(at, at, [height], indexing="ij"), axis=-1).reshape(-1, 3)
        layers.append(layer[np.hypot(layer[:, 0], layer[:, 1]) < width])
        height, count = height + step, count + len(layers[-1])
    position = np.concatenate(layers)[:n]
    return position + np.random.default_rng(0).uniform(-0.19, 0.19, position.shape) * RADIUS, height + step


def triangles(count: int, height: float) -> trimesh.Trimesh:
    """Return about as many triangles with their corners on the cone, as long as they are wide."""
    slant = np.hypot(height, height / SLOPE)
    middle = 2.0 * np.pi * (OUTLET + 0.5 * height / SLOPE)
    sides = round(np.sqrt(0.5 * count * middle / slant))
    rings = round(0.5 * count / sides)
    angle, up = np.meshgrid(2.0 * np.pi * np.arange(sides) / sides, np.linspace(0.0, height, rings + 1))
    rho = OUTLET + up / SLOPE
    corners = np.stack((rho * np.cos(angle), rho * np.sin(angle), up), axis=-1).reshape(-1, 3)
    number = np.arange((rings + 1) * sides).reshape(rings + 1, sides)
    a, b = number[:-1], np.roll(number, -1, axis=1)[:-1]
    c, d = np.roll(number, -1, axis=1)[1:], number[1:]
    faces = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    return trimesh.Trimesh(corners, faces, process=False)


def space_of(position: Any, wall: dict[str, Any]) -> Space:
    """Return spheres in a hopper."""
    document = {
        "body": [{"position": [x, y, z], "mass": 1.0, "radius": RADIUS} for x, y, z in position.tolist()],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        "contact": {"restitution": 0.0, "static_friction": FRICTION, "kinetic_friction": FRICTION},
        "plane": [{"normal": [0, 0, 1]}],
        "wall": [wall],
        "time": {"duration": 1e6, "fixed_dt": 1.0 / RATE},
        "record": {"every": 1e6, "check_every": 10**6},
    }
    return Space(Scene.from_dict(document), 1)


def spaces(n: int, count: int) -> tuple[dict[str, Space], dict[str, float]]:
    """Return the same spheres in a cone and in a mesh, and the CPU time in s that each took to begin."""
    position, height = sites(n)
    of, spent = dict[str, Space](), dict[str, float]()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hopper.ply"
        triangles(count, height).export(file)
        cone = {"radius": OUTLET, "end_radius": OUTLET + height / SLOPE, "height": height}
        walls: dict[str, dict[str, Any]] = {"cone": {"cone": cone}, "mesh": {"mesh": {"file": str(file)}}}
        for name, wall in walls.items():
            began = time.process_time()
            of[name] = space_of(position, wall)
            spent[name] = time.process_time() - began
    return of, spent


def compare(n: int, count: int, seconds: int, calm: int, rounds: int) -> dict[str, Any]:
    """Let both fall and come to rest in turns."""
    for space in spaces(WARM_UP, WARM_UP)[0].values():  # loads the kernels
        for _ in range(RATE):
            space.compute_dynamics(space.step + 1)
    of, begun = spaces(n, count)
    times: dict[str, dict[str, list[float]]] = {name: {"falling": [], "settling": [], "at rest": []} for name in of}
    for stage, lasts in (("falling", seconds), ("settling", calm - seconds), ("at rest", rounds)):
        for _ in range(lasts * RATE // TURN):
            for name, space in of.items():
                began = time.process_time()
                for _ in range(TURN):
                    space.compute_dynamics(space.step + 1)
                times[name][stage].append(1e3 * (time.process_time() - began) / TURN)
    fall = {name: statistics.mean(each["falling"]) for name, each in times.items()}
    rest = {name: statistics.median(each["at rest"]) for name, each in times.items()}
    return {
        "bodies": n,
        "triangles": count,
        "contacts": {name: float(len(space.contacts)) for name, space in of.items()},
        "s, to begin": {name: round(value, 2) for name, value in begun.items()},
        "ms, falling": {name: round(value, 2) for name, value in fall.items()},
        "ms, at rest": {name: round(value, 2) for name, value in rest.items()},
        "mesh over cone, falling": round(fall["mesh"] / fall["cone"], 3),
        "mesh over cone, at rest": round(rest["mesh"] / rest["cone"], 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", type=int, default=10_000)
    parser.add_argument("--triangles", type=int, default=10_000)
    parser.add_argument("--seconds", type=int, default=2, help="of the fall")
    parser.add_argument("--calm", type=int, default=6, help="seconds after which the spheres are at rest")
    parser.add_argument("--rounds", type=int, default=2, help="seconds that are measured at rest")
    parser.add_argument("--dry", action="store_true", help="write no results")
    given = parser.parse_args()
    row = compare(given.bodies, given.triangles, given.seconds, given.calm, given.rounds)
    print(row)
    if not given.dry:
        print(merge("mesh", {"rows": [row]}))


if __name__ == "__main__":
    main()
