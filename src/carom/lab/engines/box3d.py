"""Box3D through robox3d: rigid bodies with soft contact constraints and substeps, in single precision.

Box3D has no planes. A plane becomes the face of a static box as wide as the bodies can travel. Box3D combines
restitution by the maximum and friction by the geometric mean.
"""

from __future__ import annotations

import math

import numpy as np

from carom import Scene
from carom.extend import engine_package
from carom.lab.compared_run import Setting
from carom.lab.engines.stepped import EngineSimulation, SteppedEngine, dt_of, problem_of, refuse
from carom.record import Plane
from carom.record import box3d as source_of

PACKAGE = "robox3d"
SUBSTEPS = 4  # in a step, the default


class Box3D(SteppedEngine):
    """Runs scenes with Box3D's solver, without sleeping and without a least speed for bounces."""

    name = "box3d"
    package = PACKAGE
    distribution = PACKAGE

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if Box3D cannot represent a scene."""
        problem = problem_of(self.name, scene)
        duller = any(plane.restitution < problem.between.restitution for plane in problem.at_planes)
        slippery = (
            problem.between.kinetic_friction
            == 0.0
            < max((plane.kinetic_friction for plane in problem.at_planes), default=0.0)
        )
        refuse(
            self.name,
            {
                "a plane that bounces less than bodies do: it takes the larger restitution": duller,
                "a plane that rubs where bodies do not: it multiplies the coefficients": slippery,
                "contact.enabled = false": not problem.collides and not scene.contact.enabled,
            },
        )

    def notes(self, scene: Scene) -> list[str]:
        """Describe the differences of the translated scene."""
        found = [f"single precision, {SUBSTEPS} substeps"]
        return found + (["one coefficient of friction, the kinetic"] if scene.contact.static_friction > 0.0 else [])

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        engine, problem, dt = engine_package(PACKAGE), problem_of(self.name, scene), dt_of(setting)
        backend, turns = engine_package(f"{PACKAGE}._ffi", PACKAGE), engine_package(f"{PACKAGE}.math", PACKAGE)
        world = engine.World(gravity=problem.field.tolist(), substeps=SUBSTEPS)
        backend.lib.b3World_SetRestitutionThreshold(world.id, 0.0)
        start, law, planes = problem.start, problem.between, []
        for k in range(len(start.mass)):
            kind = "static" if start.fixed[k] else "dynamic"
            body = world.create_body(position=start.position[k], kind=kind, name=start.name[k])
            density = start.mass[k] / (4.0 / 3.0 * math.pi * start.radius[k] ** 3)
            body.add_sphere(
                float(start.radius[k]),
                density=density,
                friction=law.kinetic_friction,
                restitution=law.restitution,
            )
            if not start.fixed[k]:
                body.linear_velocity, body.angular_velocity = start.velocity[k], start.angular_velocity[k]
        half = problem.reach
        for normal, offset, name, own in zip(
            problem.planes.normal, problem.planes.offset, problem.planes.name, problem.at_planes, strict=True
        ):
            box = world.create_body(position=(offset - half) * normal, rotation=turns.quat_z_to(normal), kind="static")
            friction = own.kinetic_friction**2 / law.kinetic_friction if law.kinetic_friction else 0.0
            box.add_box((half, half, half), friction=friction, restitution=own.restitution)
            x, y, z = (float(component) for component in np.asarray(normal))
            planes.append(Plane((x, y, z), float(offset), name))
        return EngineSimulation(source_of(world, tuple(planes)), lambda: world.step(dt), dt)
