"""Newton: rigid bodies by extended position-based dynamics (XPBD), on the processor, in single precision.

Newton combines coefficients of restitution and friction by the mean. Bodies get the coefficients of the scene; a plane
gets the values for which the mean equals its own coefficients. A contact moves bodies only once they overlap.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from carom import Scene
from carom.errors import RecordingError
from carom.extend import Coefficients, engine_package
from carom.lab.compared_run import Setting
from carom.lab.engines.stepped import EngineSimulation, SteppedEngine, dt_of, problem_of
from carom.record import newton as source_of

ITERATIONS = 2  # of the solver in a step, its default


class Newton(SteppedEngine):
    """Runs scenes with Newton's solver XPBD, with its default iterations and relaxation."""

    name = "newton"
    package = "newton"
    distribution = "newton"

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if Newton cannot represent a scene."""
        problem_of(self.name, scene)

    def notes(self, scene: Scene) -> list[str]:
        """Describe the differences of the translated scene."""
        found = [f"single precision, XPBD with {ITERATIONS} iterations"]
        return found + (["one coefficient of friction, the kinetic"] if scene.contact.static_friction > 0.0 else [])

    def ensure_installed(self) -> None:
        """Raise ExperimentError if Newton is not installed; keep Warp from reporting what it loads."""
        with suppress(RecordingError):  # without Warp there is no Newton, which is reported below
            warp = engine_package("warp", "warp-lang")
            warp.config.log_level = warp.LOG_ERROR
        super().ensure_installed()

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        _compile()
        return self._build(scene, dt_of(setting))

    def _build(self, scene: Scene, dt: float) -> EngineSimulation:
        engine, warp = engine_package(self.package), engine_package("warp", "warp-lang")
        problem = problem_of(self.name, scene)
        start, law = problem.start, problem.between
        builder = engine.ModelBuilder(gravity=problem.field.tolist())
        for k in range(len(start.mass)):
            place = warp.transform(start.position[k].tolist(), warp.quat_identity())
            mass, inertia = (0.0, 0.0) if start.fixed[k] else (float(start.mass[k]), float(start.inertia[k]))
            tensor = warp.mat33(np.diag(np.full(3, inertia)))
            body = builder.add_body(xform=place, mass=mass, inertia=tensor, lock_inertia=True, label=start.name[k])
            builder.add_shape_sphere(body, radius=float(start.radius[k]), cfg=_config(engine, law, problem.collides))
        for normal, offset, name, own in zip(
            problem.planes.normal, problem.planes.offset, problem.planes.name, problem.at_planes, strict=True
        ):
            equation = (*normal.tolist(), -float(offset))
            # the mean of this and the bodies' coefficients is the plane's own
            mirrored = Coefficients(*(2.0 * np.array(_numbers(own)) - _numbers(law)).tolist())
            config = _config(engine, mirrored, problem.collides)
            builder.add_shape_plane(plane=equation, width=0.0, length=0.0, cfg=config, label=name)
        model = builder.finalize(device="cpu")
        solver = engine.solvers.SolverXPBD(model, iterations=ITERATIONS, enable_restitution=True)
        pipeline = engine.CollisionPipeline(model)
        contacts, control = pipeline.contacts(), model.control()
        states, steps = [model.state(), model.state()], [0]
        rates = np.concatenate((start.velocity, start.angular_velocity), axis=1)
        rates[start.fixed] = 0.0
        states[0].body_qd.assign(rates.astype(np.float32))

        def step() -> None:
            states[0].clear_forces()
            pipeline.collide(states[0], contacts)
            solver.step(states[0], states[1], control, contacts, dt)
            states.reverse()
            steps[0] += 1

        return EngineSimulation(source_of(model, lambda: (states[0], steps[0] * dt)), step, dt)


@cache
def _compile() -> None:
    """Take a step, so that Warp compiles its kernels before the run: half a minute, once on a machine."""
    ball = {"mass": 1.0, "radius": 0.5}
    bodies = [ball | {"position": [0.0, 0.0, height]} for height in (0.5, 1.5)]
    plane = {"normal": [0.0, 0.0, 1.0], "point": [0.0, 0.0, 0.0]}
    document = {"body": bodies, "plane": [plane], "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}}
    Newton()._build(Scene.from_dict(document), 0.001).step()


def _config(engine: Any, law: Coefficients, collides: bool) -> Any:
    return engine.ModelBuilder.ShapeConfig(
        density=0.0,
        mu=law.kinetic_friction,
        restitution=law.restitution,
        mu_torsional=0.0,
        mu_rolling=0.0,
        has_shape_collision=collides,
    )


def _numbers(law: Coefficients) -> tuple[float, ...]:
    return law.restitution, law.static_friction, law.kinetic_friction
