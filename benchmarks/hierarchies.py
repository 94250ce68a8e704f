"""Wisdom–Holman integration in carom and in REBOUND: CPU times and errors of whole runs, on one thread.

    python benchmarks/hierarchies.py [--repeats N] [--periods N] [--output FILE.json]

All integrators run the same scenes in turns. Times are medians of the CPU time over the repeats, without the start of
the program. All steps are a twentieth of the shortest period, except that carom chooses its own in encounters. WHFast
runs at its defaults, and at its fastest with a corrector of order 17. There are two errors: that of the energy, summed
in extended precision, and the largest error of a position relative to a run of ``gauss-radau15``, over the distance
from the dominant body. For an encounter, the table has the largest and the median error of the energy in eight passages
at 0.1 Hill radii from different sides.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rebound
from numpy.typing import NDArray

from carom.physics.integrators.gauss_radau.gauss_radau15 import GaussRadau15
from carom.physics.integrators.gauss_radau.radau_step import motion_of
from carom.physics.schedule import at
from carom.physics.space import Space
from few_bodies import Problem, Run, energy_error, planets, scene_of

FloatArray = NDArray[np.float64]
Solver = Callable[[Problem, float], Run]  # with a step

YEAR = 2.0 * np.pi  # of an orbit of semi-major axis 1, G = M = 1
STEPS = 20.0  # of a period
PASSAGES = 8


def on_orbits(name: str, mass: float, axes: FloatArray, e: FloatArray, duration: float, seed: int) -> Problem:
    """Put bodies of equal masses on orbits about a mass of 1, at places drawn at random."""
    rng, n = np.random.default_rng(seed), len(axes)
    angle, tilt = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(-0.01, 0.01, n)
    p = axes * (1.0 - e * e)
    r = p / (1.0 + e * np.cos(angle))
    place = np.stack((r * np.cos(angle), r * np.sin(angle), r * tilt), axis=1)
    speed = np.stack((-np.sin(angle), e + np.cos(angle), tilt), axis=1) / np.sqrt(p)[:, None]
    masses = np.array([1.0, *[mass] * n])
    position, velocity = np.vstack((np.zeros(3), place)), np.vstack((np.zeros(3), speed))
    position -= masses @ position / masses.sum()
    velocity -= masses @ velocity / masses.sum()
    return Problem(name, masses, position, velocity, duration)


def triple(periods: float) -> Problem:
    """Put two planets of a thousandth of the mass on orbits 1 : 2.2."""
    axes = np.array([1.0, 2.2])
    return on_orbits(f"triple 1 : 1000, {periods:g} periods", 1e-3, axes, np.array([0.05, 0.05]), periods * YEAR, 3)


def disc(periods: float) -> Problem:
    """Put 1000 light bodies on orbits that cross."""
    e: FloatArray = np.random.default_rng(1).uniform(0.0, 0.01, 1000)
    return on_orbits(f"disc of 1000, {periods:g} periods", 1e-9, np.linspace(1.0, 1.999, 1000), e, periods * YEAR, 2)


def encounter(mass: float, seed: int) -> Problem:
    """Let two bodies pass each other at 0.1 Hill radii, 3.3 periods after the start; the run takes twice that."""
    rng = np.random.default_rng(seed)
    ray, ahead = rng.normal(size=(2, 3)) * (1.0, 1.0, 0.2)
    ray /= np.linalg.norm(ray)
    ahead -= ray * (ray @ ahead)
    ahead /= np.linalg.norm(ahead)
    near, masses = 0.1 * np.cbrt(2.0 * mass / 3.0), np.array([1.0, mass, mass])
    speed = np.sqrt(0.05**2 + 4.0 * mass / near)  # 0.05 far from each other
    position, velocity = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 0], [0, 1, 0], [0, 1, 0]])
    position[1:] += np.outer((0.5, -0.5), near * ray)
    velocity[1:] += np.outer((0.5, -0.5), speed * ahead)
    position -= masses @ position / masses.sum()
    velocity -= masses @ velocity / masses.sum()
    velocity *= -1.0
    motion = motion_of(position, velocity, masses, np.zeros(0, np.int64), np.zeros(3), 0.0)
    back = GaussRadau15(motion, 1e9, None)
    back.begin(1e-6)
    back.advance(0.0, 3.3 * YEAR, np.inf, 10**9)
    return Problem(f"encounter of {mass:g} at 0.1 Hill radii", masses, position, -velocity, 6.6 * YEAR)


def with_carom(integrator: str, *, own_step: bool = False, **keys: str) -> Solver:
    """Return a solver that uses an integrator of carom, which may choose its step."""

    def solve(problem: Problem, dt: float) -> Run:
        steps = {} if own_step else {"fixed_dt": dt}
        space = Space(scene_of(problem, integrator=integrator, **steps, **keys), threads=1)
        began = time.process_time()
        for _ in space.run(schedule=at(())):
            pass
        seconds = time.process_time() - began
        return Run(seconds, space.step, space.state.position.copy(), space.state.velocity.copy())

    return solve


def with_rebound(integrator: str, **options: int) -> Solver:
    """Return a solver that uses an integrator of REBOUND."""

    def solve(problem: Problem, dt: float) -> Run:
        simulation = rebound.Simulation()
        for m, (x, y, z), (vx, vy, vz) in zip(problem.mass, problem.position, problem.velocity, strict=True):
            simulation.add(m=m, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
        simulation.integrator = integrator
        for name, value in options.items():
            setattr(simulation.integrator, name, value)
        simulation.dt = dt
        began = time.process_time()
        simulation.integrate(problem.duration)
        seconds = time.process_time() - began
        position = np.array([particle.xyz for particle in simulation.particles])
        velocity = np.array([particle.vxyz for particle in simulation.particles])
        return Run(seconds, simulation.steps_done, position, velocity)

    return solve


WHFAST = {
    "wisdom-holman": with_carom("wisdom-holman"),
    "WHFast": with_rebound("whfast"),
    "WHFast, corrector": with_rebound("whfast", safe_mode=0, corrector=17),
}
LIGHT = {"wisdom-holman": with_carom("wisdom-holman", encounters="ignore"), "WHFast": WHFAST["WHFast"]}
HYBRID = {
    "wisdom-holman": with_carom("wisdom-holman", own_step=True),
    "MERCURIUS": with_rebound("mercurius"),
    "TRACE": with_rebound("trace"),
}


def position_error(problem: Problem, run: Run, exact: Run) -> float:
    """Return the largest error of a position over its distance from the dominant body."""
    found, true = (each.position[1:] - each.position[0] for each in (run, exact))
    return float((np.linalg.norm(found - true, axis=1) / np.linalg.norm(true, axis=1)).max())


def compare(
    problems: list[Problem], dt: float, solvers: dict[str, Solver], repeats: int, *, referred: bool
) -> dict[str, Any]:
    """Run problems in turns with all solvers, and return medians of the times, and the errors."""
    found: dict[str, Any] = {"problem": problems[0].name}
    for name, solve in solvers.items():
        found[name] = {"seconds": [], "energy": [], "position": None}
        solve(problems[0]._replace(duration=3.3 * dt), dt)  # loads the kernels
    for _ in range(repeats):
        for problem in problems:
            for name, solve in solvers.items():
                run = solve(problem, dt)
                found[name]["seconds"].append(run.seconds)
                found[name]["energy"].append(energy_error(problem, run))
                if referred and found[name]["position"] is None:
                    found[name]["position"] = position_error(
                        problem, run, with_carom("gauss-radau15", own_step=True)(problem, 0.0)
                    )
    for name in solvers:
        errors = found[name].pop("energy")
        found[name]["seconds"] = statistics.median(found[name]["seconds"])
        found[name]["energy"], found[name]["median energy"] = max(errors), statistics.median(errors)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--periods", type=float, default=1000.0, help="of the innermost planet")
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    inner = planets(asked.periods)
    rows = [
        compare([inner], inner.duration / asked.periods / STEPS, WHFAST, asked.repeats, referred=True),
        compare([triple(asked.periods)], YEAR / STEPS, WHFAST, asked.repeats, referred=True),
        compare([disc(5.0)], YEAR / STEPS, LIGHT, min(asked.repeats, 3), referred=False),
    ]
    for mass in (1e-3, 1e-5, 3e-6):
        passages = [encounter(mass, seed) for seed in range(PASSAGES)]
        rows.append(compare(passages, YEAR / STEPS, HYBRID, 1, referred=False))
    print("| problem | integrator | time | ratio | energy | position |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        own = row["wisdom-holman"]
        for name, one in row.items():
            if name == "problem":
                continue
            several = f" (median {one['median energy']:.1e})" if row["problem"].startswith("encounter") else ""
            position = "–" if one["position"] is None else f"{one['position']:.1e}"
            print(
                f"| {row['problem']} | {name} | {one['seconds']:.4f} s | {own['seconds'] / one['seconds']:.2f} | "
                f"{one['energy']:.1e}{several} | {position} |"
            )
    if asked.output:
        asked.output.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
