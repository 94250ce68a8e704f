"""Planes in the broad phase: the bodies that touch them, and a guard that lets no body pass through one within a step.

Planes are tested at the positions at the end of a drift. A body that drifts farther than its radius may end behind a
plane. The same may happen to a body with more impacts than a drift resolves, or to a body that a position correction
moves away from a much larger one. If the centre of a body was in front of a plane when the step began and is now behind
it, the body is moved back along the straight line between both positions, to where it first touches a plane. The region
in front of all planes is convex, so this position is in front of each of them, also in a corner. The impact follows at
the end of the step, like any other.

The potential of the body changes by -m a·Δx, which is booked as stabilisation, as for a position correction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.bodies import Bodies
from carom.physics.contact.broad_phase.pairs import BLOCK, BlockRecord, close_up
from carom.physics.contact.geometry import height_above
from carom.physics.contact.graph import first_of
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.instructions import from_front
from carom.physics.jit.team import Team
from carom.physics.vector import vector
from carom.scene.start import HalfSpaces

BODIES_PER_BLOCK = 1024
MIN_BLOCKS_PER_TASK = 1
MIN_BODIES_PER_TASK = 5000  # bodies per task of the guard
DEPTH = 1e-6  # of the radius: overlap of a body put back on a plane; enough to be detected, too small to be visible
ROUNDING = 8  # units in the last place of the coordinates, added to that overlap
DEEPEST = 0.5  # of the radius: upper limit of that overlap where coordinates are coarse


class PlaneSearch:
    """Adds the contacts (i, n + k) of bodies with planes k, and drops contacts of two fixed bodies."""

    def __init__(self, radius: FloatArray, inverse_mass: FloatArray, planes: HalfSpaces, team: Team) -> None:
        self._radius, self._inverse_mass, self._planes, self._team = radius, inverse_mass, planes, team

    def merged(self, pairs: IntArray, position: FloatArray, scale: float, skin: float) -> IntArray:
        """Return the pairs merged with those of bodies and planes, (m, 2) sorted by (i, j)."""
        n, p, team = len(self._radius), len(self._planes), self._team
        blocks = np.empty(-(-n // BODIES_PER_BLOCK), dtype=BLOCK)
        merged = np.empty((len(pairs) + n * p, 2), dtype=np.int64)
        spheres, planes = (position, self._radius, self._inverse_mass), (self._planes.surface, self._planes.offset)
        team.divide(len(blocks), MIN_BLOCKS_PER_TASK, _merge, pairs, spheres, planes, (scale, skin), merged, blocks)
        return close_up(merged, blocks, team)


@long_kernel
def _merge(
    lo: int,
    hi: int,
    pairs: IntArray,
    spheres: tuple[FloatArray, FloatArray, FloatArray],
    planes: tuple[FloatArray, FloatArray],
    nearness: tuple[float, float],
    merged: IntArray,
    blocks: RecordArray[BlockRecord],
) -> None:
    """Merge the pairs of the blocks [lo, hi) of bodies; each block has space for all its possible pairs."""
    (position, radius, inverse_mass), (normal, offset), (scale, skin) = spheres, planes, nearness
    c = from_front(first_of(lo * BODIES_PER_BLOCK, pairs))
    for block in range(from_front(lo), hi):
        begin = c + block * BODIES_PER_BLOCK * len(offset)
        m = begin
        for i in range(block * BODIES_PER_BLOCK, min(len(radius), (block + 1) * BODIES_PER_BLOCK)):
            while c < len(pairs) and pairs[c, 0] == i:
                if inverse_mass[i] + inverse_mass[pairs[c, 1]] > 0.0:
                    merged[m, 0], merged[m, 1] = i, pairs[c, 1]
                    m += 1
                c += 1
            if inverse_mass[i] == 0.0:
                continue
            for k in range(len(offset)):
                x, y, z = vector(position, i)
                if height_above(normal, offset, k, x, y, z) <= radius[i] * scale + skin:
                    merged[m, 0], merged[m, 1] = i, len(radius) + k
                    m += 1
        blocks[block].begin, blocks[block].count = begin, m - begin


class PlaneGuard:
    """Prevents bodies from passing through planes within a step."""

    def __init__(self, bodies: Bodies, planes: HalfSpaces, team: Team) -> None:
        self._bodies, self._planes, self._team = bodies, planes, team
        self._start = bodies.position.copy()  # m, at the beginning of the step
        self._stopped: list[tuple[NDArray[np.intp], FloatArray]] = []  # bodies, and their displacements in m

    def remember(self) -> None:
        """Begin a step at the present positions."""
        np.copyto(self._start, self._bodies.position)
        self._stopped.clear()

    def stop(self) -> bool:
        """Put back bodies that have passed through a plane since the step began; return whether there were any."""
        position, planes = self._bodies.position, self._planes
        is_behind = np.zeros(1, dtype=np.bool_)
        tested = (position, planes.surface, planes.offset, is_behind)
        self._team.divide(len(position), MIN_BODIES_PER_TASK, mark_behind, *tested)
        if not is_behind[0]:
            return False
        crossed = (self._planes.heights(position) < 0.0) & (self._planes.heights_before(self._start) >= 0.0)
        stopped = np.flatnonzero(crossed.any(axis=1))
        if len(stopped) == 0:  # bodies already behind a plane were behind it at the start
            return False
        places = self._first_touch(stopped, crossed[stopped])
        self._stopped.append((stopped, places - position[stopped]))
        position[stopped] = places
        return True

    @property
    def has_stopped(self) -> bool:
        """Whether a body was put back in this step."""
        return bool(self._stopped)

    def work(self) -> FloatArray:
        """Return the energy changes of stopped bodies, (k, 3) J, at the present accelerations."""
        rows = []
        for stopped, offset in self._stopped:
            a, mass = self._bodies.acceleration[stopped], self._bodies.mass[stopped]
            work = mass * (a[:, 0] * offset[:, 0] + a[:, 1] * offset[:, 1] + a[:, 2] * offset[:, 2])
            rows.append(np.stack((np.zeros_like(work), np.zeros_like(work), -work), axis=1))
        return np.concatenate(rows)

    def _first_touch(self, stopped: NDArray[np.intp], crossed: BoolArray) -> FloatArray:
        """Return the positions where bodies first touched a plane that they crossed, (k, 3) m."""
        start, end, radius = self._start[stopped], self._bodies.position[stopped], self._bodies.radius[stopped]
        start = self._planes.advanced(start, crossed)
        before, after = self._planes.heights(start), self._planes.heights(end)
        largest = np.maximum(np.abs(start).max(axis=1), np.abs(self._planes.offset).max())
        depth = np.minimum(DEEPEST * radius, DEPTH * radius + ROUNDING * np.spacing(largest))
        if self._planes.curves:
            fraction = self._fraction_before_walls(start, end, crossed, radius - depth)
        else:
            with np.errstate(invalid="ignore", divide="ignore"):  # for planes that were not crossed
                fraction = np.where(crossed, (before - (radius - depth)[:, None]) / (before - after), 1.0).min(axis=1)
        places: FloatArray = start + np.clip(fraction, 0.0, 1.0)[:, None] * (end - start)
        lost = ((self._planes.heights(places) < 0.0) & (before >= 0.0)).any(axis=1)
        places[lost] = start[lost]  # due to rounding, if a radius is only a few units in the last place
        return places

    def _fraction_before_walls(
        self, start: FloatArray, end: FloatArray, crossed: BoolArray, touching: FloatArray
    ) -> FloatArray:
        """Return the fraction of each path, (k,), up to which the body is ``touching`` m or more from crossed walls.

        It is found by bisection, since the distance from a curved wall is not linear along the path.
        """
        low, high = np.zeros(len(start)), np.ones(len(start))
        for _ in range(np.finfo(np.float64).nmant):
            middle = 0.5 * (low + high)
            heights = self._planes.heights(start + middle[:, None] * (end - start))
            is_clear = (np.where(crossed, heights, np.inf).min(axis=1)) >= touching
            low, high = np.where(is_clear, middle, low), np.where(is_clear, high, middle)
        return low


@long_kernel
def mark_behind(
    lo: int, hi: int, position: FloatArray, normal: FloatArray, offset: FloatArray, is_behind: BoolArray
) -> None:
    """Set a flag if the centre of one of the bodies [lo, hi) is behind a plane."""
    for k in range(len(offset)):
        for i in range(lo, hi):
            x, y, z = vector(position, i)
            if height_above(normal, offset, k, x, y, z) < 0.0:
                is_behind[0] = True
                return
