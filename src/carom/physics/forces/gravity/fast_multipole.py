"""Gravity by fast multipoles: boxes of bodies pull boxes of bodies, with opposite forces.

`tree_build` sorts the bodies into boxes, `expansions` computes their multipoles, and `box_walk` decides which boxes
pull each other as a whole. The opening angle determines the error (measured in docs/physics.md). Momentum is conserved
to rounding at any opening angle. The bits are the same on any processor and number of threads.

In a ball, an error of 10⁻⁴ takes half of the time that the tree needs (`tree`, where boxes pull bodies). For errors
above 3 × 10⁻³ the tree is faster.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.arrays import FloatArray
from carom.physics.aligned import Room
from carom.physics.forces.gravity.box_walk import ENTRY, Lists, PullLaw, Tree, walk
from carom.physics.forces.gravity.direct import PARALLEL_FROM, potential_energy
from carom.physics.forces.gravity.expansions import BOX, describe, expand
from carom.physics.forces.gravity.taylor import CENTRE, LOCAL, POLES
from carom.physics.forces.gravity.tree_build import RANGE, Boxes
from carom.physics.jit.thread_team import SOLO, Team
from carom.physics.jit.vectors import LANES

DEEPEST = 6400  # boxes within boxes: the sides of a box are halved 2100 times each from the largest float to the least
UNIT_BITS = 300  # lengths are multiplied by 2^k with |k| up to this, so that no power of them overflows


class FastMultipoleGravity:
    """Gravity of n bodies on each other by fast multipoles, with its workspace."""

    def __init__(
        self, mass: FloatArray, constant: float, softening: float, opening_angle: float, team: Team = SOLO
    ) -> None:
        n = len(mass)
        self._mass = mass
        self._constant = constant
        self._softening_squared = softening * softening
        self._angle_squared = opening_angle * opening_angle
        self._team = team if n >= PARALLEL_FROM else SOLO
        self._nested = Boxes(mass, self._team)
        self._boxes, self._poles = Room(BOX), Room(np.float64, POLES)
        self._branches, self._trunk = np.empty(n, RANGE), np.empty(n, RANGE)
        self._potential = np.zeros(n)
        self._turn = np.zeros(1, np.int64)  # how many pieces of work were taken
        size, depth = self._team.size, min(n, DEEPEST) + 2
        self._powers = np.empty((size, LOCAL))
        self._needed = np.zeros(size, np.int64)
        # for each thread; untouched pages take no memory
        self._lists = Lists(
            far=np.empty((size, n + LANES), np.int64),
            near=np.empty((size, n), np.int64),
            opened=np.empty((size, depth), np.int64),
            left=np.empty((size, 2 * n + 2), np.int64),
            entries=np.empty((size, depth), ENTRY),
            local=np.empty((size, depth, LOCAL + 3)),
            expansion=np.empty((size, LOCAL * LANES)),
            powers=self._powers,
            lanes=np.empty((size, 7, LANES)),
        )

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the accelerations; see `Pull`. The energy costs next to nothing."""
        nested = self._nested
        nested.sort(position)
        boxes, poles = self._boxes.take(nested.count), self._poles.take(nested.count + 1)
        order = nested.count, nested.first, nested.last, nested.skip
        branches, above = describe(*order, boxes, self._branches, self._trunk)
        bodies = nested.position, nested.mass
        unit = _unit(nested.position)
        self._expand(branches, self._branches, *bodies, unit, boxes, poles)
        self._expand(above, self._trunk, *bodies, unit, boxes, poles)
        poles[-1] = 0.0
        poles[-1, CENTRE : CENTRE + 3] = nested.position[:, 0] + 8.0 / unit  # apart from all boxes
        tree = Tree(self._branches, boxes, poles, *bodies, nested.body)
        law = PullLaw(self._constant, self._softening_squared, self._angle_squared, unit)
        found = acceleration, self._potential, self._needed
        while True:
            self._turn[0] = self._needed[:] = 0
            self._team.divide(self._team.size, 1, walk, self._turn, branches, tree, law, self._lists, *found)
            if not self._needed.any():
                break
            size, most = self._lists.left.shape
            self._lists = self._lists._replace(left=np.empty((size, 2 * most), np.int64))
        return potential_energy(self._mass, self._potential) if potential else None

    def _expand(self, count: int, ranges: NDArray[np.void], *rest: object) -> None:
        """Compute the multipoles of ranges of boxes; those above the branches in turn, by one thread."""
        team = self._team if ranges is self._branches else SOLO
        self._turn[0] = 0
        team.divide(team.size, 1, expand, self._turn, count, ranges, *rest, self._powers)


def _unit(position: FloatArray) -> float:
    """Return a power of two near the inverse of the largest distance in m; multiplying by it changes no digit."""
    size = float(np.ptp(position, axis=1).max())
    if not 0.0 < size < math.inf:
        return 1.0
    return math.ldexp(1.0, max(-UNIT_BITS, min(UNIT_BITS, -math.frexp(size)[1])))
