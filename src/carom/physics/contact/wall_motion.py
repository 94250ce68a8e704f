"""Walls in a step: their motion, their work on the bodies, and the limits that they set for the step."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.contact.hooks import LedgerAccount, OptionalPart, PresentStep
from carom.physics.contact.moving_walls import ENTRY, work_of_contacts, work_of_impacts
from carom.physics.contact.solid_records import SolidsWithWalls
from carom.physics.contact.translating_walls import WallTranslation, work_at_velocities, work_in_drift
from carom.state.checkpoint import ContactCheckpoint

if TYPE_CHECKING:
    from carom.physics.contact.pipeline import ContactPipeline

NO_VELOCITIES: FloatArray = np.zeros((0, 3))
# rad, largest turn of a contact's normal in a step if walls alone press. A body with the tangential velocity v moves
# along a chord, and so by the angle arcsin(v dt/f). The relative error of this angle is a sixth of its square, 7 × 10⁻⁵
# of the path.
LARGEST_TURN = 0.02


class MovingWalls(OptionalPart):
    """Moves walls through the phases of a step, and sums their work on the bodies."""

    def __init__(self, contacts: ContactPipeline) -> None:
        bodies, solids = contacts.bodies, contacts.world.planes
        assert isinstance(solids, SolidsWithWalls), "see `carom.plan.step_parts`"
        self._contacts, self._solids, self._count = contacts, solids, len(bodies)
        if solids.rotates and contacts.needs.spin.modelled:
            bodies.ends.angular_velocity[len(bodies) :] = solids.spin
        self._translation: WallTranslation | None = None
        if solids.translates:
            ends = slice(len(solids.owner))  # solids without the trees over facets
            motions = [solids.motions[k] for k in solids.owner]
            moving = solids.records[ends], solids.before[ends], bodies.ends, motions
            guided, smallest = solids.guided, float(bodies.radius.min())
            self._translation = guided.motion(*moving, smallest) if guided else WallTranslation(*moving)
            # 1/kg, inverse masses of the solids; not 0 if contacts move them
            yields = bodies.ends.inverse_mass[len(bodies) :]
            pull = np.sqrt(np.square(bodies.ends.acceleration[len(bodies) :]).sum(axis=1))[yields > 0.0]
            self.pressing_energy = float((pull / yields[yields > 0.0]).sum()) * smallest
        self._velocity = NO_VELOCITIES  # (p, 3) m/s, velocities of translating solids for the computation of their work
        self._work = 0.0  # J, work of moving walls on bodies in the step
        self._held = 0.0  # J, the part of it by the contacts of the first kick
        self.entries = (ENTRY,) if solids.moves else ()

    def forget(self) -> None:
        """Return to the state before the first step."""
        self._work = 0.0
        if self._translation:
            self._translation.forget()

    def remember(self, memory: ContactCheckpoint) -> ContactCheckpoint:
        """Add the state of walls that contacts move."""
        return replace(memory, pistons=self._translation.memory) if self._translation else memory

    def recall(self, memory: ContactCheckpoint) -> None:
        """Return to the state of a checkpoint."""
        if self._translation and memory.pistons is not None:
            self._translation.recall(memory.pistons)

    def place(self, time: float) -> None:
        """Move walls that translate to their places at a time (s)."""
        if self._translation:
            self._translation.place(time)

    def latest_end(self, time: float, adaptive: bool) -> float:
        """Return the time (s) when a wall's velocity next changes, or a piston or a normal would have moved too far."""
        end = self._translation.next_change(time) if self._translation else np.inf
        if not adaptive:
            return end
        turning = self._contacts.solver.turning if self._contacts.presses else 0.0
        longest = self._translation.longest_step if self._translation else np.inf
        return min(end, time + min(longest, LARGEST_TURN / turning if turning > 0.0 else np.inf))

    def book(self, account: LedgerAccount) -> None:
        """Book the work of the step."""
        if self.entries:
            account.book_work(ENTRY, self._work)

    def prepare(self, step: PresentStep) -> None:
        """Place walls at the beginning of the step, with their mean velocities."""
        self._work = 0.0
        if self._translation:
            self._velocity = self._translation.begin(step.before, step.time, step.dt, step.booked)

    def held(self, step: PresentStep) -> None:
        """Add the work of the first kick."""
        self._held = self._work_of(self._contacts.solver.contacts)
        self._work += self._held

    def depart(self, step: PresentStep) -> None:
        """Let the velocities of walls depend on the time in the drift."""
        if self._translation:
            self._translation.begin_drift()

    def struck(self, step: PresentStep) -> None:
        """Add the work in impacts during the drift, which may have changed the impulses of the first kick."""
        if self._contacts.is_at_rest and self.entries:
            held = self._work_of(self._contacts.solver.contacts)
            self._work, self._held = self._work + held - self._held, held
        log, surface = self._contacts.impacts.log, self._solids.surface
        if self._solids.rotates:
            self._work += work_of_impacts(log, surface, self._count)
        if self._solids.translates:
            self._work += work_in_drift(log, surface, self._count)

    def arrive(self, step: PresentStep) -> None:
        """Move walls to the end of the step; bodies still have the velocities of the drift."""
        if self._translation:
            self._translation.arrive(step.time)

    def corrected(self, step: PresentStep) -> None:
        """Displace guided walls by the distances that the correction of overlaps moved them."""
        if self._translation:
            self._translation.push(step.pushed)

    def finish(self, step: PresentStep) -> None:
        """Give walls that translate their velocities after the last kick."""
        if self._translation:
            self._translation.finish(step.time)

    def before_impacts(self, step: PresentStep) -> None:
        """Give walls that translate the accelerations of the last kick."""
        if self._translation:
            self._velocity = self._translation.accelerate()

    def acted(self, step: PresentStep) -> None:
        """Add the work of impacts and of the last kick.

        Walls then have no acceleration, so that position corrections book only the work of the bodies' forces.
        """
        self._work += self._work_of(self._contacts.solver.recorded)
        self._work += self._work_of(self._contacts.solver.contacts)
        if self._translation:
            self._translation.rest()

    def conclude(self, step: PresentStep) -> None:
        """Add the work of walls that contacts move."""
        if self._translation:
            self._work += self._translation.settle()

    def _work_of(self, impulses: RecordArray[Any]) -> float:
        """Return the work (J) that ``impulses``, (m,), do at the present contacts."""
        solver, work = self._contacts.solver, 0.0
        touching = solver.system.pairs, cast(RecordArray[Any], solver.contacts), impulses
        if self._solids.rotates:
            work += work_of_contacts(*touching, self._solids.surface, self._count)
        if self._solids.translates:
            work += work_at_velocities(*touching, self._velocity, self._count)
        return work
