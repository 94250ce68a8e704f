"""The time of a whole step of colliding spheres in carom, REBOUND and MuJoCo, and its growth from 10⁴ to 10⁶ bodies.

    python benchmarks/step.py [--only peers|scaling|gravity] [--bodies 1000 4000 ...] [--rounds 7]

Elastic spheres of radius 1 m with 1 m/s, in a cube of disordered lattice sites filled to 0.3, steps of 0.02 s, no
gravity, impacts at the end of the step. The engines differ. REBOUND ("hardsphere", search by tree or direct, leapfrog)
has neither spin nor friction, and resolves each pair once a step; carom sweeps until nothing closes. They are compared
in open space, where the crowd expands slowly. MuJoCo has springs instead of impulses, so that a collision is a contact
for some steps, and solves for all contacts at once (CG). It is compared within walls. carom has no friction beside
REBOUND and friction 0.5 beside MuJoCo. Contacts are those of the last step. With `gravity`, the crowd contracts by its
own gravity (tree, lasting contacts).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import rebound
from numpy.typing import NDArray

from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.team import Team
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.scene.start import InitialBodies
from measurement import forget_peak, medians, peak_megabytes, save

FloatArray = NDArray[np.float64]

SPACING, DT, STEPS = 2.4, 0.02, 20  # lattice sites a side apart: a filling of 0.30
LATE = {"timing": "end-of-step"}  # as the peers do; by default carom uses times of impact
PULL = 1e-3  # m³ kg⁻¹ s⁻²: a free fall of the crowd takes a minute
SOFT = 2.0e3  # N/m for each kg, MuJoCo's springs: a collision takes some four steps


def crowd(n: int) -> tuple[FloatArray, FloatArray, float]:
    """Return about n positions within a cube, their velocities, and its side."""
    rng = np.random.default_rng(0)
    k = round(n ** (1 / 3))
    sites = (np.stack(np.meshgrid(*[np.arange(k)] * 3), axis=-1).reshape(-1, 3) - 0.5 * (k - 1)) * SPACING
    position = rng.permutation(sites + rng.uniform(-0.19, 0.19, sites.shape))
    return position, rng.standard_normal(position.shape) / np.sqrt(3.0), k * SPACING


def in_carom(n: int, walls: bool, friction: float, threads: int) -> Space:
    position, velocity, side = crowd(n)
    bodies = [{"position": list(x), "velocity": list(v), "mass": 1.0} for x, v in zip(position, velocity, strict=True)]
    scene = {
        "body": bodies,
        "gravity": {"constant": 0.0},
        "contact": {"restitution": 1.0, "static_friction": friction, "kinetic_friction": friction, **LATE},
        "domain": {"boundary": "walls", "size": [side] * 3} if walls else {},
        "time": {"duration": 1e6, "fixed_dt": DT},
        "record": {"every": 1e6, "check_every": 10**6},
    }
    return Space(Scene.from_dict(scene), threads)


def in_rebound(n: int, search: str) -> Callable[[], object]:
    position, velocity, side = crowd(n)
    simulation = rebound.Simulation()
    simulation.integrator, simulation.gravity, simulation.dt = "leapfrog", "none", DT
    simulation.root_size = 4.0 * side
    simulation.boundary = "open"
    simulation.collision, simulation.collision_resolve = search, "hardsphere"
    for (x, y, z), (vx, vy, vz) in zip(position, velocity, strict=True):
        simulation.add(m=1.0, r=1.0, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
    return lambda: simulation.steps(STEPS)


def in_mujoco(n: int) -> tuple[Any, Any, Callable[[], object]]:
    position, velocity, side = crowd(n)
    balls = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/><geom type="sphere" size="1" mass="1"/></body>' for x, y, z in position
    )
    walls = "".join(
        f'<geom type="plane" size="{side} {side} 1" pos="{x * side / 2} {y * side / 2} {z * side / 2}" '
        f'zaxis="{-x} {-y} {-z}"/>'
        for x, y, z in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{DT}" gravity="0 0 0" solver="CG"/><size memory="1G"/>'
        f'<default><geom condim="3" friction="0.5 0 0" solref="-{SOFT} 0"/></default>'
        f"<worldbody>{walls}{balls}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel.reshape(-1, 6)[:, :3] = velocity
    return model, data, lambda: mujoco.mj_step(model, data, nstep=STEPS)


def stepping(space: Space, steps: int = STEPS) -> Callable[[], object]:
    def go() -> None:
        for _ in range(steps):
            space.compute_dynamics(space.step + 1)

    return go


def compare_peers(n: int, rounds: int) -> list[dict[str, Any]]:
    rows = []
    for peer in ("REBOUND", "MuJoCo"):
        contenders: dict[str, Callable[[], object]] = {}
        walls, friction = (False, 0.0) if peer == "REBOUND" else (True, 0.5)
        spaces = {threads: in_carom(n, walls, friction, threads) for threads in (1, 2)}
        for threads, space in spaces.items():
            contenders[f"carom, {threads} threads"] = stepping(space)
        counted = {}
        if peer == "REBOUND":
            contenders["REBOUND, tree"] = in_rebound(n, "tree")
            if n <= 4096:
                contenders["REBOUND, direct"] = in_rebound(n, "direct")
        else:
            _, data, contenders["MuJoCo"] = in_mujoco(n)
        times = medians(contenders, rounds, budget=25.0)
        counted["carom"] = len(spaces[1].contacts)
        if peer == "MuJoCo":
            counted["MuJoCo"] = int(data.ncon)
        step = {name: float(f"{seconds / STEPS * 1e3:.4g}") for name, seconds in times.items()}
        rows.append({"peer": peer, "bodies": len(spaces[1].state), "contacts": counted, "ms": step})
        print(rows[-1], flush=True)
    return rows


def measure_scaling(sizes: list[int], rounds: int, constant: float = 0.0) -> dict[str, Any]:
    """Time steps of crowds in open space, which expand slowly, and fit the exponent of the time over their size."""
    rows: list[dict[str, Any]] = []
    for n in sizes:
        forget_peak()
        spaces = {threads: in_open_space(n, threads, constant) for threads in (1, 2)}
        steps = max(4, min(STEPS, 2_000_000 // n))
        contenders = {f"{threads} threads": stepping(space, steps) for threads, space in spaces.items()}
        bare = {f"bare loop, {threads} threads": bare_loop(threads) for threads in spaces}
        times = medians(contenders | bare, rounds, 20.0)
        step = {name: float(f"{times[name] / steps * 1e3:.4g}") for name in contenders}
        one, two = (times[name] for name in bare)
        parts = spaces[1].profile.seconds()
        whole = sum(parts.values())
        rows.append(
            {
                "bodies": n,
                "contacts": len(spaces[1].contacts),
                "ms": step,
                "bare_loop_gain": round(one / two, 2),
                "shares": {part: round(seconds / whole, 3) for part, seconds in parts.items()},
                "peak_megabytes": peak_megabytes(),
            }
        )
        print(rows[-1], flush=True)
    fitted = {
        name: round(float(np.polyfit(np.log(sizes), np.log([row["ms"][name] for row in rows]), 1)[0]), 3)
        for name in rows[0]["ms"]
    }
    print("exponents", fitted)
    return {"rows": rows, "exponent": fitted}


def bare_loop(threads: int) -> Callable[[], object]:
    """Return a loop that needs nothing but cores; its gain from two threads is the largest possible one at present."""
    team, x = Team(threads), np.ones(500_000)
    return lambda: team.divide(len(x), 10_000, _roots, x)


@long_kernel
def _roots(lo: int, hi: int, x: FloatArray) -> None:
    for i in range(lo, hi):
        for _ in range(20):
            x[i] = np.sqrt(x[i] + 1.0)


def in_open_space(n: int, threads: int, constant: float) -> Space:
    """Build a crowd in open space, without the search for free places that a scene of groups begins with."""
    side = round(n ** (1 / 3)) + 1
    position, velocity, _ = crowd(side**3)
    start = InitialBodies(
        name=[""] * n,
        group=np.zeros(n, dtype=np.int64),
        position=position[:n],
        velocity=velocity[:n],
        angular_velocity=np.zeros((n, 3)),
        mass=np.ones(n),
        radius=np.ones(n),
        inertia=np.full(n, 0.4),
        fixed=np.zeros(n, dtype=np.bool_),
    )
    scene = {
        "group": [{"count": n, "radius": 1.0, "velocity": {"dispersion": 1.0}}],
        "gravity": {"constant": constant},
        "contact": {"restitution": 1.0, "static_friction": 0.5, "kinetic_friction": 0.5, **LATE},
        "time": {"duration": 1e6, "fixed_dt": DT},
        "record": {"every": 1e6, "check_every": 10**6},
    }
    space = Space(Scene.from_dict(scene), threads, start)
    for _ in range(5):
        space.compute_dynamics(space.step + 1)
    space.profile.clear()
    return space


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("peers", "scaling", "gravity"))
    parser.add_argument("--bodies", type=int, nargs="+", default=[1000, 4096])
    parser.add_argument("--sizes", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    began = time.perf_counter()
    if given.only in (None, "peers"):
        rows = [row for n in given.bodies for row in compare_peers(n, given.rounds)]
        save("step", {"rows": rows}, "rebound", "mujoco")
    if given.only in (None, "scaling"):
        save("scaling", measure_scaling(given.sizes, given.rounds))
    if given.only in (None, "gravity"):
        save("gravity-step", measure_scaling(given.sizes, given.rounds, PULL))
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
