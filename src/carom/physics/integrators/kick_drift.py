"""Building blocks of the integrators in `scene.integrators`: kick, drift, and wrap into a periodic box."""

from __future__ import annotations

from carom.arrays import FloatArray
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.team import SOLO, Team
from carom.physics.vector import minimum_image

MIN_BODIES_PER_TASK = 5000


def kick(velocity: FloatArray, acceleration: FloatArray, dt: float, team: Team = SOLO) -> None:
    """Kick: v += a dt, both (n, 3)."""
    team.divide(len(velocity), MIN_BODIES_PER_TASK, advance, velocity, acceleration, dt)


def drift(position: FloatArray, velocity: FloatArray, dt: float, team: Team = SOLO) -> None:
    """Drift: x += v dt, both (n, 3)."""
    team.divide(len(position), MIN_BODIES_PER_TASK, advance, position, velocity, dt)


def wrap(position: FloatArray, box: FloatArray, team: Team = SOLO) -> None:
    """Wrap every centre into the periodic box about the origin."""
    team.divide(len(position), MIN_BODIES_PER_TASK, wrap_rows, position, box)


@long_kernel
def advance(lo: int, hi: int, what: FloatArray, rate: FloatArray, dt: float) -> None:
    """Add rate × dt to rows [lo, hi) of (n, 3) arrays."""
    for i in range(lo, hi):
        what[i, 0] += rate[i, 0] * dt
        what[i, 1] += rate[i, 1] * dt
        what[i, 2] += rate[i, 2] * dt


@long_kernel
def wrap_rows(lo: int, hi: int, position: FloatArray, box: FloatArray) -> None:
    """Wrap the centres [lo, hi) into the box."""
    for i in range(lo, hi):
        for k in range(3):
            position[i, k] = minimum_image(position[i, k], box[k])
