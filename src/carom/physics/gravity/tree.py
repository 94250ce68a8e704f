"""Gravity by a tree: a box of bodies that is far enough away pulls as a whole.

`boxes` sorts the bodies, `multipole` sums up the boxes, `walk` decides what is far and adds up the pull. The error is
that of the opening angle (docs/physics.md has it measured), and so is that of the total momentum: the force on a body
and those that it exerts are not opposite. The bits are the same on any processor and number of threads.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from carom.physics.gravity.boxes import GROUP, Boxes
from carom.physics.gravity.direct import PARALLEL_FROM, potential_energy
from carom.physics.gravity.multipole import BOXES_AT_A_TIME, expand
from carom.physics.gravity.walk import pull
from carom.physics.team import SOLO, Team

FloatArray = NDArray[np.float64]

PIECES = 8  # for each thread, at most: between two of them a helper offers its core to other processes


class TreeGravity:
    """Pull and potential of n bodies on each other, with the workspace they need."""

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
        self._centre = np.empty((self._boxes.most, 4))
        self._moment = np.empty((self._boxes.most, 8))
        self._potential = np.zeros(n)
        self._turn = np.zeros(1, np.int64)
        self._workers = [_Worker(n, self._boxes.most) for _ in range(self._team.size)]

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the acceleration of every body; return the potential energy in joules if it is asked for.

        Parameters
        ----------
        position
            (n, 3) m.
        acceleration
            (n, 3) m/s², overwritten.
        potential
            Costs about a tenth more.
        """
        boxes = self._boxes
        boxes.sort(position)
        into = self._potential if potential else None
        self._share(self._expand, boxes.count, BOXES_AT_A_TIME)
        self._share(lambda who, most: self._pull(self._workers[who], most, acceleration, into), len(boxes.groups) - 1)
        return potential_energy(self._mass, self._potential) if potential else None

    def _share(self, job: Callable[[int, int], None], count: int, at_a_time: int = 1) -> None:
        """Share out a number of things, which a job takes in turn; it is called with who does it, and turns at most.

        Whoever is free takes what is next, so that all end at about the same time; with pieces that are cut beforehand
        a tree over 10⁵ bodies took 4 % longer on two threads.
        """
        self._turn[0] = 0
        turns = -(-count // at_a_time)
        pieces = min(turns, PIECES * self._team.size)
        self._team.share(pieces, lambda who, _: job(who, -(-turns // pieces)))

    def _expand(self, _: int, most: int) -> None:
        boxes = self._boxes
        expand(
            self._turn,
            most,
            boxes.count,
            boxes.first,
            boxes.last,
            boxes.position,
            boxes.mass,
            self._opening_angle,
            self._centre,
            self._moment,
        )

    def _pull(self, worker: _Worker, most: int, acceleration: FloatArray, potential: FloatArray | None) -> None:
        boxes = self._boxes
        pull(
            self._turn,
            most,
            boxes.groups,
            boxes.count,
            boxes.first,
            boxes.last,
            boxes.skip,
            self._centre,
            self._moment,
            boxes.position,
            boxes.mass,
            boxes.body,
            self._constant,
            self._softening_squared,
            self._quadrupoles,
            worker.lanes,
            worker.far,
            worker.near,
            acceleration,
            potential,
        )


class _Worker:
    """What one thread needs for its walks: the lanes of a group, and lists of what a walk found."""

    def __init__(self, n: int, boxes: int) -> None:
        self.lanes = np.empty((7, GROUP))
        self.far = np.empty(boxes, np.int64)
        self.near = np.empty((n, 2), np.int64)
