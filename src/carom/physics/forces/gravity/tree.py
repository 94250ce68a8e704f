"""Gravity by a tree: distant boxes of bodies pull as a whole.

`tree_build` sorts the bodies into boxes, `multipole` computes their moments, and `tree_walk` opens near boxes and sums
the accelerations. The opening angle determines the error (measured in docs/physics.md), and that of the total momentum,
because the two forces of a pair are not opposite. The bits are the same on any processor and number of threads.

Threads take the next piece of work until none is left, so all end at about the same time. Pieces assigned beforehand
would be uneven, because crowded bodies take far longer than others.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.aligned import aligned_empty
from carom.physics.forces.gravity.direct import PARALLEL_FROM, potential_energy
from carom.physics.forces.gravity.multipole import CENTRE, MOMENTS, expand
from carom.physics.forces.gravity.tree_build import GROUP, RANGE, Boxes
from carom.physics.forces.gravity.tree_walk import Lists, PullLaw, Tree, pull
from carom.physics.jit.thread_team import SOLO, Team


class TreeGravity:
    """Tree gravity of n bodies on each other, with its workspace."""

    def __init__(
        self,
        mass: FloatArray,
        constant: float,
        softening: float,
        opening_angle: float,
        quadrupoles: bool = True,
        team: Team = SOLO,
    ) -> None:
        n = len(mass)
        self._mass = mass
        self._constant = constant
        self._softening_squared = softening * softening
        self._opening_angle = opening_angle
        self._quadrupoles = quadrupoles
        self._team = team if n >= PARALLEL_FROM else SOLO
        self._boxes = Boxes(mass, self._team)
        self._centres = np.empty(self._boxes.most, CENTRE)
        self._moments = aligned_empty(self._boxes.most, MOMENTS)
        self._potential = np.zeros(n)
        self._turn = np.zeros(1, np.int64)  # how many pieces of work were taken
        size, most = self._team.size, self._boxes.most
        self._lists = Lists(np.empty((size, 7, GROUP)), np.empty((size, most), np.int64), np.empty((size, n), RANGE))

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the accelerations; see `Pull`. The energy costs about a tenth more."""
        boxes, team = self._boxes, self._team
        boxes.sort(position)
        nested = boxes.count, boxes.first, boxes.last
        bodies = boxes.position, boxes.mass
        moments = self._centres, self._moments
        law = PullLaw(self._constant, self._softening_squared, self._quadrupoles)
        found = acceleration, self._potential if potential else None
        self._turn[0] = 0
        team.divide(team.size, 1, expand, self._turn, *nested, *bodies, self._opening_angle, *moments)
        self._turn[0] = 0
        tree = Tree(*nested, boxes.skip, *moments, *bodies, boxes.body, boxes.groups)
        team.divide(team.size, 1, pull, self._turn, tree, law, self._lists, *found)
        return potential_energy(self._mass, self._potential) if potential else None
