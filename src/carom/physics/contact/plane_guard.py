"""The guard of planes: no body passes through a plane within a step.

Planes are tested at the positions at the end of a drift. A body that drifts farther than its radius may end behind a
plane. The same may happen to a body with more impacts than a drift resolves, or to a body that a position correction
moves away from a much larger one. If the centre of a body was in front of a plane when the step began and is now behind
it, the body is moved back along the straight line between both positions, to where it first touches a plane. The region
in front of all planes is convex, so this position is in front of each of them, also in a corner. The impact follows at
the end of the step, like any other impact.

The potential of the body changes by -m a·Δx, which is booked as stabilisation, like the energy of a position
correction.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray
from carom.physics.contact.geometry import height_above
from carom.physics.contact.hooks import NO_ENTRIES, OptionalPart, PresentStep
from carom.physics.jit.decorators import long_kernel
from carom.physics.vector import vector

if TYPE_CHECKING:
    from carom.physics.contact.pipeline import ContactPipeline

MIN_BODIES_PER_TASK = 5000
DEPTH = 1e-6  # overlap, in radii, of a body put back on a plane; enough to be detected, too small to be visible
ROUNDING = 8  # units in the last place of the coordinates, added to the overlap `DEPTH`
DEEPEST = 0.5  # largest overlap after a body is put back, in radii, where coordinates are coarse


class PlaneGuard(OptionalPart):
    """Prevents bodies from passing through planes within a step."""

    needs_every_step = False

    def __init__(self, contacts: ContactPipeline) -> None:
        self._contacts, self._bodies, self._planes = contacts, contacts.bodies, contacts.world.planes
        self._start = self._bodies.position.copy()  # m, positions at the beginning of the step
        self._stopped: list[tuple[NDArray[np.intp], FloatArray]] = []  # stopped bodies, and their displacements in m
        self._was_crossed = False  # whether a drift of the step ended behind a plane

    def forget(self) -> None:
        """Return to the state before the first step."""
        self._stopped.clear()

    def prepare(self, step: PresentStep) -> None:
        """Begin a step at the present positions."""
        np.copyto(self._start, self._bodies.position)
        self._stopped.clear()

    def arrive(self, step: PresentStep) -> None:
        """Put back bodies that have passed through a plane during the drift."""
        self._was_crossed = self._stop()

    def corrected(self, step: PresentStep) -> None:
        """Put back bodies that the correction of overlaps has moved through a plane."""
        self._stop()

    def finish(self, step: PresentStep) -> None:
        """Book the energy changes of stopped bodies."""
        if self._stopped:
            self._contacts.ledger_apart = np.concatenate((self._contacts.ledger_apart, self.losses()))

    def is_busy(self) -> bool:
        """Whether a body was put back in the last step."""
        return bool(self._stopped)

    def warnings(self) -> Iterable[str]:
        """Return a warning if a body would have passed through a plane in the drift of the last step."""
        if self._was_crossed:
            longer = "" if self._contacts.world.exact else ' or set contact.timing = "time-of-impact"'
            yield (
                "A body would have passed through a plane within one step and was stopped where it touched the plane; "
                f"try a shorter step (time.fixed_dt, time.cfl){longer}."
            )

    def _stop(self) -> bool:
        """Put back bodies that have passed through a plane since the step began; return whether there were any."""
        position, planes = self._bodies.position, self._planes
        is_behind = np.zeros(1, dtype=np.bool_)
        tested = (position, planes.surface, planes.offset, is_behind)
        self._contacts.team.divide(len(position), MIN_BODIES_PER_TASK, mark_behind, *tested)
        if not is_behind[0]:
            return False
        crossed = (self._planes.heights(position) < 0.0) & (self._planes.heights_before(self._start) >= 0.0)
        stopped = np.flatnonzero(crossed.any(axis=1))
        if len(stopped) == 0:  # a body that is behind a plane now was already behind it at the start
            return False
        places = self._first_touch(stopped, crossed[stopped])
        self._stopped.append((stopped, places - position[stopped]))
        position[stopped] = places
        return True

    def losses(self) -> FloatArray:
        """Return the energy changes of stopped bodies, (k, 3) J, at the present accelerations."""
        rows = [NO_ENTRIES]
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
            with np.errstate(invalid="ignore", divide="ignore"):  # planes that were not crossed give invalid values
                fraction = np.where(crossed, (before - (radius - depth)[:, None]) / (before - after), 1.0).min(axis=1)
        places: FloatArray = start + np.clip(fraction, 0.0, 1.0)[:, None] * (end - start)
        lost = ((self._planes.heights(places) < 0.0) & (before >= 0.0)).any(axis=1)
        places[lost] = start[lost]  # bodies with a radius of only a few units in the last place, which rounding moved
        return places

    def _fraction_before_walls(
        self, start: FloatArray, end: FloatArray, crossed: BoolArray, touching: FloatArray
    ) -> FloatArray:
        """Return the fraction of each path, (k,), on which the body stays at least ``touching`` m from crossed walls.

        The fraction is found by bisection, since the distance from a curved wall is not linear along the path.
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
