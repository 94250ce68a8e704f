"""PyBullet: rigid bodies with impulses and one coefficient of friction, in double precision.

PyBullet multiplies the coefficients of two bodies. Bodies therefore get the square root of the scene's coefficients,
and a plane the values for which the product equals its own. The damping that PyBullet has by default is switched off.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from carom import Scene
from carom.extend import engine_package
from carom.lab.compared_run import Setting
from carom.lab.engines.stepped import EngineSimulation, SteppedEngine, dt_of, problem_of, refuse
from carom.record import pybullet as source_of

ITERATIONS = 50  # of the solver, its default
_NO_DAMPING = {
    "linearDamping": 0.0,
    "angularDamping": 0.0,
    "rollingFriction": 0.0,
    "spinningFriction": 0.0,
    "contactProcessingThreshold": 0.0,
}


class PyBullet(SteppedEngine):
    """Runs scenes with PyBullet's default solver."""

    name = "pybullet"
    package = "pybullet"
    distribution = "pybullet"

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if PyBullet cannot represent a scene."""
        problem = problem_of(self.name, scene)
        between = problem.between
        bounces = any(plane.restitution > 0.0 for plane in problem.at_planes) and between.restitution == 0.0
        rubs = any(plane.kinetic_friction > 0.0 for plane in problem.at_planes) and between.kinetic_friction == 0.0
        what = "a plane that {} where bodies do not: it multiplies the coefficients"
        refuse(self.name, {what.format("bounces"): bounces, what.format("rubs"): rubs})

    def notes(self, scene: Scene) -> list[str]:
        """Describe the differences of the translated scene."""
        return ["one coefficient of friction, the kinetic"] if scene.contact.static_friction > 0.0 else []

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        engine, problem, dt = engine_package(self.package), problem_of(self.name, scene), dt_of(setting)
        self.check(scene)
        client = engine.connect(engine.DIRECT)
        engine.setTimeStep(dt, client)
        engine.setGravity(*problem.field.tolist(), physicsClientId=client)
        engine.setPhysicsEngineParameter(
            numSolverIterations=ITERATIONS, restitutionVelocityThreshold=0.0, physicsClientId=client
        )
        start, law = problem.start, problem.between
        bounce, rub = math.sqrt(law.restitution), math.sqrt(law.kinetic_friction)
        bodies = []
        for k in range(len(start.mass)):
            ball = engine.createCollisionShape(engine.GEOM_SPHERE, radius=start.radius[k], physicsClientId=client)
            mass = 0.0 if start.fixed[k] else start.mass[k]
            body = engine.createMultiBody(mass, ball, basePosition=start.position[k].tolist(), physicsClientId=client)
            engine.resetBaseVelocity(
                body, start.velocity[k].tolist(), start.angular_velocity[k].tolist(), physicsClientId=client
            )
            engine.changeDynamics(
                body, -1, restitution=bounce, lateralFriction=rub, physicsClientId=client, **_NO_DAMPING
            )
            bodies.append(body)
        for normal, offset, own in zip(problem.planes.normal, problem.planes.offset, problem.at_planes, strict=True):
            shape = engine.createCollisionShape(engine.GEOM_PLANE, planeNormal=normal.tolist(), physicsClientId=client)
            plane = engine.createMultiBody(0.0, shape, basePosition=(offset * normal).tolist(), physicsClientId=client)
            engine.changeDynamics(
                plane,
                -1,
                restitution=own.restitution / bounce if bounce else 0.0,
                lateralFriction=own.kinetic_friction / rub if rub else 0.0,
                physicsClientId=client,
            )
            bodies.append(plane)
        if not problem.collides:
            for one, other in itertools.combinations(bodies, 2):
                engine.setCollisionFilterPair(one, other, -1, -1, 0, physicsClientId=client)
        x, y, z = (float(g) for g in np.asarray(problem.field))
        source = source_of(dt, (x, y, z), client)
        source.model = problem.named(source.model)

        def step() -> None:
            engine.stepSimulation(client)
            source.stepped()

        return EngineSimulation(source, step, dt)
