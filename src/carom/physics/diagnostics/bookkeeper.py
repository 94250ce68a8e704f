"""The books of a run: energy and momentum, extremes, activity and events. No step depends on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from carom.errors import PhysicsError
from carom.event import Event
from carom.physics.checkpoint import Books, Checkpoint
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.diagnostics.activity import Activity
from carom.physics.diagnostics.audit import Audit
from carom.physics.diagnostics.extremes import NOTHING, Extremes
from carom.physics.diagnostics.finite import refuse_infinities
from carom.physics.diagnostics.horizon import end_of_promise
from carom.physics.diagnostics.impulse_audit import ImpulseAudit
from carom.physics.diagnostics.pace import PaceMonitor, PaceTally
from carom.physics.forces.force import Exchange, Potentials
from carom.physics.world import World
from carom.plan.auto import integrator


class Bookkeeper:
    """Follows the steps of a world.

    Parameters
    ----------
    world
        The world at the start of the run.

    Attributes
    ----------
    extremes
        Those of the run so far.
    audit
        Energy and momentum as of the last check, and the ledger.
    activity
        The phase of the run.
    impulse_audit
        Compares velocities with impulses, where ``expect.contact_audit`` requests it.
    pace
        Warns of a run that slows down, where limits set its steps.
    kept_until
        s, after which the accuracy is no longer promised; infinite if nothing is promised or the run has logged it.
    """

    def __init__(self, world: World) -> None:
        scene, bodies, forces = world.scene, world.bodies, world.forces
        self._world = world
        self.extremes = self._beginning(Extremes())
        constant = forces.potential_of_fixed_bodies()
        self.audit = Audit(scene, bodies, world.names, forces.uniform, constant, forces.losses)
        self.activity = Activity(len(bodies), scene.anchored or bool(forces.uniform.any()))
        without_kicks = integrator(scene).controls_error and world.contact is None
        audited = scene.expect.contact_audit is not None and not without_kicks
        self.impulse_audit = ImpulseAudit(bodies) if audited else None
        self.pace: PaceMonitor | None = None
        self._events: list[Event] = []
        self.kept_until = np.inf if scene.promise is None else scene.promise.kept_until
        if world.contact:
            self._see_contacts(world.contact, Extremes())  # none: loads the kernels

    @property
    def state(self) -> Books:
        """A copy of the books for a checkpoint."""
        contact = self._world.contact
        return Books(
            energy=self.audit.energy_baseline,
            momentum=self.audit.momentum_baseline,
            watch=self.audit.monitor_state,
            moments=self.extremes.copy(),
            activity=self.activity.impact_energy,
            phase=self.activity.phase,
            limits=tuple(sorted(contact.warned)) if contact else (),
            pace=self.pace.tally if self.pace else PaceTally(),
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue the books of an earlier run."""
        books, contact = checkpoint.books, self._world.contact
        if contact:
            contact.warned = set(books.limits)
        if self.pace:
            self.pace.tally = books.pace
        self.audit.reopen(books, checkpoint.energy.ledger)
        self.extremes = self._beginning(books.moments)
        self.activity.reopen(books.phase, books.activity)
        self._events = []
        if checkpoint.time > self.kept_until:
            self.kept_until = np.inf  # known already

    def refer_to(self, books: Books) -> bool:
        """Take over the references of a recorded start; return whether they were others."""
        return self.audit.refer_to(books)

    def begin_step(self, checked: bool) -> None:
        """Begin a step, after the clock has advanced; the contacts are still those of the step before."""
        if checked:
            self.suspect_contacts(self._world.clock.step - 1)
        self.begin_contacts()
        if self.impulse_audit:
            self.impulse_audit.begin(self.audit.ledger)

    def suspect_contacts(self, step: int) -> None:
        """Keep the present contacts, which are of a step, as those that may have changed the energy."""
        contact = self._world.contact
        if contact:
            self.audit.suspect(step, contact)

    def begin_contacts(self) -> None:
        """Begin the contacts of a step, after the clock has advanced."""
        clock, contact = self._world.clock, self._world.contact
        if contact and contact.tap:
            contact.tap.begin(clock.step, clock.before, clock.time)

    def finish_step(self, potentials: Potentials, checked: bool) -> None:
        """Book the contacts of a step; if it is checked, compute energy and momentum too."""
        contact = self._world.contact
        if contact:
            self._book_contacts(contact)
        else:
            self.activity.see(0, 0.0)
        if self.impulse_audit:
            self._audit_impulses(self.impulse_audit)
        if checked:
            self.take_stock(potentials, checked, contact)
        clock = self._world.clock
        if clock.time > self.kept_until:
            self.log(end_of_promise(self._world.scene, clock.step, clock.time))
            self.kept_until = np.inf

    def book_exchanges(self, entry: str, exchanges: Iterable[Exchange]) -> None:
        """Book energy and momentum exchanged with a medium, under an entry of the ledger."""
        for exchange in exchanges:
            self.audit.exchange(entry, *exchange)

    def check_pace(self, dt: float, limit: str) -> None:
        """Warn if the next step, of dt seconds, and those before are much shorter than the first."""
        clock = self._world.clock
        warning = self.pace.look(clock.step, clock.time, dt, limit) if self.pace else None
        if warning:
            self.log(warning)

    def take_stock(self, potentials: Potentials, checked: bool, contact: ContactPipeline | None = None) -> None:
        """Compute energy and momentum; ``checked`` says whether to warn of their errors.

        A warning lists the present contacts of ``contact``, if given, beside those that were kept.
        """
        world, clock = self._world, self._world.clock
        try:
            self.audit.take_stock(clock.step, clock.time, potentials, self.extremes)
        except PhysicsError:
            refuse_infinities(world.bodies, world.names.bodies, clock.step, clock.time, clock.units)  # names them
            raise
        if checked:
            for warning in self.audit.check(clock.time, self.extremes, contact):
                self.log(warning)
        world.profile.mark("energy")

    def log(self, event: Event) -> None:
        """Add an event to those of the next frame."""
        self._events.append(event)
        if event.level == "WARN":
            self.extremes.see_warning(event.kind)

    def take_events(self) -> tuple[Event, ...]:
        """Return the events since the last call."""
        events, self._events = tuple(self._events), []
        return events

    def _book_contacts(self, contact: ContactPipeline) -> None:
        """Book the contacts of the step."""
        clock = self._world.clock
        if len(contact.ledger_apart):
            self.audit.book(contact.ledger_apart)
        if contact.statistics.contacts:
            if self.extremes.contacts is None:
                graph = contact.seen.graph
                i, j = graph.pairs[graph.first]
                text = f"First contact: {self._world.names.pair((i, j))}."
                self.log(Event(clock.step, clock.time, "INFO", text, "first-contact"))
            self._see_contacts(contact, self.extremes)
            for level, text in contact.limits_reached():
                self.log(Event(clock.step, clock.time, level, text, "limit"))
        self.activity.see(contact.statistics.contacts, contact.statistics.struck)
        self._world.profile.mark("ledger")

    def _see_contacts(self, contact: ContactPipeline, extremes: Extremes) -> None:
        clock = self._world.clock
        self.audit.book(contact.statistics.work)
        extremes.see_contacts(clock.step, clock.time, contact.statistics)

    def _audit_impulses(self, audit: ImpulseAudit) -> None:
        """Compare the impulses of contacts and forces in this step with the changes of the velocities."""
        clock, contact = self._world.clock, self._world.contact
        impulses, work = (contact.impulses(), contact.work()) if contact else ((), np.zeros((0, 3)))
        self.extremes.see_impulse_audit(clock.step, clock.time, audit.finish(impulses, work, self.audit.ledger))

    def _beginning(self, extremes: Extremes) -> Extremes:
        """Return a copy of the extremes so far that has an entry for all that this run looks at."""
        known, audited = extremes.contact_audit, self._world.scene.expect.contact_audit is not None
        return replace(extremes, contact_audit=NOTHING if audited and known is None else known)
