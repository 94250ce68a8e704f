"""Kicks and drifts, and how each integrator strings them together.

Leapfrog, kick-drift-kick (order 2, symplectic at a constant step):

    v += a(x) dt/2,    x += v dt,    v += a(x) dt/2

Drift-kick-drift is the same with the halves exchanged. On a Kepler orbit its energy swings by a quarter as much, but
its forces are those of the middle of the step: what is held at rest in contact needs those of its end.

Yoshida's fourth order is three leapfrogs of w₁ dt, w₀ dt, w₁ dt with w₁ = 1/(2 - 2^{1/3}), w₀ = 1 - 2 w₁
(Yoshida 1990, Phys. Lett. A 150, 262). Semi-implicit Euler (order 1, symplectic) kicks once, then drifts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]


class Substep(NamedTuple):
    """Parts of dt: a kick with the old forces, a drift, a kick with the new forces."""

    before: float
    drift: float
    after: float


_W1 = 1.3512071919596578  # 1 / (2 - 2^{1/3})
_W0 = 1.0 - 2.0 * _W1

SUBSTEPS: dict[str, tuple[Substep, ...]] = {
    "euler": (Substep(1.0, 1.0, 0.0),),
    "leapfrog": (Substep(0.5, 1.0, 0.5),),
    "leapfrog-dkd": (Substep(0.0, 0.5, 1.0), Substep(0.0, 0.5, 0.0)),
    "yoshida4": tuple(Substep(0.5 * w, w, 0.5 * w) for w in (_W1, _W0, _W1)),
}


def uses_forces_at_end(substeps: tuple[Substep, ...]) -> bool:
    """Tell whether a kick uses the forces at the end of a step: its own last one, or the first of the next step."""
    return substeps[-1].after != 0.0 or substeps[0].before != 0.0


@kernel
def kick(velocity: FloatArray, acceleration: FloatArray, dt: float) -> None:
    """Kick: v += a dt, both (n, 3)."""
    for i in range(len(velocity)):
        velocity[i, 0] += acceleration[i, 0] * dt
        velocity[i, 1] += acceleration[i, 1] * dt
        velocity[i, 2] += acceleration[i, 2] * dt


@kernel
def drift(position: FloatArray, velocity: FloatArray, dt: float) -> None:
    """Drift: x += v dt, both (n, 3)."""
    for i in range(len(position)):
        position[i, 0] += velocity[i, 0] * dt
        position[i, 1] += velocity[i, 1] * dt
        position[i, 2] += velocity[i, 2] * dt


@kernel
def wrap(position: FloatArray, box: FloatArray) -> None:
    """Bring every centre back into the periodic box about the origin."""
    for i in range(len(position)):
        for k in range(3):
            position[i, k] -= box[k] * np.floor(position[i, k] / box[k] + 0.5)


@kernel
def add_field(acceleration: FloatArray, field: FloatArray) -> None:
    """Add a uniform field, (3,) m/s², to accelerations, (n, 3)."""
    for i in range(len(acceleration)):
        for k in range(3):
            acceleration[i, k] += field[k]
