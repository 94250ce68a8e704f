"""The contact pipeline of a step.

`carom.physics.step` calls, in this order:

1. `hold`: after the first kick, find the impulses of resting contacts, so that they do not close during the drift
2. `find`: broad phase, geometry, colouring, and position correction of resting contacts
3. `resolve`: after the last kick, find the impulses at the final positions
4. `torques.write`: torques and angular accelerations of the step

This module names no optional part of the model; it calls the hooks of the parts that a scene requires
(`contact.hooks`).

An integrator whose steps end at impacts calls `begin_batch`, `resolve_meeting` at each impact, and `end_batch`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import PhysicsError
from carom.physics.bodies import Bodies
from carom.physics.contact.graph import OrderedContacts
from carom.physics.contact.hooks import NO_ENTRIES, Hooks, Mover, OptionalPart, P, PresentStep
from carom.physics.contact.impact_log import NO_IMPACTS, Impacts
from carom.physics.contact.impact_totals import ImpactTotals
from carom.physics.contact.near_pairs import ContactWorld, NearPairs
from carom.physics.contact.reactions import ImpactTurns, Torques, supported_acceleration
from carom.physics.contact.snapshot import IdleContacts, SnapshotSource
from carom.physics.contact.solver.contact_solver import MOST_SWEEPS, ContactSolver
from carom.physics.contact.solver.positions import BAUMGARTE
from carom.physics.contact.solver.prepare import ImpulseCache
from carom.physics.contact.statistics import NO_CONTACTS, limits_of, still_closing
from carom.physics.contact.sticking import SlidingContacts, time_to_stick
from carom.physics.diagnostics.dissipation import SignsOfDissipation
from carom.physics.jit.team import Team
from carom.plan.features import Requirements
from carom.plan.step_parts import STEP_PARTS, required
from carom.registry import imported
from carom.scene.load import Scene
from carom.state.checkpoint import ContactCheckpoint
from carom.state.frame import empty_graph


class ContactPipeline:
    """Detects the contacts of each step and resolves them.

    ``others`` are parts of a step that do not depend on contacts. Contacts are recorded if ``totals`` is given.
    """

    def __init__(
        self,
        scene: Scene,
        bodies: Bodies,
        world: ContactWorld,
        requirements: Requirements,
        team: Team,
        step: PresentStep,
        others: Sequence[OptionalPart] = (),
        totals: ImpactTotals | None = None,
    ) -> None:
        contact = scene.contact
        self.scene, self.settings, self.bodies, self.world = scene, contact, bodies, world
        self.team, self.needs, self.totals = team, requirements, totals
        self.lasts = contact.solver == "lasting" and requirements.resting.modelled  # whether contacts can be at rest
        self.near = NearPairs(contact, bodies, world, self.lasts, team)
        self.most_sweeps = contact.sweeps if isinstance(contact.sweeps, int) else MOST_SWEEPS[contact.sweeps]
        self._pushes = contact.stabilisation == "split"
        self.warned: set[str] = set()  # messages of the limits reported so far
        friction = requirements.friction.modelled
        # without lasting contacts, the solver need not find meshed islands
        sweeps = contact.sweeps if self.lasts or contact.sweeps != "auto" else "converged"
        shapes = bodies, world.planes, world.materials, world.solver_box
        # only lasting contacts have torques, so the impulses of impacts are kept, to be subtracted
        keeps = totals is not None or requirements.torque.modelled
        self.solver = ContactSolver(*shapes, friction, team, keeps, sweeps)
        if not self.lasts:
            self.solver.assume_loads()
        self.near.pressing = self.solver.pressing[: len(bodies)]
        self.torques = Torques(bodies, team)
        self.contacts = OrderedContacts.of(empty_graph().pairs, bodies, contact.colouring)  # the step's contacts
        self.snapshots = SnapshotSource(self.solver, bodies.ends.inverse_mass)
        # with fewer sweeps than the default, sticking contacts may slip, and the work of their friction in the first
        # kick does not cancel its work in the last kick
        sticks = world.is_still and self.most_sweeps >= MOST_SWEEPS["auto"]
        self.signs = SignsOfDissipation(bodies, world.materials, sticks, world.planes)
        names = required(scene, requirements, totals is not None)
        made: list[OptionalPart | None] = [imported(STEP_PARTS[name].target)(self) for name in names]
        self.parts = [*others, *(part for part in made if part)]
        self.hooks = Hooks.of(self.parts)
        self._mover = self.part(Mover)
        self._search: Callable[[PresentStep], IntArray] = lambda step: self.near.find(step.dt)
        for search in self.hooks.search:
            self._search = partial(search, others=self._search)
        self._compile(step)

    def part(self, kind: type[P]) -> P | None:
        """Return the part of a kind; None if the scene does not require it."""
        return next((part for part in self.parts if isinstance(part, kind)), None)

    def forget(self) -> None:
        """Return to the state before the first step."""
        self.impulses = ImpulseCache.empty()  # impulses from which the next kick starts
        self.idle: IdleContacts | None = None  # contacts of the step that no solver computes
        self.unmoved: BoolArray | None = None  # (n,) bodies that no kick of this step moves
        self.absent: BoolArray | None = None  # (n,) bodies that are absent now, and touch nothing
        self.presses = False  # whether something presses contacts together
        if self.lasts:
            self.solver.find_loads(0.0)
        self._order_contacts(empty_graph().pairs, 0.0)
        if self.needs.torque.modelled:
            self.torques.remember()
        self.ledger_apart = NO_ENTRIES  # (k, 3) J, ledger entries of the step that belong to no contact
        self.impacts: Impacts = NO_IMPACTS  # impacts of the drift
        self.statistics = NO_CONTACTS  # statistics of the step
        self.counts_impacts = True  # whether statistics include the impacts of the drift; a look-ahead leaves them out
        self.snapshots.forget()
        self.signs.forget()
        for part in self.parts:
            part.forget()

    @property
    def memory(self) -> ContactCheckpoint | None:
        """A copy of the state that the next step needs; None if contacts cannot last."""
        if not self.lasts:
            return None
        hold, pairs, speeds = self.impulses, self.contacts.pairs, self.solver.speeds_by_pair()
        impulse = hold.impulse_of(self.solver.contacts)
        memory = ContactCheckpoint(pairs, *speeds, self._dt, hold.pairs, impulse, hold.kick)
        for part in self.parts:
            memory = part.remember(memory)
        return memory

    @property
    def turns_of_impacts(self) -> ImpactTurns | None:
        """The angular impulses of the impacts of the last step; None if it had no impacts."""
        return ImpactTurns.of(self.impacts, self.solver, self.bodies)

    @property
    def supported_acceleration(self) -> FloatArray:
        """(n + p,) m/s², the supported acceleration of each body in the last kick; empty if contacts supported none."""
        supported = supported_acceleration(self.impulses, self.bodies.ends.inverse_mass)
        for support in self.hooks.support:
            supported = support(supported)
        return supported

    def recall(self, memory: ContactCheckpoint | None) -> None:
        """Restore the state of `memory`; the bodies must already be at their positions of that step."""
        self.forget()
        if memory is not None:
            if memory.highest >= len(self.bodies.ends.radius):
                raise PhysicsError("the checkpoint has contacts of bodies that are not in the scene")
            for part in self.parts:
                part.recall(memory)
            self.lay_out(memory)

    def lay_out(self, memory: ContactCheckpoint) -> None:
        """Restore the contacts of the last step from a checkpoint."""
        self._order_contacts(memory.pairs, memory.dt)
        self.solver.rest_speed[self.solver.order.place] = memory.rest_speed
        self.solver.load_speed[self.solver.order.place] = memory.load_speed
        self.presses = bool(memory.load_speed.max(initial=0.0) > 0.0)
        self.impulses = ImpulseCache.of(memory.held_pairs, memory.impulse, memory.kick)

    def restart(self, impulses: ImpulseCache) -> None:
        """Start the next kick from other impulses."""
        for part in self.parts:
            part.restarted()
        self.impulses = impulses

    def begin(self, dt: float) -> None:
        """Find the contacts at the start of a run whose first step is about dt s."""
        if self.lasts:
            self._order_contacts(self.near.find(dt), dt)

    def hold(self, step: PresentStep) -> None:
        """Hold the contacts of the previous step after the first kick, so that they do not close during the drift."""
        if self.needs.torque.modelled:
            self.torques.remember()
        self.ledger_apart = NO_ENTRIES
        for prepare in self.hooks.prepare:
            prepare(step)
        if self.is_at_rest:
            if self.signs.judges:
                self.signs.before_hold(self.contacts, self.solver, self.impulses)
            self._hold_contacts(self._dt, step.kick, step.dt, 0.0, step.booked, step.against)
            if self.signs.judges and step.kick > 0.0:
                self.signs.after_hold(self.contacts, self.solver, step.kick)
            self.ledger_apart = self.solver.audited
            self.solver.find_loads(step.kick)
            for held in self.hooks.held:
                held(step)
        elif self.lasts:
            self.solver.find_loads(0.0)

    def add_impacts(self, step: PresentStep, impacts: Impacts) -> None:
        """Set the impacts of a drift."""
        self.impacts = step.impacts = impacts
        if len(impacts):
            for struck in self.hooks.struck:
                struck(step)
            self.signs.judge_impacts(impacts, self.near.loading * step.drift, self.solver.loads)

    @property
    def is_quiet(self) -> bool:
        """Whether nothing touched in the last step, and nothing is held at the start of the next step."""
        touches = len(self.contacts) or self.statistics.contacts or len(self.impulses.pairs)
        return not (touches or (self.lasts and self.presses) or (self.hooks.is_busy and self._is_busy))

    @property
    def holds(self) -> bool:
        """Whether contacts are held at the start of the next step."""
        return len(self.impulses.pairs) > 0

    @property
    def _is_busy(self) -> bool:
        return any(is_busy() for is_busy in self.hooks.is_busy)

    def step_by_impacts(self, span: float) -> float:
        """Return the longest step (s) that the next impact allows; infinite if there is none within a span (s)."""
        assert self._mover, "the integrator ends its steps at impacts"
        return self._mover.step_by_impacts(span)

    def time_to_stick(self, dt: float, tolerance: float) -> float:
        """Return the time (s) until some held contact stops sliding or rolling; see `sticking`."""
        held, contacts = self.impulses, self.contacts
        if not (self.needs.friction.modelled and held.kick > 0.0 and np.array_equal(held.pairs, contacts.pairs)):
            return np.inf
        records = self.solver.contacts
        moving = SlidingContacts(contacts.pairs, contacts.order.place, records, held.impulse_of(records), held.kick)
        return time_to_stick(moving, self.bodies.ends, dt, tolerance)

    def add_quiet_steps(self) -> None:
        """Account for steps without contacts that followed a quiet step."""
        self.ledger_apart, self.impacts, self.statistics = NO_ENTRIES, NO_IMPACTS, NO_CONTACTS
        self.snapshots.set_quiet(self.contacts)

    @property
    def is_steady(self) -> bool:
        """Whether the last step had contacts, all held at the start of the next step or all without an impulse.

        False if the last step had impacts, if an optional part was busy, or if there were too many colours.
        """
        held, statistics = self.impulses, self.statistics
        if self.is_at_rest:
            are_kept = held.contacts is self.solver.contacts and held.place is self.contacts.order.place
            are_kept = are_kept and held.kick > 0.0
        else:
            are_kept = len(held.pairs) == 0
        happened = self._is_busy or len(self.impacts) or statistics.impacts or self.contacts.overflows
        return are_kept and statistics.contacts > 0 and not happened

    @property
    def last_kick(self) -> float:
        """Length in s of the kick in which the contacts were last held; 0 if none were held."""
        return self.impulses.kick

    def add_steady_steps(self, kick: float, dt: float, sweeps: int) -> None:
        """Account for steps with the same contacts, given the kick and the length of the last step, in s."""
        if kick > 0.0:
            self.impulses = ImpulseCache(self.contacts.pairs, self.contacts.order.place, self.solver.contacts, kick)
        self._dt, self.sweeps = dt, sweeps
        self.ledger_apart, self.impacts = NO_ENTRIES, NO_IMPACTS
        self.snapshots.set_step(self.contacts, None, NO_IMPACTS, dt)
        self.statistics = self.solver.statistics()

    def begin_batch(self) -> None:
        """Begin steps that end at impacts, before the bodies move."""
        if self.needs.torque.modelled:
            self.torques.remember()
        self.impacts = NO_IMPACTS

    def resolve_meeting(self, pair: tuple[int, int] | None, dt: float) -> None:
        """Resolve the impacts of touching pairs after a step of dt s; without a ``pair``, only load the kernels."""
        assert self._mover, "the integrator ends its steps at impacts"
        self.impacts = self.impacts.followed_by(self._mover.resolve_meeting(pair, dt))

    def end_batch(self, step: PresentStep) -> None:
        """Collect the effects of the impacts at the end of the last step."""
        if len(self.impacts):
            for struck in self.hooks.struck:
                struck(step)
        self.resolve(step)
        if self.needs.torque.modelled:
            self.torques.write(step.dt)

    def find(self, step: PresentStep) -> None:
        """Find the contacts at the present positions, colour them, and correct the overlaps of resting contacts."""
        for arrive in self.hooks.arrive:
            arrive(step)
        if self.world.meets_in_drifts:
            return
        pairs = self._search(step)
        step.profile.mark("search")
        if len(pairs) == 0 and len(self.contacts) == 0:
            return
        self._order_contacts(pairs, step.dt)
        step.profile.mark("colouring")
        if self._pushes and len(pairs):
            step.pushed = self.solver.correct_positions(self.most_sweeps, step.last_kick)
            for corrected in self.hooks.corrected:
                corrected(step)
        step.profile.mark("stabilisation")

    def resolve(self, step: PresentStep) -> None:
        """Apply the impulses of the contacts after the last kick of a step, at the final positions."""
        for finish in self.hooks.finish:
            finish(step)
        if len(self.contacts):
            self._resolve(step)
        else:
            self.impulses = ImpulseCache.empty()
        self.solver.find_pressing()  # as for a state restored from a checkpoint
        self.snapshots.set_step(self.contacts, self.idle, self.impacts, step.dt)
        self.statistics = self.solver.statistics() if len(self.contacts) else NO_CONTACTS
        for conclude in self.hooks.conclude:
            conclude(step)
        if self.signs.judges and len(self.contacts):
            loaded = self.near.loading * step.dt
            self.signs.judge_contacts(self.contacts, self.solver, self.impacts, loaded, step.last_kick)

    def limits_reached(self) -> list[tuple[str, str]]:
        """Return level (`WARN` or `INFO`) and text of warnings about limits that this step was the first to reach."""
        reached = limits_of(
            self.settings,
            serial_stage=self.contacts.overflows and not self.world.planes.takes_colours,
            too_few_sweeps=self._too_few_sweeps,
            of_parts=[text for part in self.parts for text in part.warnings()],
            deepest=self.statistics.deepest,
        )
        fresh = [(level, text) for level, text in reached if text not in self.warned]
        self.warned.update(text for _, text in fresh)
        return fresh

    def _order_contacts(self, pairs: IntArray, dt: float) -> None:
        """Begin the contacts of a step of dt s: order them, lay out their records, and find their rest speeds."""
        # a pile at rest keeps its contacts, and so their order
        if not np.array_equal(pairs, self.contacts.pairs):
            self.contacts = OrderedContacts.of(pairs, self.bodies, self.settings.colouring)
        self.solver.lay(self.contacts.order, self.impulses.contacts, self.near.rounding)
        loaded = self.near.loading * dt
        self.presses = self.needs.resting.modelled and self.solver.find_rest_speeds(self.world.field, loaded)
        for load in self.hooks.load if self.needs.resting.modelled else ():
            load(dt)
        self._dt, self.sweeps, self._too_few_sweeps = dt, 0, False

    def _resolve(self, step: PresentStep) -> None:
        contact, solver, dt = self.settings, self.solver, step.dt
        solver.update_geometry()
        if self._pushes:
            solver.audit_corrections()
        for before_impacts in self.hooks.before_impacts:
            before_impacts(step)
        bias_rate = BAUMGARTE / dt if contact.stabilisation == "baumgarte" else 0.0
        lasting = self.is_at_rest
        # a force on only some bodies makes others near, too; nothing presses these together, so open gaps stay open
        impacts_only = lasting or self.near.lists_open
        self.sweeps = solver.resolve_impacts(bias_rate, self.most_sweeps, impacts_only=impacts_only)
        for after_impacts in self.hooks.after_impacts:
            after_impacts(step)
        step.profile.mark("response")
        if lasting and (solver.any_rests or self.sweeps == self.most_sweeps):
            held = self._hold_contacts(dt, step.last_kick, 0.0, bias_rate, step.last_kick)
            self.sweeps = max(self.sweeps, held)
            step.profile.mark("resting")
        else:
            self.impulses = ImpulseCache.empty()
        for acted in self.hooks.acted:
            acted(step)
        if self.sweeps >= self.most_sweeps and still_closing(contact) not in self.warned:
            self._too_few_sweeps = solver.is_closing(dt)
        step.profile.mark("response")

    @property
    def is_at_rest(self) -> bool:
        """Whether contacts may be at rest; without a force that presses bodies together, all contacts are impacts."""
        return self.lasts and self.presses

    def _hold_contacts(
        self, dt: float, kick: float, drift: float, bias_rate: float, booked: float, against: FloatArray | None = None
    ) -> int:
        """Hold the contacts after a kick and before a drift, in s (0 s: no drift); return the number of sweeps."""
        solver, pairs = self.solver, self.contacts.pairs
        place = solver.order.place
        self.impulses.carry_to(pairs, place, kick, solver.contacts, self.team)
        if kick > 0.0:  # Euler's step has no last kick, so the next step starts from the impulses of the first
            self.impulses = ImpulseCache(pairs, place, solver.contacts, kick)
        return solver.hold(dt, booked, drift, bias_rate, self.most_sweeps, against)

    def _compile(self, step: PresentStep) -> None:
        """Run every kernel without contacts, so that the first contact does not wait for compilation."""
        self.forget()
        step.dt = step.drift = step.last_kick = 1.0
        if self._pushes:
            step.pushed = self.solver.correct_positions(1)
            for corrected in self.hooks.corrected:
                corrected(step)
        self._resolve(step)
        self.solver.is_closing(1.0)
        self.solver.statistics()
        for part in self.parts:
            part.compile()
        if self._mover:
            for struck in self.hooks.struck:
                struck(step)
            self.signs.judge_impacts(self.impacts, 1.0, self.solver.loads)
        if self.lasts:
            self.signs.before_hold(self.contacts, self.solver, self.impulses)
            for drift in (1.0, 0.0):
                self._hold_contacts(1.0, 1.0, drift, 0.0, 1.0)
            self.signs.after_hold(self.contacts, self.solver, 1.0)
        self.signs.judge_contacts(self.contacts, self.solver, NO_IMPACTS, 1.0, 1.0)
        if self.needs.torque.modelled:
            self.torques.write(1.0)
        self.forget()
