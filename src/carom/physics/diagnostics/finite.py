"""Checks that end a run if its state is no longer finite, or no longer accurate in a periodic box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carom.errors import PhysicsError
from carom.physics.bodies import Bodies
from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.thread_team import SOLO, Team
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.scene.wording import bodies_called

FloatArray = NDArray[np.float64]

MOST_TURNS = 1e6
MIN_NUMBERS_PER_TASK = 30_000


def refuse_infinities(
    bodies: Bodies, names: Sequence[str], step: int, time: float, units: UnitSystem, team: Team = SOLO
) -> None:
    """Refuse a state whose positions or velocities are not all finite.

    Raises
    ------
    PhysicsError
        If one is infinite or not a number; it names the bodies, the step and the time.
    """
    lost = np.zeros(1, dtype=np.bool_)
    numbers = bodies.position.reshape(-1), bodies.velocity.reshape(-1)
    team.divide(len(numbers[0]), MIN_NUMBERS_PER_TASK, _look_for_infinities, *numbers, lost)
    if not lost[0]:
        return
    finite = np.isfinite(bodies.position) & np.isfinite(bodies.velocity)
    bodies_lost = np.flatnonzero(~finite.all(axis=1))
    raise PhysicsError(
        f"the state is no longer finite at step {step}, t = {units.text(time, TIME)}: "
        f"position or velocity of {bodies_called(bodies_lost.tolist(), names)}"
    )


def refuse_lost_turns(
    velocity: FloatArray, dt: float, box: FloatArray, step: int, time: float, units: UnitSystem
) -> None:
    """Refuse a step of dt, in s, in which a body would cross a periodic box too often.

    Its position in the box loses a digit for each factor of 10.

    Raises
    ------
    PhysicsError
        If it is more than `MOST_TURNS` times.
    """
    turns = float((np.abs(velocity).max(axis=0) * dt / box).max())
    if turns > MOST_TURNS:
        when, length = units.text(time, TIME), units.text(dt, TIME, ".3g")
        raise PhysicsError(
            f"at step {step}, t = {when}, a body would cross its periodic box {turns:.3g} times in one step of "
            f"{length}; lower time.fixed_dt or time.max_dt, or the speeds"
        )


@long_kernel
def _look_for_infinities(
    lo: int, hi: int, position: NDArray[np.float64], velocity: NDArray[np.float64], lost: NDArray[np.bool_]
) -> None:
    """Set ``lost`` if one of the numbers [lo, hi) is not finite; NumPy would allocate three arrays for this."""
    x, v, infinities = position[lo:hi], velocity[lo:hi], 0
    for k in range(len(x)):  # from 0, so that it is vectorised
        infinities += (x[k] - x[k] != 0.0) | (v[k] - v[k] != 0.0)  # ∞ - ∞ is NaN, which does not equal 0
    if infinities > 0:
        lost[0] = True
