"""Finding and resolving contacts: the search beside SciPy's k-d tree, and the coloured sweeps, on 1 and 2 threads.

    python benchmarks/contacts.py [--bodies 100000 ...] [--rounds 9] [--only search|sweeps|busy]

"Touching" is a jittered lattice of equal spheres in random numbering; "1:100" has radii by a power law of exponent
-3.5; "planet" is one body under 10⁴ pebbles. A sweep visits every contact once, with friction and spin, and includes
its line search. "Busy" runs the sweeps while another process keeps a core busy.
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from carom.physics.bodies import Bodies
from carom.physics.contact.broad_phase.grid import HierarchicalGrid
from carom.physics.contact.graph import colour_contacts, solve_order_of
from carom.physics.contact.law import IMPULSES, materials_of
from carom.physics.contact.pair_list import KdTree
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.jit.team import Team
from carom.scene.matter import PairCoefficients
from carom.scene.start import HalfSpaces, InitialBodies
from measurement import medians, save

FloatArray = NDArray[np.float64]

OPEN = np.zeros(3)
THREADS = (1, 2)
SWEEPS = 8


def touching(n: int) -> tuple[FloatArray, FloatArray]:
    """Place about n equal spheres on a lattice, a little disordered and overlapping, in random order."""
    rng = np.random.default_rng(0)
    side = np.arange(round(n ** (1 / 3)), dtype=np.float64)
    lattice = np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3) * 1.98
    position = lattice + rng.normal(0.0, 0.01, lattice.shape)
    return rng.permutation(position), np.ones(len(position))


def graded(n: int) -> tuple[FloatArray, FloatArray]:
    """Place n spheres at random, radii from 1 to 100 by a power law of exponent -3.5, in a cube filled to 0.4."""
    rng = np.random.default_rng(0)
    radius = (1.0 + rng.random(n) * (100.0**-2.5 - 1.0)) ** (-1.0 / 2.5)
    side = np.cbrt(np.sum(4.0 / 3.0 * np.pi * radius**3) / 0.4)
    return rng.random((n, 3)) * side, radius


def planet(n: int) -> tuple[FloatArray, FloatArray]:
    """Place n pebbles in layers on one large sphere, by a golden spiral, each layer with about 4000 of them."""
    layer, a = 4000, np.pi * (3.0 - np.sqrt(5.0))
    k = np.arange(n) % layer
    z = 1.0 - (2.0 * k + 1.0) / layer
    ring = np.sqrt(1.0 - z * z)
    direction = np.column_stack((ring * np.cos(a * k), ring * np.sin(a * k), z))
    height = 32.0 + 1.9 * (np.arange(n) // layer)
    return np.vstack((np.zeros(3), direction * (height * 0.999)[:, None])), np.append(31.0, np.ones(n))


def solver_of(position: FloatArray, radius: FloatArray, team: Team) -> ContactSolver:
    """Give all contacts of spheres in motion to a solver."""
    n, rng = len(radius), np.random.default_rng(1)
    mass = radius**3
    start = InitialBodies(
        name=[""] * n,
        group=np.zeros(n, dtype=np.int64),
        position=position,
        velocity=rng.standard_normal((n, 3)),
        angular_velocity=rng.standard_normal((n, 3)),
        mass=mass,
        radius=radius,
        inertia=0.4 * mass * radius**2,
        fixed=np.zeros(n, dtype=np.bool_),
    )
    bodies = Bodies.at_start(start, spins=True, torques=True)
    no_planes = HalfSpaces([], np.empty((0, 3)), np.empty(0))
    materials = materials_of(PairCoefficients(np.array([[0.5, 0.6, 0.4]]), n))
    solver = ContactSolver(bodies, no_planes, materials, OPEN, True, team, sweeps=SWEEPS)
    pairs = HierarchicalGrid(radius, OPEN).pairs(position)
    solver.lay(solve_order_of(pairs, colour_contacts(pairs, bodies.ends.inverse_mass)))
    solver.rest_speed[:] = np.inf
    return solver


def holding(solver: ContactSolver) -> Callable[[], object]:
    """Return a function that holds the contacts by a fixed number of sweeps, starting without impulses."""

    def hold() -> None:
        for name in IMPULSES:
            solver.contacts[name] = 0.0
        if solver.hold(1.0, 1.0, 0.0, 0.0, SWEEPS) != SWEEPS:
            raise RuntimeError("the sweeps ended early: that is no measurement")

    return hold


def compare_searches(n: int, rounds: int) -> list[dict[str, Any]]:
    """Time the search of carom, its k-d trees by size class, and one bare cKDTree where radii are equal."""
    rows = []
    for name, scene in (("touching", touching), ("1:100", graded)):
        position, radius = scene(n)
        contenders: dict[str, Callable[[], object]] = {
            f"grid, {threads} threads": _call(HierarchicalGrid(radius, OPEN, Team(threads)), position)
            for threads in THREADS
        }
        contenders["k-d trees by size"] = _call(KdTree(radius, OPEN), position)
        if name == "touching":
            contenders["cKDTree"] = _tree(position)
        found = len(HierarchicalGrid(radius, OPEN).pairs(position))
        times = medians(contenders, rounds)
        rows.append({"scene": name, "bodies": len(radius), "contacts": found, "ms": _rounded(times, 1e3)})
        print(f"search {name:>9} {len(radius):>8} bodies {found:>8} contacts  {rows[-1]['ms']} ms", flush=True)
    return rows


def time_sweeps(name: str, position: FloatArray, radius: FloatArray, rounds: int) -> dict[str, Any]:
    """Time the sweeps on each number of threads, per contact and sweep."""
    solvers = {threads: solver_of(position, radius, Team(threads)) for threads in THREADS}
    times = medians({f"{threads} threads": holding(solver) for threads, solver in solvers.items()}, rounds)
    order = solvers[1].order
    m = len(order.pairs)
    row = {"scene": name, "bodies": len(radius), "contacts": m, "stages": len(order.edges) - 1}
    row["overflow"] = int(m - order.pieces[order.edges[order.independent] - 1, 1])
    row["ns"] = _rounded(times, 1e9 / (SWEEPS * m))
    print(f"sweeps {row}", flush=True)
    return row


def _call(search: HierarchicalGrid | KdTree, position: FloatArray) -> Callable[[], object]:
    return lambda: search.pairs(position)


def _tree(position: FloatArray) -> Callable[[], object]:
    return lambda: cKDTree(position).query_pairs(2.0, output_type="ndarray")


def _rounded(times: dict[str, float], unit: float) -> dict[str, float]:
    return {name: float(f"{seconds * unit:.4g}") for name, seconds in times.items()}


def _keep_busy() -> None:
    while True:
        pass


def time_beside_a_busy_process(n: int, rounds: int) -> dict[str, Any]:
    """Time the sweeps on two threads, alone and while another process computes."""
    alone = time_sweeps("touching", *touching(n), rounds)
    process = multiprocessing.Process(target=_keep_busy, daemon=True)
    process.start()
    try:
        beside = time_sweeps("touching, beside a busy process", *touching(n), rounds)
    finally:
        process.terminate()
    return {"alone": alone, "beside": beside, "slowdown": beside["ns"]["2 threads"] / alone["ns"]["2 threads"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", type=int, nargs="+", default=[33_000, 330_000])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--only", choices=("search", "sweeps", "busy"))
    given = parser.parse_args()
    if given.only in (None, "search"):
        save("search", {"rows": compare_searches(100_000, given.rounds)}, "scipy")
    if given.only in (None, "sweeps"):
        rows = [time_sweeps("touching", *touching(n), given.rounds) for n in given.bodies]
        rows.append(time_sweeps("planet", *planet(10_000), given.rounds))
        save("sweeps", {"sweeps": SWEEPS, "rows": rows})
    if given.only in (None, "busy"):
        save("busy", time_beside_a_busy_process(100_000, given.rounds))


if __name__ == "__main__":
    main()
