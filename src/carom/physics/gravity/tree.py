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
from carom.physics.gravity.multipole import expand
from carom.physics.gravity.walk import pull
from carom.physics.team import SOLO, Team

FloatArray = NDArray[np.float64]

BOXES_AT_A_TIME = 512  # fewer are not worth a part of their own
GROUPS_AT_A_TIME = 4
PIECES = 32  # for each thread, at most: groups take very different times


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
        self._boxes = Boxes(n)
        self._sorted_mass = np.empty(n)
        self._centre = np.empty((self._boxes.most, 4))
        self._moment = np.empty((self._boxes.most, 8))
        self._potential = np.zeros(n)
        self._team = team if n >= PARALLEL_FROM else SOLO
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
        np.take(self._mass, boxes.body, out=self._sorted_mass, mode="clip")
        self._share(boxes.count, BOXES_AT_A_TIME, self._expand)
        into = self._potential if potential else None
        self._share(
            len(boxes.groups) - 1,
            GROUPS_AT_A_TIME,
            lambda who, lo, hi: self._pull(self._workers[who], lo, hi, acceleration, into),
        )
        return potential_energy(self._mass, self._potential) if potential else None

    def _share(self, count: int, at_a_time: int, job: Callable[[int, int, int], None]) -> None:
        """Do a job, called with who does it, lo and hi, on a number of things."""
        pieces = max(1, min(count // at_a_time, PIECES * self._team.size))
        self._team.share(pieces, lambda who, k: job(who, count * k // pieces, count * (k + 1) // pieces))

    def _expand(self, _: int, lo: int, hi: int) -> None:
        boxes = self._boxes
        expand(
            lo,
            hi,
            boxes.first,
            boxes.last,
            boxes.position,
            self._sorted_mass,
            self._opening_angle,
            self._centre,
            self._moment,
        )

    def _pull(self, worker: _Worker, lo: int, hi: int, acceleration: FloatArray, potential: FloatArray | None) -> None:
        boxes = self._boxes
        pull(
            lo,
            hi,
            boxes.groups,
            boxes.count,
            boxes.first,
            boxes.last,
            boxes.skip,
            self._centre,
            self._moment,
            boxes.position,
            self._sorted_mass,
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
