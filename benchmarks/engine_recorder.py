"""The cost of recording every step of other engines: 1000 spheres that pile up, or that attract each other.

python benchmarks/engine_recorder.py [--every N] [ENGINE …]

Every N-th step is recorded, by default as the source chooses; the column "every" has N.

Times are CPU times of the engine's own thread, by which a run gets longer if another core is free. Other work on the
machine changes them less than wall time. "read" is the time in which the engine returns its state, and "recorder" the
rest of `frame`. Each is a median, with the fastest tenth of the calls in brackets, as on a quiet machine. "threads" is
the time of the recorder's own threads for a frame: audit, encoding and writing.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import carom
from carom.engines.source import BulkSource

BODIES = 1000
RADIUS = 0.1  # m
SETTLING = 150  # steps before the first measurement
MEASURED = 100  # frames

Stepper = tuple[Callable[[], None], Callable[[], Any]]  # one step; the source


def positions() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return a loose block of spheres above a plane, (n, 3) m."""
    side = round(BODIES ** (1 / 3))
    grid = np.array([(i, j, k) for k in range(side) for j in range(side) for i in range(side)], dtype=np.float64)
    return grid * 2.05 * RADIUS + [0.0, 0.0, RADIUS] + np.random.default_rng(1).normal(size=(BODIES, 3)) * 0.01 * RADIUS


def mujoco() -> Stepper:
    import mujoco as engine  # noqa: PLC0415 - only the engines that are asked for

    balls = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/><geom type="sphere" size="{RADIUS}" mass="1"/></body>'
        for x, y, z in positions()
    )
    text = (
        '<mujoco><option timestep="0.002"/><size memory="1G"/>'
        f'<worldbody><geom type="plane" size="0 0 1"/>{balls}</worldbody></mujoco>'
    )
    model = engine.MjModel.from_xml_string(text)
    data = engine.MjData(model)
    return lambda: engine.mj_step(model, data), lambda: carom.record.mujoco(model, data)


def pybullet() -> Stepper:
    import pybullet as engine  # noqa: PLC0415 - only the engines that are asked for

    engine.connect(engine.DIRECT)
    engine.setGravity(0.0, 0.0, -9.81)
    engine.setTimeStep(0.002)
    engine.createMultiBody(0, engine.createCollisionShape(engine.GEOM_PLANE))
    ball = engine.createCollisionShape(engine.GEOM_SPHERE, radius=RADIUS)
    for place in positions():
        engine.createMultiBody(1.0, ball, basePosition=place.tolist())
    return engine.stepSimulation, lambda: carom.record.pybullet(0.002, (0.0, 0.0, -9.81))


def box3d() -> Stepper:
    import robox3d as engine  # noqa: PLC0415 - only the engines that are asked for

    world = engine.World()
    floor = world.create_body(position=(0.0, 0.0, -1.0), kind="static")
    floor.add_box((100.0, 100.0, 1.0))
    for place in positions():
        world.create_body(position=place).add_sphere(RADIUS)
    plane = carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor")
    return lambda: world.step(0.002), lambda: carom.record.box3d(world, (plane,))


def rebound() -> Stepper:
    import rebound as engine  # noqa: PLC0415 - only the engines that are asked for

    simulation = engine.Simulation()
    for x, y, z in positions():
        simulation.add(m=1.0, r=RADIUS, x=x, y=y, z=z)
    simulation.G, simulation.dt, simulation.integrator, simulation.collision = 1e-4, 0.002, "leapfrog", "direct"
    simulation.collision_resolve = "hardsphere"
    return lambda: simulation.steps(1), lambda: carom.record.rebound(simulation)


def newton() -> Stepper:
    import newton as engine  # noqa: PLC0415 - only the engines that are asked for
    import warp  # noqa: PLC0415 - only the engines that are asked for

    builder = engine.ModelBuilder()
    builder.add_ground_plane()
    for place in positions():
        builder.add_shape_sphere(builder.add_body(xform=warp.transform(place, warp.quat_identity())), radius=RADIUS)
    model = builder.finalize(device="cpu")
    solver, pipeline = engine.solvers.SolverXPBD(model), engine.CollisionPipeline(model)
    contacts, control = pipeline.contacts(), model.control()
    states, clock = [model.state(), model.state()], [0.0]

    def step() -> None:
        states[0].clear_forces()
        pipeline.collide(states[0], contacts)
        solver.step(states[0], states[1], control, contacts, 0.002)
        states.reverse()
        clock[0] += 0.002

    return step, lambda: carom.record.newton(model, lambda: (states[0], clock[0]))


ENGINES = {"rebound": rebound, "mujoco": mujoco, "pybullet": pybullet, "box3d": box3d, "newton": newton}


class Clocked:
    """A source whose reading is timed."""

    def __init__(self, source: Any) -> None:
        self.model, self.taken = source.model, list[float]()
        self.state = self._timed(source.state)
        if isinstance(source, BulkSource):
            self.memory, self.read = source.memory, self._timed(source.read)

    def _timed(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any) -> Any:
            began = time.thread_time()
            result = call(*arguments)
            self.taken.append(time.thread_time() - began)
            return result

        return timed


def measured(begin: Callable[[], Stepper], every: int | None, folder: Path) -> tuple[int, list[list[float]], float]:
    """Return the steps per frame, and the times (s) of steps, reading, the rest of `frame`, and other threads."""
    step, make = begin()
    for _ in range(SETTLING):
        step()
    source, steps, frames = Clocked(make()), list[float](), list[float]()
    every = every or source.model.every
    with carom.record.Recorder(source, folder / "run.rrd", every=1, force=True) as recorder:
        step()
        recorder.frame()
        time.sleep(2.0)  # kernels are loaded
        source.taken.clear()
        whole, own = time.process_time(), time.thread_time()
        for _ in range(MEASURED):
            began = time.thread_time()
            for _ in range(every):
                step()
            stepped = time.thread_time()
            recorder.frame()
            frames.append(time.thread_time() - stepped)
            steps.append((stepped - began) / every)
    own = time.thread_time() - own
    reads = [read / every for read in source.taken]
    rest = [frame / every - read for frame, read in zip(frames, reads, strict=True)]
    return every, [steps, reads, rest], (time.process_time() - whole - own) / MEASURED


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--every", type=int, default=None, help="record each so many steps")
    options.add_argument("engines", nargs="*", default=[*ENGINES])
    asked = options.parse_args()
    print(f"{'engine':10}{'every':>6}{'step':>12}{'read':>24}{'recorder':>24}{'share':>16}{'threads':>12}")
    with tempfile.TemporaryDirectory() as folder:
        for name in asked.engines:
            every, (steps, reads, rest), threads = measured(ENGINES[name], asked.every, Path(folder))
            step, shares, row = median(steps), [0.0, 0.0], f"{name:10}{every:6}{median(steps) * 1e3:9.3f} ms"
            for times in (reads, rest):
                usual, least = median(times), sorted(times)[len(times) // 10]
                shares = [shares[0] + usual / step, shares[1] + least / step]
                row += f"{usual * 1e6:10.0f} ({least * 1e6:.0f}) µs".rjust(24)
            row += f"{shares[0]:8.1%} ({shares[1]:.1%})".rjust(16)
            print(f"{row}{threads * 1e3:9.3f} ms", flush=True)


if __name__ == "__main__":
    main()
