"""Gravity between bodies, by a method of `carom.registry`: direct sum, tree, or fast multipoles.

A method is a module with a function ``make(gravity, mass, team)``, whose arguments are the scene's gravity section, the
masses, (n,) kg, and the team of threads.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from carom import registry
from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.jit.team import Team
from carom.plan.auto import gravity_method
from carom.scene.forces import GRAVITY
from carom.scene.load import Scene


class GravityMethod(Protocol):
    """A method for the gravity between n bodies, with its workspace."""

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the acceleration of every body, (n, 3) m/s²; return the potential energy in joules if requested."""


class MutualGravity:
    """The gravity between all bodies."""

    kind = GRAVITY
    uniform = np.zeros(3)

    def __init__(self, method: GravityMethod) -> None:
        self._method = method

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Write the acceleration; see `Force`. Gravity is always the first force."""
        assert first, "gravity is the first of the forces"
        return self._method.accelerate(position, acceleration, potential) or 0.0


def make(scene: Scene, bodies: Bodies, team: Team) -> MutualGravity:
    """Return the gravity of a scene."""
    method = gravity_of(scene, bodies.mass, team)
    assert method is not None, "the scene requires gravity"
    return MutualGravity(method)


def gravity_of(scene: Scene, mass: FloatArray, team: Team) -> GravityMethod | None:
    """Return the gravity between bodies of mass (n,) kg by the method of a scene; None if there is no gravity."""
    method = gravity_method(scene)
    if method == "none":
        return None
    made: GravityMethod = registry.load("gravity_methods", method)(scene.gravity, mass, team)
    return made
