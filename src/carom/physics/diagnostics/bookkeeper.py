"""The books of a run: energy and momentum compared with the start, extremes, activity and events.

Steps do not depend on the books.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import numpy as np

from carom.arrays import FloatArray, Records
from carom.errors import PhysicsError
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.diagnostics.dissipation import SignsOfDissipation
from carom.physics.diagnostics.energy import EnergyAccount
from carom.physics.diagnostics.energy_monitor import EnergyMonitor, Suspects
from carom.physics.diagnostics.extremes import add_contacts, add_energy, add_impulse_audit, add_momentum
from carom.physics.diagnostics.impulse_audit import ImpulseAudit
from carom.physics.diagnostics.ledger import with_contacts
from carom.physics.diagnostics.momentum import Momentum, MomentumAccount, TotalMotion
from carom.physics.diagnostics.run_monitor import Activity, PaceMonitor, refuse_infinities
from carom.physics.forces.force import Potentials
from carom.physics.world import World
from carom.plan.auto import integrator
from carom.scene.forces import acts_from_outside
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.scene.wording import Names
from carom.state.books import NOTHING, Books, Extreme, Extremes, PaceTally
from carom.state.checkpoint import Checkpoint
from carom.state.energies import Energy, EnergyBaseline, Ledger

ROUNDING = 1e-10  # upper bound of the relative rounding in a sum over 10⁶ bodies


class BalanceAudit:
    """Energy and momentum at the last frame or check, compared with their values at the start of the run.

    ``uniform``, (3,) m/s², is the acceleration that is the same for all bodies, and ``constant`` (J) is the
    gravitational energy between fixed bodies. ``losses`` names the ledger's entries for forces without a potential and
    for optional parts. ``pressing`` (J) is the work of loads over a distance of one radius.
    """

    def __init__(
        self,
        scene: Scene,
        bodies: Bodies,
        names: Names,
        uniform: FloatArray,
        constant: float,
        losses: Iterable[str],
        pressing: float = 0.0,
    ) -> None:
        periodic = scene.domain.is_periodic
        self.ledger = Ledger(forces=tuple((entry, 0.0) for entry in losses))
        self.energy: Energy
        self.momentum: Momentum
        self.step = -1  # number of the step at the last frame or check
        self._bodies = bodies
        self._units = scene.unit_system
        held = scene.anchored or acts_from_outside(scene)
        self._energy = EnergyAccount(bodies, uniform, held, constant, pressing)
        booked = len(self.ledger.forces) > 0  # if so, even the work of the field is booked step by step
        self.momenta = MomentumAccount(bodies, np.zeros(3) if booked else uniform, periodic, held)
        self.monitor = EnergyMonitor(scene.record.energy_tolerance, names, integrator(scene), scene.unit_system)
        self._suspects: Suspects | None = None
        self._spent: Suspects | None = None  # suspects of the last check; their arrays are reused

    @property
    def energy_baseline(self) -> EnergyBaseline:
        """The reference values of the energy."""
        assert self._energy.baseline is not None, "the initial state has been measured"
        return self._energy.baseline

    def reopen(self, books: Books, ledger: Ledger) -> None:
        """Continue the audit of an earlier run."""
        self.ledger = ledger
        self._energy.baseline, self.momenta.baseline, self.monitor.tally = books.energy, books.momentum, books.watch
        self._suspects = None

    def refer_to(self, books: Books) -> bool:
        """Adopt recorded reference values that differ from this run's only by rounding; return whether any does.

        Versions before 23 November 2026 summed the centre of mass and Σ m |g| r with BLAS, whose rounding depends on
        the processor.
        """
        energy, momentum = self.energy_baseline, self.momenta.baseline
        known = replace(energy, scale=_nearly(books.energy.scale, energy.scale, energy.scale))
        reach = float(np.abs(self._bodies.position).max())
        pairs = zip(books.momentum.centre, momentum.centre, strict=True)
        x, y, z = (_nearly(recorded, own, reach) for recorded, own in pairs)
        moved = replace(momentum, centre=(x, y, z))
        changed = (known, moved) != (energy, momentum)
        self._energy.baseline, self.momenta.baseline = known, moved
        return changed

    def book(self, contacts: FloatArray) -> None:
        """Book the energies of the contacts of a step, (m, 3) J."""
        self.ledger = with_contacts(self.ledger, contacts)

    def exchange(self, entry: str, loss: float, impulse: FloatArray, angular_impulse: FloatArray) -> None:
        """Book the energy (J) dissipated by a force without a potential, and its impulses (N s and N m s)."""
        self.ledger = self.ledger.plus_loss(entry, loss)
        self.momenta.receive(impulse, angular_impulse)

    def book_work(self, entry: str, work: float) -> None:
        """Book work (J) done on the bodies in an entry of the ledger."""
        self.ledger = self.ledger.plus_loss(entry, -work)

    def exchanged(self, entry: str) -> FloatArray:
        """Return the energy that a force without a potential has dissipated so far, and the expected momenta, (7,)."""
        return np.array([self.ledger.entry(entry), *self.momenta.expected])

    def exchange_up_to(self, entry: str, exchanged: FloatArray) -> None:
        """Set the values that `exchanged` returns, after kernels have added to these values."""
        self.ledger = self.ledger.with_loss(entry, float(exchanged[0]))
        self.momenta.expected = exchanged[1:].copy()

    def suspect(self, step: int, contact: ContactPipeline) -> None:
        """Copy the contacts of a step for a possible warning, before the next step overwrites them."""
        self._suspects = self._spent = Suspects.of(step, contact, self._bodies, self._spent)

    def energy_now(self, potentials: Mapping[str, float], roundings: int) -> Energy:
        """Return the energy of the present state; for the arguments see `EnergyAccount.balance`."""
        motion = TotalMotion.of(self._bodies)
        return self._energy.balance(motion, potentials, self.ledger, judged=False, roundings=roundings)

    def momentum_now(self, time: float) -> Momentum:
        """Return the momentum of the present state, at a time in seconds."""
        return self.momenta.balance(TotalMotion.of(self._bodies), time, judged=False)

    def measure(
        self, step: int, time: float, potentials: Mapping[str, float], roundings: int, extremes: Extremes | None
    ) -> None:
        """Compute energy and momentum, and update the extremes of the run, if given, with the errors.

        For ``roundings``, see `EnergyAccount.balance`.

        Raises
        ------
        PhysicsError
            If the energy is no longer finite.
        """
        motion, judged = TotalMotion.of(self._bodies), extremes is not None
        self.energy = self._energy.balance(motion, potentials, self.ledger, judged, roundings)
        if not math.isfinite(self.energy.total):
            raise PhysicsError(f"the energy is no longer finite at step {step}, t = {self._units.text(time, TIME)}")
        self.momentum = self.momenta.balance(motion, time, judged)
        if extremes:
            add_energy(extremes, step, time, self.energy)
            add_momentum(extremes, step, time, self.momentum)
        self.step = step

    def check(self, time: float, extremes: Extremes, contact: ContactPipeline | None = None) -> list[Event]:
        """Check the energy; return the warnings of the energy monitor.

        Warnings list contacts that may have changed the energy: those copied by `suspect`, and those in ``contact``.
        """

        def suspects() -> list[Suspects]:
            present = Suspects.of(self.step, contact, self._bodies) if contact else None
            return [contacts for contacts in (self._suspects, present) if contacts]

        warnings = self.monitor.check(self.step, time, self.energy, extremes.contact_gain.value, suspects)
        self._suspects = None
        return warnings


def _nearly(recorded: float, own: float, size: float) -> float:
    """Return the recorded value if it differs from this run's value only by rounding; otherwise this run's value."""
    return recorded if abs(recorded - own) <= ROUNDING * size else own


class Bookkeeper:
    """Books the steps of a world."""

    def __init__(self, world: World) -> None:
        scene, bodies, forces = world.scene, world.bodies, world.forces
        self._world = world
        self.extremes = self._beginning(Extremes())
        constant = forces.potential_of_fixed_bodies()
        losses = [*forces.losses, *(entry for part in world.parts for entry in part.entries)]
        pressing = sum(part.pressing_energy for part in world.parts)
        self.audit = BalanceAudit(scene, bodies, world.names, forces.uniform, constant, losses, pressing)
        self.activity = Activity(len(bodies), scene.anchored or bool(forces.uniform.any()))
        without_kicks = integrator(scene).controls_error and world.contact is None
        audited = scene.expect.contact_audit is not None and not without_kicks
        self.impulse_audit = world.step.audit = ImpulseAudit(bodies, world.contact) if audited else None
        # parts enter this context to change velocities other than by plain kicks or by impulses of contacts
        self.change: AbstractContextManager[None] = self.impulse_audit or nullcontext()
        self.pace: PaceMonitor | None = None  # None unless limits set the steps
        self._events: list[Event] = []
        # s, time up to which the accuracy is promised; infinite if there is no promise, or once its end is logged
        self.kept_until = np.inf if scene.promise is None else scene.promise.kept_until
        if world.contact:
            self._measure_contacts(world.contact, Extremes())  # with no contacts yet, this only loads the kernels

    @property
    def state(self) -> Books:
        """A copy of the books for a checkpoint."""
        contact = self._world.contact
        return Books(
            energy=self.audit.energy_baseline,
            momentum=self.audit.momenta.baseline,
            watch=self.audit.monitor.tally,
            moments=self.extremes.copy(),
            activity=self.activity.impact_energy,
            phase=self.activity.phase,
            limits=tuple(sorted(contact.warned)) if contact else (),
            pace=self.pace.tally if self.pace else PaceTally(),
            wrong_work=contact.signs.memory if contact else (),
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue the books of an earlier run."""
        books, contact = checkpoint.books, self._world.contact
        if contact:
            contact.warned = set(books.limits)
            contact.signs.recall(books.wrong_work)
        if self.pace:
            self.pace.tally = books.pace
        self.audit.reopen(books, checkpoint.energy.ledger)
        self.extremes = self._beginning(books.moments)
        self.activity.reopen(books.phase, books.activity)
        self._events = []
        if self._is_past_the_promise(checkpoint.time):
            self.kept_until = np.inf  # the end of the promise is already logged

    def begin_step(self, judged: bool) -> None:
        """Begin a step, after the clock has advanced; the contacts still belong to the previous step."""
        if judged:
            self.suspect_contacts(self._world.clock.step - 1)
        self.begin_contacts(judged)
        if self.impulse_audit:
            self.impulse_audit.begin(self.audit.ledger)

    def suspect_contacts(self, step: int) -> None:
        """Copy the present contacts of a step, which may have changed the energy."""
        contact = self._world.contact
        if contact:
            self.audit.suspect(step, contact)

    def begin_contacts(self, judged: bool = False) -> None:
        """Begin the contacts of a step, after the clock has advanced; ``judged``: whether it ends with a check."""
        clock, contact = self._world.clock, self._world.contact
        if contact:
            contact.signs.begin(clock.step, clock.time, judged)
        for begin in self._world.hooks.begin:
            begin(clock.step, clock.before, clock.time)

    def finish_step(self, potentials: Potentials, computed: bool, judged: bool) -> None:
        """Book the contacts of a step; if due, compute energy and momentum, and check their errors."""
        contact = self._world.contact
        if contact:
            self._book_contacts(contact)
        else:
            self.activity.add_step(0, 0.0)
        clock = self._world.clock
        if self.impulse_audit:
            worst = self.impulse_audit.finish(self.audit.ledger)
            add_impulse_audit(self.extremes, clock.step, clock.time, worst)
        if computed:
            self.measure(potentials, judged, contact)
        if self._is_past_the_promise(clock.time):
            self.log(end_of_promise(self._world.scene, clock.step, clock.time))
            self.kept_until = np.inf

    def _is_past_the_promise(self, time: float) -> bool:
        """Return whether the promised accuracy has ended at a time (s), before the end of the run."""
        ends_early = self.kept_until < self._world.scene.time.duration
        return time >= self.kept_until if ends_early else time > self.kept_until

    def steady_totals(self) -> dict[str, float]:
        """Return the totals that steps with unchanged contacts update, keyed by the fields of `TOTALS`."""
        ledger, extremes = self.audit.ledger, self.extremes
        assert extremes.contacts and extremes.overlap, "a step with contacts has been booked"
        return {
            "restitution": ledger.restitution,
            "friction": ledger.friction,
            "stabilisation": ledger.stabilisation,
            "impact_energy": self.activity.impact_energy,
            "deepest": extremes.overlap.value,
            "most": extremes.contacts.value,
        }

    def book_steady_steps(self, totals: Records) -> None:
        """Book steps with unchanged contacts, given their totals."""
        audit, extremes, activity = self.audit, self.extremes, self.activity
        T = totals[0]
        restitution, friction, stabilisation = (float(T[term]) for term in ("restitution", "friction", "stabilisation"))
        audit.ledger = Ledger(restitution, friction, stabilisation, audit.ledger.forces)
        if T["deepest_step"]:
            ends = int(T["deepest_i"]), int(T["deepest_j"])
            extremes.overlap = Extreme(float(T["deepest"]), int(T["deepest_step"]), float(T["deepest_time"]), ends)
        if T["most_step"]:
            extremes.contacts = Extreme(float(T["most"]), int(T["most_step"]), float(T["most_time"]))
        extremes.total_contacts += int(T["contacts"])
        activity.impact_energy = float(T["impact_energy"])

    def check_pace(self, dt: float, limit: str) -> None:
        """Warn if the next step, of dt seconds, and the recent steps are much shorter than the first step."""
        clock = self._world.clock
        warning = self.pace.check(clock.step, clock.time, dt, limit) if self.pace else None
        if warning:
            self.log(warning)

    def measure(self, potentials: Potentials, judged: bool, contact: ContactPipeline | None = None) -> None:
        """Compute energy and momentum.

        If ``judged``, errors enter the verdict on the run and cause warnings, which list the contacts copied by
        `suspect_contacts` and the contacts in ``contact``. A computation for a frame alone does not change the books.
        """
        world, clock = self._world, self._world.clock
        try:
            extremes = self.extremes if judged else None
            self.audit.measure(clock.step, clock.time, potentials, self._roundings, extremes)
        except PhysicsError:
            # its error message names the bodies
            refuse_infinities(world.bodies, world.names.bodies, clock.step, clock.time, clock.units)
            raise
        if judged:
            for warning in self.audit.check(clock.time, self.extremes, contact):
                self.log(warning)
            if contact:
                self._judge_dissipation(contact.signs)
        world.profile.mark("energy")

    def energy_now(self, potentials: Potentials) -> Energy:
        """Return the energy of the present state, given the potential energies of the forces in joules."""
        return self.audit.energy_now(potentials, self._roundings)

    @property
    def _roundings(self) -> int:
        """How often a body's velocity may have been rounded so far: once in each step and each impact."""
        return self._world.clock.step + self.extremes.impacts

    def _judge_dissipation(self, signs: SignsOfDissipation) -> None:
        """Update the extremes with energy that contacts moved against the signs of dissipation, and warn."""
        scale, world = self.audit.energy.scale, self._world
        error = signs.error(scale)
        if error is not None:
            self.extremes.dissipation_error = error
            for warning in signs.warnings(scale, world.names, world.clock.units):
                self.log(warning)

    def log(self, event: Event) -> None:
        """Add an event to the next frame."""
        self._events.append(event)
        if event.level == "WARN":
            self.extremes.add_warning(event.kind)

    def pop_events(self) -> tuple[Event, ...]:
        """Return the events since the last call."""
        events, self._events = tuple(self._events), []
        return events

    def _book_contacts(self, contact: ContactPipeline) -> None:
        clock = self._world.clock
        if len(contact.ledger_apart):
            self.audit.book(contact.ledger_apart)
        if contact.statistics.contacts:
            if self.extremes.contacts is None:
                graph = contact.snapshots.snapshot.graph
                i, j = graph.pairs[graph.first]
                text = f"First contact: {self._world.names.pair((i, j))}."
                self.log(Event(clock.step, clock.time, "INFO", text, "first-contact"))
            self._measure_contacts(contact, self.extremes)
            for level, text in contact.limits_reached():
                self.log(Event(clock.step, clock.time, level, text, "limit"))
        self.activity.add_step(contact.statistics.contacts, contact.statistics.struck)
        self._world.profile.mark("ledger")

    def _measure_contacts(self, contact: ContactPipeline, extremes: Extremes) -> None:
        clock = self._world.clock
        self.audit.book(contact.statistics.work)
        add_contacts(extremes, clock.step, clock.time, contact.statistics)

    def _beginning(self, extremes: Extremes) -> Extremes:
        """Return a copy of the extremes so far, with an entry for every quantity that this run measures."""
        known, audited = extremes.contact_audit, self._world.scene.expect.contact_audit is not None
        return replace(extremes, contact_audit=NOTHING if audited and known is None else known)


def end_of_promise(scene: Scene, step: int, time: float) -> Event:
    """Return the event that reports the end of the promised accuracy."""
    promise = scene.promise
    assert promise is not None
    units = scene.unit_system
    after = "the run ends there" if scene.time.after_horizon == "end" else "ordinary steps go on"
    text = f"The accuracy of {scene.time.accuracy:g} is kept up to t = {units.text(promise.kept_until, TIME)}; {after}."
    if promise.horizon is not None and promise.lyapunov > 0.0:
        text += f" Small errors grow tenfold in {units.text(math.log(10.0) / promise.lyapunov, TIME, '.3g')}."
    return Event(step, time, "INFO", text, "horizon")
