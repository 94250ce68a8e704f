"""Few bodies in carom and in REBOUND, on one thread: the time of a step, and the times and errors of whole runs.

    python benchmarks/few_bodies.py steps [--repeats N] [--output FILE.json]
    python benchmarks/few_bodies.py errors [--repeats N] [--periods N] [--output FILE.json]

Both programs run the same scenes in turns. Times are medians of the CPU time over the repeats, without the start of the
program.

*steps* is the CPU time of a step of a star and its planets: leapfrog with a constant step; leapfrog with a step by
the shortest time of a pair, which REBOUND does not have; and Gauss–Radau integration compared with IAS15, both at their
defaults.

*errors* compares Gauss–Radau integration with IAS15. The error of a binary is that of its phase, as a time over the
period. It is the root mean square over 24 initial positions on the orbit, since a single run may err little by chance.
For other problems, it is the relative error of the energy, summed in extended precision; for the planets, the root mean
square over nine systems with different phases.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rebound
from numpy.typing import NDArray

from carom.physics.schedule import at
from carom.physics.space import Space
from carom.scene.load import Scene

FloatArray = NDArray[np.float64]

PHASES = np.linspace(0.3, 6.0, 24)  # rad, true anomalies
SYSTEMS = 9  # of planets, each with other phases
AXES = (0.387, 0.723, 1.0, 1.524, 5.203, 9.537, 19.19, 30.07)  # of the planets, in au
MASSES = (1.66e-7, 2.447e-6, 3.04e-6, 3.22e-7, 9.55e-4, 2.86e-4, 4.37e-5, 5.15e-5)  # of the Sun's
COUNTS = (2, 3, 5, 10, 20)
LEAP = 0.006  # of leapfrog: a thousandth of the innermost period, and the fraction of the shortest time of a pair
SPANS = {"leapfrog": 200.0, "gauss-radau15": 3000.0, "ias15": 3000.0}  # of simulated time in a turn

Steps = Callable[[float], float]


class Problem(NamedTuple):
    """Bodies with G = 1."""

    name: str
    mass: FloatArray  # (n,)
    position: FloatArray  # (n, 3)
    velocity: FloatArray  # (n, 3)
    duration: float


class Run(NamedTuple):
    """The result of a run."""

    seconds: float
    steps: int
    position: FloatArray
    velocity: FloatArray


def binary(eccentricity: float, phase: float, periods: float) -> Problem:
    """Put two equal masses on an orbit of semi-major axis 1 and period 2π."""
    p = 1.0 - eccentricity**2
    way = np.array([np.cos(phase), np.sin(phase), 0.0]) * p / (1.0 + eccentricity * np.cos(phase))
    speed = np.array([-np.sin(phase), eccentricity + np.cos(phase), 0.0]) / np.sqrt(p)
    half = np.array([[-0.5], [0.5]])
    return Problem(f"binary, e = {eccentricity:g}", np.full(2, 0.5), half * way, half * speed, 2.0 * np.pi * periods)


def pythagorean(duration: float = 60.0) -> Problem:
    """Put masses 3, 4 and 5 at rest at the corners of a triangle of these sides (Burrau 1913)."""
    position = np.array([[1.0, 3.0, 0.0], [-2.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    return Problem(f"Pythagorean, t = {duration:g}", np.array([3.0, 4.0, 5.0]), position, np.zeros((3, 3)), duration)


def figure_eight(periods: float = 10.0) -> Problem:
    """Let three equal masses chase each other around a figure eight (Chenciner & Montgomery 2000)."""
    end, speed = np.array([0.97000436, -0.24308753, 0.0]), np.array([0.466203685, 0.43236573, 0.0])
    position, velocity = np.array([end, -end, 0.0 * end]), np.array([speed, speed, -2.0 * speed])
    return Problem(f"figure eight, {periods:g} periods", np.ones(3), position, velocity, 6.32591398 * periods)


def planets(periods: float, seed: int = 8) -> Problem:
    """Put the Sun and eight planets on circles at random phases, for so many periods of the innermost."""
    angle = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(AXES))
    ray = np.stack((np.cos(angle), np.sin(angle), 0.02 * np.sin(3.0 * angle)), axis=1)
    ahead = np.stack((-np.sin(angle), np.cos(angle), np.zeros_like(angle)), axis=1)
    axes, mass = np.array(AXES)[:, None], np.array((1.0, *MASSES))
    position = np.vstack((np.zeros(3), axes * ray))
    velocity = np.vstack((np.zeros(3), ahead / np.sqrt(axes)))
    position -= mass @ position / mass.sum()
    velocity -= mass @ velocity / mass.sum()
    return Problem(f"1 + 8 planets, {periods:g} periods", mass, position, velocity, periods * 2.0 * np.pi * 0.387**1.5)


def scene_of(problem: Problem, **time_keys: Any) -> Scene:
    """Write a problem as a scene without checks during the run."""
    rows = zip(problem.mass.tolist(), problem.position.tolist(), problem.velocity.tolist(), strict=True)
    return Scene.from_dict(
        {
            "time": {"duration": problem.duration, "max_dt": 1e9, **time_keys},
            "gravity": {"constant": 1.0},
            "contact": {"enabled": False},
            "record": {"check_every": 1_000_000},
            "body": [{"mass": m, "position": x, "velocity": v, "radius": 1e-9} for m, x, v in rows],
        }
    )


def with_carom(problem: Problem) -> Run:
    """Run a problem with ``gauss-radau15``."""
    space = Space(scene_of(problem, integrator="gauss-radau15"), threads=1)
    began = time.process_time()
    for _ in space.run(schedule=at(())):
        pass
    return Run(time.process_time() - began, space.step, space.state.position.copy(), space.state.velocity.copy())


def rebound_simulation(problem: Problem, integrator: str) -> rebound.Simulation:
    """Set up a problem in REBOUND."""
    simulation = rebound.Simulation()
    simulation.integrator = integrator
    for m, (x, y, z), (vx, vy, vz) in zip(problem.mass, problem.position, problem.velocity, strict=True):
        simulation.add(m=m, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
    return simulation


def with_rebound(problem: Problem) -> Run:
    """Run a problem with IAS15 at its defaults."""
    simulation = rebound_simulation(problem, "ias15")
    began = time.process_time()
    simulation.integrate(problem.duration)
    seconds = time.process_time() - began
    position = np.array([particle.xyz for particle in simulation.particles])
    velocity = np.array([particle.vxyz for particle in simulation.particles])
    return Run(seconds, simulation.steps_done, position, velocity)


def chain(count: int) -> Problem:
    """Put planets of 10⁻⁶ on circles around a star, each a third farther out than the one before."""
    axes = 1.3 ** np.arange(count - 1)[:, None]
    angle = np.random.default_rng(count).uniform(0.0, 2.0 * np.pi, count - 1)
    ray = np.stack((np.cos(angle), np.sin(angle), 0.01 * np.sin(3.0 * angle)), axis=1)
    ahead = np.stack((-np.sin(angle), np.cos(angle), np.zeros_like(angle)), axis=1)
    position, velocity = np.vstack((np.zeros(3), axes * ray)), np.vstack((np.zeros(3), ahead / np.sqrt(axes)))
    return Problem(f"{count} bodies", np.array([1.0] + [1e-6] * (count - 1)), position, velocity, np.inf)


def carom_steps(problem: Problem, **time_keys: Any) -> Steps:
    """Return a function that takes steps of carom and returns the CPU time of one in s."""
    space = Space(scene_of(problem._replace(duration=1e12), **time_keys), threads=1)

    def take(span: float) -> float:
        first, began = space.step, time.process_time()
        for _ in space.run(until=space.time + span, schedule=at(())):
            pass
        return (time.process_time() - began) / (space.step - first)

    return take


def rebound_steps(problem: Problem, integrator: str) -> Steps:
    """Return a function that takes steps of REBOUND and returns the CPU time of one in s."""
    simulation = rebound_simulation(problem, integrator)
    simulation.dt = LEAP

    def take(span: float) -> float:
        first, began = int(simulation.steps_done), time.process_time()
        simulation.integrate(simulation.t + span, exact_finish_time=0)
        return (time.process_time() - began) / (int(simulation.steps_done) - first)

    return take


def measure_steps(repeats: int) -> list[dict[str, Any]]:
    """Return the time of a step in ns for each number of bodies and each integrator."""
    rows = []
    for count in COUNTS:
        problem = chain(count)
        takers = {
            "carom, leapfrog": carom_steps(problem, integrator="leapfrog", fixed_dt=LEAP),
            "carom, adaptive leapfrog": carom_steps(problem, integrator="leapfrog", pull_fraction=LEAP),
            "REBOUND, leapfrog": rebound_steps(problem, "leapfrog"),
            "carom, gauss-radau15": carom_steps(problem, integrator="gauss-radau15"),
            "REBOUND, ias15": rebound_steps(problem, "ias15"),
        }
        taken: dict[str, list[float]] = {name: [] for name in takers}
        for turn in range(repeats + 1):
            for name, take in takers.items():
                spent = take(SPANS[name.split()[-1]])
                if turn:  # the first one loads the kernels
                    taken[name].append(1e9 * spent)
        rows.append({"bodies": count, **{name: statistics.median(times) for name, times in taken.items()}})
    return rows


def print_steps(rows: list[dict[str, Any]]) -> None:
    """Print the time of a step as a table."""
    print("| bodies | leapfrog: carom | REBOUND | ratio | adaptive | gauss-radau15 | IAS15 | ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for row in rows:
        leap, peer = row["carom, leapfrog"], row["REBOUND, leapfrog"]
        radau, ias = row["carom, gauss-radau15"], row["REBOUND, ias15"]
        adaptive = row["carom, adaptive leapfrog"]
        print(
            f"| {row['bodies']} | {leap:.0f} ns | {peer:.0f} ns | {leap / peer:.2f} | {adaptive:.0f} ns | "
            f"{radau / 1e3:.1f} µs | {ias / 1e3:.1f} µs | {radau / ias:.2f} |"
        )


def phase_error(problem: Problem, run: Run) -> float:
    """Return the phase error of a binary after whole periods, as a fraction of the period."""
    apart = (run.position[1] - run.position[0]) - (problem.position[1] - problem.position[0])
    speed = problem.velocity[1] - problem.velocity[0]
    return float(np.linalg.norm(apart) / np.linalg.norm(speed) / (2.0 * np.pi))


def energy(mass: FloatArray, position: FloatArray, velocity: FloatArray) -> Any:
    """Return the energy in extended precision."""
    m, x, v = (values.astype(np.longdouble) for values in (mass, position, velocity))
    total = 0.5 * (m * (v * v).sum(axis=1)).sum()
    for i in range(len(m)):
        for j in range(i):
            total -= m[i] * m[j] / np.sqrt(((x[i] - x[j]) ** 2).sum())
    return total


def energy_error(problem: Problem, run: Run) -> float:
    """Return the relative error of the energy at the end of a run."""
    before = energy(problem.mass, problem.position, problem.velocity)
    return abs(float((energy(problem.mass, run.position, run.velocity) - before) / before))


def compare(problems: list[Problem], error: Callable[[Problem, Run], float], repeats: int) -> dict[str, Any]:
    """Run problems in turns with both, and return medians of the times and the root mean square of the errors."""
    found: dict[str, Any] = {"problem": problems[0].name}
    for name, solve in (("carom", with_carom), ("IAS15", with_rebound)):
        found[name] = {"seconds": [], "errors": [], "steps": 0}
        solve(problems[0]._replace(duration=0.01 * problems[0].duration))  # loads the kernels
    for _ in range(repeats):
        for problem in problems:
            for name, solve in (("carom", with_carom), ("IAS15", with_rebound)):
                run = solve(problem)
                found[name]["seconds"].append(run.seconds)
                found[name]["errors"].append(error(problem, run))
                found[name]["steps"] = run.steps
    for name in ("carom", "IAS15"):
        found[name]["seconds"] = statistics.median(found[name]["seconds"])
        found[name]["error"] = float(np.sqrt(np.mean(np.square(found[name].pop("errors")))))
    return found


def measure_errors(repeats: int, periods: float) -> list[dict[str, Any]]:
    """Return times and errors of whole runs."""
    rows = [
        compare([binary(e, phase, 100.0) for phase in PHASES], phase_error, 1) for e in (0.1, 0.5, 0.9, 0.999, 0.9999)
    ]
    rows += [compare([problem], energy_error, repeats) for problem in (pythagorean(), figure_eight())]
    rows += [
        compare([planets(span, seed) for seed in range(SYSTEMS)], energy_error, 1)
        for span in (periods / 1000, periods / 100, periods / 10, periods)
    ]
    return rows


def print_errors(rows: list[dict[str, Any]]) -> None:
    """Print times and errors as a table."""
    print("| problem | steps: carom, IAS15 | error: carom | IAS15 | time: carom | IAS15 | ratio |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        own, peer = row["carom"], row["IAS15"]
        print(
            f"| {row['problem']} | {own['steps']}, {peer['steps']} | {own['error']:.1e} | {peer['error']:.1e} | "
            f"{own['seconds']:.4f} s | {peer['seconds']:.4f} s | {own['seconds'] / peer['seconds']:.2f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("steps", "errors"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--periods", type=float, default=1e4, help="of the innermost planet")
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    if asked.what == "steps":
        rows = measure_steps(asked.repeats)
        print_steps(rows)
    else:
        rows = measure_errors(asked.repeats, asked.periods)
        print_errors(rows)
    if asked.output:
        asked.output.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
