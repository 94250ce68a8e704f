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

from carom.physics.kernel import long_kernel
from carom.physics.team import SOLO, Team

FloatArray = NDArray[np.float64]

SOME = 5000  # bodies that are worth a part of their own


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
