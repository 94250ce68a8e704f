"""MuJoCo: rigid bodies with soft contacts.

MuJoCo has no coefficient of restitution. A contact is a damped spring. Its stiffness and damping follow from the
scene's coefficient of restitution and a bounce of `BOUNCE` steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from carom import Scene
from carom.arrays import IntArray
from carom.extend import Coefficients, engine_package
from carom.lab.compared_run import Setting
from carom.lab.engines.stepped import EngineSimulation, SteppedEngine, dt_of, problem_of
from carom.record import Source, State
from carom.record import mujoco as source_of

BOUNCE = 20.0  # steps that a bounce takes: the spring must be resolved
IMPEDANCE = 0.99  # of a contact; 1 would be rigid, which MuJoCo does not allow


class MuJoCo(SteppedEngine):
    """Runs scenes with MuJoCo's default integrator and solver."""

    name = "mujoco"
    package = "mujoco"
    distribution = "mujoco"

    def check(self, scene: Scene) -> None:
        """Raise ExperimentError if MuJoCo cannot represent a scene."""
        problem_of(self.name, scene)

    def notes(self, scene: Scene) -> list[str]:
        """Describe the differences of the translated scene."""
        found = [f"contacts are springs that bounce in {BOUNCE:g} steps"]
        return found + (["one coefficient of friction, the kinetic"] if _has_friction(scene) else [])

    def begin(self, scene: Scene, setting: Setting) -> EngineSimulation:
        """Build a scene at its start."""
        engine, problem, dt = engine_package(self.package), problem_of(self.name, scene), dt_of(setting)
        spec = engine.MjSpec()
        spec.option.timestep = dt
        spec.option.gravity = problem.field
        spec.option.cone = engine.mjtCone.mjCONE_ELLIPTIC
        spec.memory = 1 << 28
        if not problem.collides:
            spec.option.disableflags |= engine.mjtDisableBit.mjDSBL_CONTACT
        for k, normal in enumerate(problem.planes.normal):
            place = problem.planes.offset[k] * normal
            plane = spec.worldbody.add_geom(
                type=engine.mjtGeom.mjGEOM_PLANE, pos=place, quat=_turn(normal), size=[0.0, 0.0, 1.0]
            )
            plane.name = problem.planes.name[k]
            plane.priority = 1  # its own coefficients count
            _set_law(plane, problem.at_planes[k], dt)
        start = problem.start
        alike = len(set(start.name)) < len(start.name)
        names = [f"{name} {k}" for k, name in enumerate(start.name)] if alike else start.name
        for k in range(len(start.mass)):
            body = spec.worldbody.add_body(pos=start.position[k], name=names[k])
            if not start.fixed[k]:
                body.add_freejoint()
            ball = body.add_geom(
                type=engine.mjtGeom.mjGEOM_SPHERE, size=[start.radius[k], 0.0, 0.0], mass=float(start.mass[k])
            )
            _set_law(ball, problem.between, dt)
        model = spec.compile()
        data = engine.MjData(model)
        moving = np.flatnonzero(~start.fixed)
        data.qvel[:] = np.concatenate((start.velocity[moving], start.angular_velocity[moving]), axis=1).ravel()
        source: Source = source_of(model, data)
        if start.fixed.any():
            source = _InOrder(source, np.argsort(np.argsort(start.fixed, kind="stable")), names)
        return EngineSimulation(source, lambda: engine.mj_step(model, data), dt)


class _InOrder:
    """A source with its bodies in the order of the scene; MuJoCo puts fixed bodies at the end, without names.

    Parameters
    ----------
    place
        (n,) where the bodies of the scene are in the source.
    names
        Of the bodies of the scene.
    """

    def __init__(self, source: Source, place: IntArray, names: Sequence[str]) -> None:
        self._source, self._place = source, place
        model = source.model
        by_body = ("mass", "radius", "inertia", "fixed", "judged")
        own: dict[str, Any] = {name: np.asarray(getattr(model, name))[place] for name in by_body}
        self.model = replace(model, names=names, **own)

    def state(self) -> State:
        """Return the present state."""
        found, place = self._source.state(), self._place
        turn, spin = found.orientation[place], found.angular_velocity[place]
        return State(found.time, found.position[place], found.velocity[place], turn, spin)


def _set_law(geom: Any, law: Coefficients, dt: float) -> None:
    """Set the friction of a shape, and the spring that reproduces the coefficient of restitution."""
    # x'' + 2 ζ ω x' + ω² x = 0 bounces with e = exp(-π ζ / √(1 - ζ²)) after the time π / (ω √(1 - ζ²))
    if law.restitution > 0.0:
        logarithm = math.log(law.restitution)
        damping = -logarithm / math.sqrt(math.pi**2 + logarithm**2)
    else:
        damping = 1.0
    frequency = math.pi / (BOUNCE * dt * math.sqrt(max(1.0 - damping**2, 0.05)))
    geom.solref = [-(frequency**2), -2.0 * damping * frequency]
    geom.solimp = [IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0]
    geom.friction = [law.kinetic_friction, 0.0, 0.0]
    geom.condim = 3 if law.kinetic_friction > 0.0 else 1


def _turn(normal: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    """Return the quaternion, wxyz, that rotates z into a normal."""
    w, axis = 1.0 + normal[2], np.cross([0.0, 0.0, 1.0], normal)
    if w < 1e-12:
        return [0.0, 1.0, 0.0, 0.0]
    length = math.sqrt(w * w + float(axis @ axis))
    return [w / length, *(axis / length).tolist()]


def _has_friction(scene: Scene) -> bool:
    return scene.contact.static_friction > 0.0
