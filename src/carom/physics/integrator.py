"""What an integrator is made of: kicks, drifts, and the wrap into a periodic box. `scene.integrators` has the list."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.thread_team import SOLO, Team

FloatArray = NDArray[np.float64]

SOME = 5000  # bodies that are worth a part of their own


def kick(velocity: FloatArray, acceleration: FloatArray, dt: float, team: Team = SOLO) -> None:
    """Kick: v += a dt, both (n, 3)."""
    team.divide(len(velocity), SOME, _advance, velocity, acceleration, dt)


def drift(position: FloatArray, velocity: FloatArray, dt: float, team: Team = SOLO) -> None:
    """Drift: x += v dt, both (n, 3)."""
    team.divide(len(position), SOME, _advance, position, velocity, dt)


def wrap(position: FloatArray, box: FloatArray, team: Team = SOLO) -> None:
    """Bring every centre back into the periodic box about the origin."""
    team.divide(len(position), SOME, _wrap, position, box)


def add_field(acceleration: FloatArray, field: FloatArray, team: Team = SOLO) -> None:
    """Add a uniform field, (3,) m/s², to accelerations, (n, 3)."""
    team.divide(len(acceleration), SOME, _add, acceleration, field)


@long_kernel
def _advance(lo: int, hi: int, what: FloatArray, rate: FloatArray, dt: float) -> None:
    for i in range(lo, hi):
        what[i, 0] += rate[i, 0] * dt
        what[i, 1] += rate[i, 1] * dt
        what[i, 2] += rate[i, 2] * dt


@long_kernel
def _wrap(lo: int, hi: int, position: FloatArray, box: FloatArray) -> None:
    for i in range(lo, hi):
        for k in range(3):
            position[i, k] -= box[k] * np.floor(position[i, k] / box[k] + 0.5)


@long_kernel
def _add(lo: int, hi: int, acceleration: FloatArray, field: FloatArray) -> None:
    for i in range(lo, hi):
        for k in range(3):
            acceleration[i, k] += field[k]
