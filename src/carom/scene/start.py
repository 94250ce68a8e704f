"""`Start`: the bodies at time 0, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.scene.wording import joined


@dataclass(frozen=True)
class InitialBodies:
    """The bodies at time 0, explicit ones first, then those from data, then the groups, in order; SI units."""

    name: Sequence[str]
    group: IntArray  # (n,) index of the group; -1 for explicit bodies, -2, -3 … for those of each [[bodies]]
    position: FloatArray  # (n, 3)
    velocity: FloatArray  # (n, 3)
    angular_velocity: FloatArray  # (n, 3)
    mass: FloatArray  # (n,)
    radius: FloatArray  # (n,)
    inertia: FloatArray  # (n,)
    fixed: BoolArray  # (n,)


def join(parts: list[InitialBodies]) -> InitialBodies:
    """Return the bodies of all parts, in order."""

    def stacked(key: str) -> FloatArray:
        return np.ascontiguousarray(np.concatenate([getattr(part, key) for part in parts]))

    return InitialBodies(
        name=joined([part.name for part in parts]),
        group=np.concatenate([part.group for part in parts]),
        position=stacked("position"),
        velocity=stacked("velocity"),
        angular_velocity=stacked("angular_velocity"),
        mass=stacked("mass"),
        radius=stacked("radius"),
        inertia=stacked("inertia"),
        fixed=np.concatenate([part.fixed for part in parts]),
    )
