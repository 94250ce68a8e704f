"""Moving walls and the images of a sheared box in a step, and their work on the bodies.

`ContactPipeline` calls the methods from `begin` to `settle` in their order. Without moving walls and shear, they do
nothing.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.bodies import Bodies
from carom.physics.contact.moving_walls import work_of_contacts, work_of_impacts
from carom.physics.contact.solids import SolidsWithWalls
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.contact.translating_walls import WallTranslation, work_at_velocities, work_in_drift
from carom.physics.sheared_box import ShearedBox
from carom.scene.start import HalfSpaces

NO_VELOCITIES: FloatArray = np.zeros((0, 3))


class BoundaryMotion:
    """Moves walls through the phases of a step, and sums their work on the bodies.

    A sheared box is given only if contacts last in it. Its work is in `ShearedBox.pop`.
    """

    def __init__(self, bodies: Bodies, solids: HalfSpaces, shear: ShearedBox | None) -> None:
        self._solids, self._shear, self._count = solids, shear, len(bodies)
        self._translation: WallTranslation | None = None
        if isinstance(solids, SolidsWithWalls) and solids.translates:
            moving = solids.records, solids.before, bodies.ends, solids.motions
            guided, smallest = solids.guided, float(bodies.radius.min())
            self._translation = guided.motion(*moving, smallest) if guided else WallTranslation(*moving)
        self._span = 0.0, 0.0  # s, times before and after the step
        self._velocity = NO_VELOCITIES  # (p, 3) m/s, of solids that translate, as they do the present work
        self.work = 0.0  # J, of moving walls on bodies in the step

    def forget(self) -> None:
        """Return to the state before the first step."""
        self.work = 0.0
        if self._translation:
            self._translation.forget()

    @property
    def memory(self) -> FloatArray | None:
        """A copy of the state of the wall that contacts move; None without one."""
        return self._translation.memory if self._translation else None

    def recall(self, memory: FloatArray | None) -> None:
        """Return to an earlier `memory`."""
        if self._translation and memory is not None:
            self._translation.recall(memory)

    def place(self, time: float) -> None:
        """Move walls that translate to their places at a time (s)."""
        if self._translation:
            self._translation.place(time)

    def next_change(self, time: float) -> float:
        """Return when the velocity of a wall next changes after a time, both in s; infinite if it never does."""
        return self._translation.next_change(time) if self._translation else np.inf

    @property
    def longest_step(self) -> float:
        """The longest step (s) that the motion of walls allows; infinite if contacts move none."""
        return self._translation.longest_step if self._translation else np.inf

    @property
    def is_guided(self) -> bool:
        """Whether contacts move a wall."""
        return self._solids.guided is not None

    def set_span(self, before: float, time: float) -> None:
        """Set the times (s) before and after the step, by which walls translate."""
        self._span = before, time

    def begin(self, dt: float, booked: float) -> None:
        """Begin a step with a drift of ``dt`` and a first kick of ``booked``, both in s."""
        self.work = 0.0
        if self._translation:
            self._velocity = self._translation.begin(*self._span, dt, booked)

    def begin_drift(self) -> None:
        """Begin the drift, during which the velocities of walls that translate depend on the time."""
        if self._translation:
            self._translation.begin_drift()

    def add_impacts(self, log: Any) -> None:
        """Add the work in impacts during the drift."""
        surface = self._solids.surface
        if self._solids.rotates:
            self.work += work_of_impacts(log, surface, self._count)
        if self._solids.translates:
            self.work += work_in_drift(log, surface, self._count)

    def arrive(self) -> None:
        """Move walls to the end of the step; bodies still have the velocities of the drift."""
        if self._translation:
            self._translation.arrive(self._span[1])

    def add_corrections(self, solver: ContactSolver, pushed: float) -> None:
        """Add the effect of position corrections, which move a guided wall by a distance along its normal (m)."""
        if self._translation:
            self._translation.push(pushed)
        if self._shear:
            self._shear.add_work_of_corrections(solver.contacts, solver.recorded)

    def finish(self) -> None:
        """Give walls that translate their velocities after the last kick."""
        if self._translation:
            self._translation.finish(self._span[1])

    def accelerate(self) -> None:
        """Give walls that translate the accelerations of the last kick."""
        if self._translation:
            self._velocity = self._translation.accelerate()

    def add_contacts(self, solver: ContactSolver, impulses: RecordArray[Any]) -> None:
        """Add the work in the present contacts, by impulses (m,) of the last kick, or by those of its impacts."""
        if self._shear:
            self._shear.add_work(solver.contacts, impulses)
        if not self._solids.moves:
            return
        touching = solver.system.pairs, cast(RecordArray[Any], solver.contacts), impulses
        if self._solids.rotates:
            self.work += work_of_contacts(*touching, self._solids.surface, self._count)
        if self._solids.translates:
            self.work += work_at_velocities(*touching, self._velocity, self._count)

    def rest(self) -> None:
        """Give the walls no acceleration: the corrections of positions do the work of the bodies' forces only."""
        if self._translation:
            self._translation.rest()

    def settle(self) -> None:
        """End the step: add the work of a wall that contacts move."""
        if self._translation:
            self.work += self._translation.settle()
