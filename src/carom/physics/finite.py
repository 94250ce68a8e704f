"""A state that is no longer finite is refused before it is handed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.error import PhysicsError
from carom.physics.kernel import kernel

MOST_NAMES = 5


def refuse_infinities(bodies: Bodies, names: list[str], step: int, time: float) -> None:
    """Check positions and velocities.

    Raises
    ------
    PhysicsError
        If one is infinite or not a number; it names the bodies, the step and the time in seconds.
    """
    if _all_finite(bodies.position, bodies.velocity):
        return
    finite = np.isfinite(bodies.position) & np.isfinite(bodies.velocity)
    lost = np.flatnonzero(~finite.all(axis=1))
    among = ", ".join(f'{body} "{names[body]}"' for body in lost[:MOST_NAMES])
    raise PhysicsError(
        f"the state is no longer finite at step {step}, t = {time:.6g} s: {len(lost)} bodies, among them {among}"
    )


@kernel
def _all_finite(position: NDArray[np.float64], velocity: NDArray[np.float64]) -> bool:
    """Tell whether all numbers are finite: without an array for the answers, which NumPy's way takes three of."""
    lost = 0
    for i in range(len(position)):
        for k in range(3):
            x, v = position[i, k], velocity[i, k]
            lost += (x - x != 0.0) | (v - v != 0.0)  # infinity - infinity is not a number, and none equals 0
    return lost == 0
