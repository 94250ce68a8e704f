"""The work of forces without a potential, along the paths of the bodies.

On a drift from x to x + Δx, with the accelerations a and a' by the force at its ends,

    W = Σ ½ m (a + a')·Δx

which is the work of leapfrog's kicks up to a term that remains bounded. On the solution of an integrator that has one,
Gauss–Legendre quadrature with five nodes integrates

    W = Σ m ∫ a·v dt
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.jit.decorators import kernel

_INNER, _OUTER = sqrt(5.0 - 2.0 * sqrt(10.0 / 7.0)) / 3.0, sqrt(5.0 + 2.0 * sqrt(10.0 / 7.0)) / 3.0
_HEAVY, _LIGHT = (322.0 + 13.0 * sqrt(70.0)) / 900.0, (322.0 - 13.0 * sqrt(70.0)) / 900.0
# nodes and weights in [-1, 1]; of polynomials up to degree 9, the quadrature is exact
QUADRATURE = ((-_OUTER, _LIGHT), (-_INNER, _HEAVY), (0.0, 128.0 / 225.0), (_INNER, _HEAVY), (_OUTER, _LIGHT))


class PathWork:
    """The work of a force in the present step; its entry in the ledger has the sign of a loss: -W.

    ``accelerate`` writes the accelerations by the force, (n, 3) m/s², at positions, (n, 3) m, to its second argument.
    """

    def __init__(self, entry: str, accelerate: Callable[[FloatArray, FloatArray], object], bodies: Bodies) -> None:
        self.entry = entry
        self._accelerate = accelerate
        self._bodies = bodies
        self._start = bodies.position.copy()
        self._before, self._after = np.zeros_like(self._start), np.zeros_like(self._start)
        self._work = 0.0  # J

    def begin(self) -> None:
        """Begin a drift at the present positions."""
        self._start[:] = self._bodies.position
        self._accelerate(self._start, self._before)

    def end(self) -> None:
        """Add the work of the drift since `begin`; to be called before positions are wrapped."""
        position = self._bodies.position
        self._accelerate(position, self._after)
        self._work += _work(self._bodies.mass, self._before, self._after, position - self._start)

    def follow(self, dt: float, solution: Callable[[float], tuple[FloatArray, FloatArray]]) -> None:
        """Add the work of a step of dt seconds, given its solution.

        ``solution`` returns positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the step.
        """
        for node, weight in QUADRATURE:
            position, velocity = solution(0.5 * (1.0 - node) * dt)
            self._accelerate(position, self._after)
            self._work += 0.5 * weight * dt * _work(self._bodies.mass, self._after, self._after, velocity)

    def pop(self) -> float:
        """Return the work of the step in joules, and begin the next step."""
        work, self._work = self._work, 0.0
        return work


@kernel
def _work(mass: FloatArray, before: FloatArray, after: FloatArray, displacement: FloatArray) -> float:
    """Sum ½ m (a + a')·Δx, in J; with velocities in place of displacements, in W."""
    work = 0.0
    for i in range(len(mass)):
        along = 0.0
        for k in range(3):
            along += 0.5 * (before[i, k] + after[i, k]) * displacement[i, k]
        work += mass[i] * along
    return work
