"""A uniform field: the same acceleration g for every body.

a = g,    U = -Σ m g·x

Along a periodic axis, the field has no potential, since -m g·x differs on opposite faces. Along such an axis, the
ledger books the work of the field (`carom.physics.forces.force.PathWork`).
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.jit.decorators import kernel, long_kernel
from carom.physics.jit.team import Team
from carom.scene.forces import UNIFORM_FIELD
from carom.scene.load import Scene

MIN_BODIES_PER_TASK = 5000  # bodies for about 10 µs of work


class UniformField:
    """Accelerates all bodies alike; ``driving`` has the components of the field along periodic axes, (3,) m/s² each."""

    kind = UNIFORM_FIELD

    def __init__(self, field: FloatArray, driving: FloatArray, mass: FloatArray, team: Team) -> None:
        self.uniform = field
        self._with_potential = field - driving
        self._mass = mass
        self._team = team

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Add the field; see `Force`."""
        if first:
            acceleration[:] = 0.0
        self._team.divide(len(acceleration), MIN_BODIES_PER_TASK, add, acceleration, self.uniform)
        return _potential_energy(position, self._mass, self._with_potential) if potential else 0.0


def make(scene: Scene, bodies: Bodies, team: Team) -> UniformField:
    """Return the field of a scene."""
    return UniformField(np.array(scene.gravity.uniform), np.array(scene.driving_field), bodies.mass, team)


@long_kernel
def add(lo: int, hi: int, acceleration: FloatArray, uniform: FloatArray) -> None:
    """Add an acceleration, (3,) m/s², to the accelerations of the bodies in [lo, hi)."""
    for i in range(lo, hi):
        for k in range(3):
            acceleration[i, k] += uniform[k]


@kernel
def _potential_energy(position: FloatArray, mass: FloatArray, g: FloatArray) -> float:
    field = 0.0
    for i in range(len(mass)):
        field -= mass[i] * (g[0] * position[i, 0] + g[1] * position[i, 1] + g[2] * position[i, 2])
    return field
