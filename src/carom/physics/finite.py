"""A state that is no longer finite is refused before it is handed on."""

from __future__ import annotations

import numpy as np

from carom.physics.bodies import Bodies
from carom.physics.error import PhysicsError

MOST_NAMES = 5


def refuse_infinities(bodies: Bodies, names: list[str], step: int, time: float) -> None:
    """Check positions and velocities.

    Raises
    ------
    PhysicsError
        If one is infinite or not a number; it names the bodies, the step and the time in seconds.
    """
    finite = np.isfinite(bodies.position) & np.isfinite(bodies.velocity)
    if finite.all():
        return
    lost = np.flatnonzero(~finite.all(axis=1))
    among = ", ".join(f'{body} "{names[body]}"' for body in lost[:MOST_NAMES])
    raise PhysicsError(
        f"the state is no longer finite at step {step}, t = {time:.6g} s: {len(lost)} bodies, among them {among}"
    )
