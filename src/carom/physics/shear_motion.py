"""A sheared box in a step: moving images, wrapped bodies, and lasting contacts in the flow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carom.physics.bodies import Bodies
from carom.physics.contact.hooks import LedgerAccount, OptionalPart, PresentStep
from carom.physics.sheared_box import ENTRY, ShearedBox
from carom.scene.rest_speed import PER_STEP

if TYPE_CHECKING:
    from carom.physics.contact.pipeline import ContactPipeline


class ShearMotion(OptionalPart):
    """Moves the images of a sheared box through the phases of a step, and books the work of the shear."""

    entries = (ENTRY,)

    def __init__(self, shear: ShearedBox, bodies: Bodies) -> None:
        self._shear, self._bodies = shear, bodies

    def place(self, time: float) -> None:
        """Place the images at a time (s)."""
        self._shear.begin(time)

    def discard(self) -> None:
        """Discard the work so far."""
        self._shear.pop()

    def book(self, account: LedgerAccount) -> None:
        """Book the work of the shear in the step, and the momentum gained by wrapping."""
        work, impulse = self._shear.pop()
        account.exchange(ENTRY, -work, impulse, np.zeros(3))

    def prepare(self, step: PresentStep) -> None:
        """Place the images at the beginning of the step."""
        self._shear.begin(step.before)

    def arrive(self, step: PresentStep) -> None:
        """Place the images at the end of the step, since contacts are found and resolved there."""
        self._shear.begin(step.time)

    def wrap(self, step: PresentStep) -> None:
        """Wrap the bodies, with their velocities."""
        self._shear.wrap(self._bodies, step.time)


class ShearedContacts(OptionalPart):
    """Lets contacts in a sheared box rest in the flow, and books the work of the shear by their impulses."""

    def __init__(self, contacts: ContactPipeline) -> None:
        assert contacts.world.shear is not None, "see `carom.plan.step_parts`"
        self._contacts, self._shear = contacts, contacts.world.shear
        # m/s², acceleration with which the flow may close contacts
        self._flow = contacts.world.flow(float(contacts.bodies.radius.max()))

    def load(self, dt: float) -> None:
        """Let contacts be at rest if only the flow closes them."""
        solver, closing = self._contacts.solver, PER_STEP * self._flow * dt  # m/s
        for speeds in (solver.rest_speed, solver.load_speed):
            np.maximum(speeds, closing, out=speeds)
        self._contacts.presses |= closing > 0.0 and len(self._contacts.contacts) > 0

    def held(self, step: PresentStep) -> None:
        """Add the work of the first kick."""
        self._shear.add_work(self._contacts.solver.contacts, self._contacts.solver.contacts)

    def corrected(self, step: PresentStep) -> None:
        """Add the work of the correction of overlaps."""
        self._shear.add_work_of_corrections(self._contacts.solver.contacts, self._contacts.solver.recorded)

    def acted(self, step: PresentStep) -> None:
        """Add the work of impacts and of the last kick."""
        self._shear.add_work(self._contacts.solver.contacts, self._contacts.solver.recorded)
        self._shear.add_work(self._contacts.solver.contacts, self._contacts.solver.contacts)
