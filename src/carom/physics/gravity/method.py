"""Which way of summing gravity a scene gets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.gravity.direct import DirectGravity
from carom.physics.gravity.tree import TreeGravity
from carom.physics.parallel.thread_team import Team
from carom.plan.features import gravity_method
from carom.scene.schema import Scene


def gravity_of(scene: Scene, mass: NDArray[np.float64], team: Team) -> DirectGravity | TreeGravity | None:
    """Make the gravity of a scene of bodies of mass (n,) kg, or None where nothing pulls."""
    method, gravity = gravity_method(scene), scene.gravity
    if method == "none":
        return None
    if method == "direct":
        return DirectGravity(mass, gravity.constant, gravity.softening, team)
    accuracy = gravity.opening_angle, gravity.quadrupoles
    return TreeGravity(mass, gravity.constant, gravity.softening, *accuracy, team)
