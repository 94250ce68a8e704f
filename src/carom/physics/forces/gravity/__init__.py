"""Gravity of the bodies on each other: by a direct sum over all pairs, a tree, or fast multipoles."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.forces.gravity.direct import DirectGravity
from carom.physics.forces.gravity.fast_multipole import FastMultipoleGravity
from carom.physics.forces.gravity.pull import Pull
from carom.physics.forces.gravity.tree import TreeGravity
from carom.physics.jit.thread_team import Team
from carom.plan.auto import gravity_method
from carom.scene.forces import GRAVITY
from carom.scene.schema import Scene


class Gravity:
    """The gravity of all bodies on each other."""

    kind = GRAVITY
    uniform = np.zeros(3)

    def __init__(self, pull: Pull) -> None:
        self._pull = pull

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Write the acceleration; see `Force`. Gravity is always the first force."""
        assert first, "gravity is the first of the forces"
        return self._pull.accelerate(position, acceleration, potential) or 0.0


def make(scene: Scene, bodies: Bodies, team: Team) -> Gravity:
    """Make the gravity of a scene."""
    pull = gravity_of(scene, bodies.mass, team)
    assert pull is not None, "the scene requires gravity"
    return Gravity(pull)


def gravity_of(scene: Scene, mass: FloatArray, team: Team) -> Pull | None:
    """Return the gravity of bodies of mass (n,) kg by the method of a scene; None if there is none."""
    method, gravity = gravity_method(scene), scene.gravity
    if method == "none":
        return None
    if method == "direct":
        return DirectGravity(mass, gravity.constant, gravity.softening, team)
    if method == "fast-multipole":
        return FastMultipoleGravity(mass, gravity.constant, gravity.softening, gravity.opening_angle, team)
    accuracy = gravity.opening_angle, gravity.quadrupoles
    return TreeGravity(mass, gravity.constant, gravity.softening, *accuracy, team)
