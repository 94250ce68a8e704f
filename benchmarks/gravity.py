"""Gravity of carom and of its peers, in one run: the same bodies, interleaved rounds, medians.

    python benchmarks/gravity.py [direct] [tree] [--bodies N ...] [--shapes plummer ball] [--peers pytreegrav rebound
                                 fmm3d] [--methods tree fast-multipole] [--rounds N]

`direct` compares the sum over all pairs with REBOUND's basic gravity. `tree` compares trees at equal error: each
method of carom gets the largest opening angle, in steps of 0.005, whose median and 99th percentile of the error are
both no larger than the peer's. FMM3D, which is made for high accuracy, gets the tolerance at which its 99th percentile
is 10⁻⁴. By default, there are 10⁵ bodies; at 10⁶ a peer takes a minute a round (`--rounds 1`, one shape and one peer at
a time). Peers run on one thread, as carom does for the ratio; carom's time on two threads is also given.
Rows take the place of those of the same method, bodies, shape and peer in benchmarks/results/gravity.json.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # FMM3D's, read when it is loaded

import numpy as np
import pytreegrav
import rebound
from numpy.typing import NDArray

from carom.physics.forces.gravity.direct import DirectGravity
from carom.physics.forces.gravity.fast_multipole.fast_multipole import FastMultipoleGravity
from carom.physics.forces.gravity.tree import TreeGravity
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.team import Team
from measurement import medians, merge

FloatArray = NDArray[np.float64]
Force = Callable[[], FloatArray]  # computes the accelerations, (n, 3)

DIRECT_BODIES = [1024, 4096, 16384]
TREE_BODIES = [100_000]
SAMPLE = 1000  # bodies whose error is measured
ENOUGH = 5e-3  # required 99th percentile of the error in a step of 10⁶ bodies
PEERS = ("rebound", "pytreegrav", "fmm3dpy")
CHOICES = ("pytreegrav", "rebound", "fmm3d")  # of trees
METHODS = ("tree", "fast-multipole")  # of carom
TINY = 1e-12  # s: REBOUND's step is one evaluation of the forces, and drifts that cost n


def plummer(n: int) -> FloatArray:
    rng = np.random.default_rng(0)
    radius = 1 / np.sqrt(rng.uniform(0.0, 0.999, n) ** (-2 / 3) - 1)
    return _directions(rng, n) * radius[:, None]


def ball(n: int) -> FloatArray:
    rng = np.random.default_rng(0)
    return _directions(rng, n) * np.cbrt(rng.uniform(0.0, 1.0, n))[:, None]


def _directions(rng: np.random.Generator, n: int) -> FloatArray:
    v = rng.standard_normal((n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1)[:, None])


SHAPES = {"plummer": plummer, "ball": ball}


def carom_direct(position: FloatArray, mass: FloatArray, threads: int, potential: bool) -> Force:
    gravity = DirectGravity(mass, 1.0, 0.0, Team(threads))
    return _carom(gravity, position, potential)


def carom_tree(method: str, position: FloatArray, mass: FloatArray, theta: float, threads: int) -> Force:
    law, team = (mass, 1.0, 0.0, theta), Team(threads)
    gravity = TreeGravity(*law, team=team) if method == "tree" else FastMultipoleGravity(*law, team=team)
    return _carom(gravity, position, potential=False)


def _carom(gravity: DirectGravity | TreeGravity | FastMultipoleGravity, position: FloatArray, potential: bool) -> Force:
    acceleration = np.empty_like(position)

    def force() -> FloatArray:
        gravity.accelerate(position, acceleration, potential)
        return acceleration

    return force


def rebound_force(position: FloatArray, mass: FloatArray, method: str, theta: float = 0.5) -> Force:
    """Return a leapfrog step of almost no length, after which velocities are accelerations times that length."""
    simulation = rebound.Simulation()
    if method == "tree":
        simulation.root_size = 2.5 * float(np.abs(position).max())
        simulation.opening_angle2 = theta * theta
    simulation.gravity = method
    simulation.integrator = "leapfrog"
    simulation.dt = TINY
    for (x, y, z), m in zip(position, mass, strict=True):
        simulation.add(m=m, x=x, y=y, z=z)
    velocity, before = np.empty_like(position), np.zeros_like(position)

    def force() -> FloatArray:
        simulation.steps(1)
        simulation.serialize_particle_data(vxvyvz=velocity)
        acceleration = (velocity - before) / TINY
        before[:] = velocity
        return acceleration

    return force


def pytreegrav_force(position: FloatArray, mass: FloatArray, theta: float) -> Force:
    pytreegrav.Accel(position[:2000], mass[:2000], theta=theta, quadrupole=True, method="tree")  # compiles
    return lambda: np.asarray(pytreegrav.Accel(position, mass, theta=theta, quadrupole=True, method="tree"))


def fmm3d_force(position: FloatArray, mass: FloatArray, tolerance: float) -> Force:
    import fmm3dpy  # noqa: PLC0415 - the other peers do without

    sources = np.asfortranarray(position.T)

    def force() -> FloatArray:
        field = fmm3dpy.lfmm3d(eps=tolerance, sources=sources, charges=mass, pg=2)  # of potentials 1/(4π r)
        return np.asarray(4 * np.pi * field.grad.T)

    return force


def peer_force(peer: str, shape: str, position: FloatArray, mass: FloatArray) -> tuple[str, Force]:
    """Return a peer as its users run it, and a description of these settings."""
    if peer == "rebound":
        return "REBOUND, tree, 0.5", rebound_force(position, mass, "tree", 0.5)
    if peer == "fmm3d":
        return "FMM3D, 1e-3", fmm3d_force(position, mass, 1e-3)
    theta = 0.7 if shape == "plummer" else 0.5  # its default, and one that serves a ball as well
    return f"pytreegrav, quadrupole, {theta}", pytreegrav_force(position, mass, theta)


@long_kernel
def _exact(position: FloatArray, mass: FloatArray, sample: NDArray[np.int64], acceleration: FloatArray) -> None:
    for k in range(len(sample)):
        i = sample[k]
        ax = ay = az = 0.0
        for j in range(len(mass)):
            dx, dy, dz = (
                position[j, 0] - position[i, 0],
                position[j, 1] - position[i, 1],
                position[j, 2] - position[i, 2],
            )
            r2 = dx * dx + dy * dy + dz * dz
            s = mass[j] / (r2 * np.sqrt(r2)) if j != i else 0.0
            ax += s * dx
            ay += s * dy
            az += s * dz
        acceleration[k] = ax, ay, az


class Errors:
    """Relative errors of accelerations, at a sample of the bodies."""

    def __init__(self, position: FloatArray, mass: FloatArray) -> None:
        self._sample = np.sort(np.random.default_rng(1).choice(len(mass), min(SAMPLE, len(mass)), replace=False))
        self._exact = np.empty((len(self._sample), 3))
        _exact(position, mass, self._sample, self._exact)

    def of(self, acceleration: FloatArray) -> tuple[float, float]:
        """Return the median and the 99th percentile."""
        off = np.linalg.norm(acceleration[self._sample] - self._exact, axis=1)
        relative = off / np.linalg.norm(self._exact, axis=1)
        return float(np.median(relative)), float(np.percentile(relative, 99))


def opening_angle(
    method: str, position: FloatArray, mass: FloatArray, errors: Errors, median: float, last: float
) -> float:
    """Return the largest opening angle of carom, in steps of 0.005, with no larger errors than these."""
    low, high = 1, 200  # two-hundredths; the errors grow with the angle
    while low < high:
        middle = (low + high + 1) // 2
        found = errors.of(carom_tree(method, position, mass, middle / 200, 2)())
        low, high = (middle, high) if found[0] <= median and found[1] <= last else (low, middle - 1)
    return low / 200


def compare_direct(bodies: list[int], rounds: int) -> list[dict[str, Any]]:
    print(
        f"\n{'direct':>9} {'carom':>10} {'potential':>10} {'2 threads':>10} {'REBOUND':>10} {'ratio':>6} {'pairs/s':>9}"
    )
    rows = []
    for n in bodies:
        position, mass = plummer(n), np.full(n, 1 / n)
        contenders = {
            "carom": carom_direct(position, mass, 1, potential=False),
            "potential": carom_direct(position, mass, 1, potential=True),
            "two threads": carom_direct(position, mass, 2, potential=False),
            "REBOUND": rebound_force(position, mass, "basic"),
        }
        spent = medians(contenders, rounds)
        ratio, rate = spent["REBOUND"] / spent["carom"], n * n / spent["carom"]
        times = " ".join(f"{seconds * 1e3:>8.2f}ms" for seconds in spent.values())
        print(f"{n:>9} {times} {ratio:>5.1f}x {rate:>9.3g}", flush=True)
        rows.append({"bodies": n, "seconds": spent, "ratio": ratio, "pairs_per_second": rate})
    return rows


def compare_trees(
    bodies: list[int], shapes: list[str], peers: list[str], methods: list[str], rounds: int
) -> list[dict[str, Any]]:
    print(f"\n{'trees':>9} {'shape':>8} {'':29} {'median':>8} {'99 %':>8} {'time':>10} {'2 threads':>10} {'ratio':>6}")
    rows = []
    for n in bodies:
        for shape in shapes:
            position, mass = SHAPES[shape](n), np.full(n, 1 / n)
            errors = Errors(position, mass)
            for peer in peers or [""]:
                rows += [_compare_tree(method, shape, position, mass, errors, peer, rounds) for method in methods]
    return rows


def _compare_tree(
    method: str, shape: str, position: FloatArray, mass: FloatArray, errors: Errors, peer: str, rounds: int
) -> dict[str, Any]:
    """Compare with a peer at the peer's error; without a peer, use the error `ENOUGH`."""
    row: dict[str, Any] = {"method": method, "bodies": len(mass), "shape": shape}
    contenders: dict[str, Force] = {}
    limits = np.inf, ENOUGH
    if peer:
        row["peer"], contenders["peer"] = peer_force(peer, shape, position, mass)
        row["peer_error"] = limits = errors.of(contenders["peer"]())
    theta = opening_angle(method, position, mass, errors, *limits)
    contenders["carom"] = carom_tree(method, position, mass, theta, 1)
    contenders["two threads"] = carom_tree(method, position, mass, theta, 2)
    row |= {
        "opening_angle": theta,
        "error": errors.of(contenders["two threads"]()),
        "seconds": medians(contenders, rounds, cold=0),  # they were called for their errors
    }
    seconds = row["seconds"]
    if peer:
        row["ratio"] = seconds["peer"] / seconds["carom"]
        _print_tree(
            row, row["peer"], row["peer_error"], f"{seconds['peer'] * 1e3:>8.1f}ms {'':>10} {row['ratio']:>5.1f}x"
        )
    _print_tree(
        row,
        f"carom, {method}, {theta:g}",
        row["error"],
        f"{seconds['carom'] * 1e3:>8.1f}ms {seconds['two threads'] * 1e3:>8.1f}ms",
    )
    return row


def _print_tree(row: dict[str, Any], name: str, error: tuple[float, float], times: str) -> None:
    print(f"{row['bodies']:>9} {row['shape']:>8}  {name:28} {error[0]:>8.1e} {error[1]:>8.1e} {times}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Gravity beside its peers.")
    parser.add_argument("parts", nargs="*", help="direct, tree; both by default")
    parser.add_argument("--bodies", type=int, nargs="+", default=[])
    parser.add_argument("--shapes", nargs="+", choices=list(SHAPES), default=list(SHAPES))
    parser.add_argument("--peers", nargs="*", choices=CHOICES, default=CHOICES)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--rounds", type=int, default=5)
    chosen = parser.parse_args()
    parts = chosen.parts or ["direct", "tree"]
    if "direct" in parts:
        merge("gravity", {"direct": compare_direct(chosen.bodies or DIRECT_BODIES, chosen.rounds)}, *PEERS)
    if "tree" in parts:
        rows = compare_trees(chosen.bodies or TREE_BODIES, chosen.shapes, chosen.peers, chosen.methods, chosen.rounds)
        merge("gravity", {"tree": rows}, *PEERS)


if __name__ == "__main__":
    main()
