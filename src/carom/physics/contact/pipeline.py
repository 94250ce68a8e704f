"""The contact pipeline of a step.

`carom.physics.step` calls, in this order:

1. `hold`: after the first kick, find the impulses of resting contacts, so that they do not close during the drift
2. `drift`, with `contact.timing = "time-of-impact"`: move the bodies and resolve impacts at their own times
3. `find`: broad phase, geometry, colouring, and position correction of resting contacts
4. `resolve`: after the last kick, find the impulses at the final positions
5. `torques.write`: torques and angular accelerations of the step

An integrator that ends its steps at impacts calls `begin_batch`, `resolve_meeting` at each impact, and `end_batch`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.errors import PhysicsError
from carom.physics.aligned import Buffer
from carom.physics.bodies import Bodies
from carom.physics.contact.boundary_motion import BoundaryMotion
from carom.physics.contact.broad_phase.planes import PlaneGuard
from carom.physics.contact.contact_checkpoint import ContactCheckpoint
from carom.physics.contact.contact_tap import ContactTap, Impulses
from carom.physics.contact.graph import OrderedContacts, empty_graph
from carom.physics.contact.impact_log import NO_IMPACTS, Impacts
from carom.physics.contact.impact_totals import ImpactTotals
from carom.physics.contact.near_pairs import ContactWorld, NearPairs
from carom.physics.contact.reactions import Torques, supported_acceleration
from carom.physics.contact.snapshot import SnapshotSource
from carom.physics.contact.solver.contact_solver import MOST_SWEEPS, ContactSolver
from carom.physics.contact.solver.positions import BAUMGARTE
from carom.physics.contact.solver.prepare import ImpulseCache
from carom.physics.contact.statistics import NO_CONTACTS, limits_of, still_closing
from carom.physics.contact.sticking import SlidingContacts, time_to_stick
from carom.physics.diagnostics.dissipation import SignsOfDissipation
from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.jit.team import Team
from carom.plan.features import Requirements
from carom.registry import load
from carom.scene.rest_speed import PER_STEP
from carom.scene.schema import ContactSettings

if TYPE_CHECKING:
    from carom.physics.contact.events.drift import EventDrivenDrift
    from carom.physics.contact.sleep.sleepers import Sleepers, SleepingContacts

NO_ENTRIES: FloatArray = np.zeros((0, 3))
# rad, of the normal of a contact in a step where walls alone press. On a chord, a body with the tangential velocity v
# advances by the angle arcsin(v dt/f), and is ahead by a sixth of its square: 7 × 10⁻⁵ of its path.
LARGEST_TURN = 0.02


class ContactPipeline:
    """Detects the contacts of each step and resolves them.

    With ``totals`` of impacts, `tap` collects the impulses of each contact.
    """

    def __init__(
        self,
        contact: ContactSettings,
        bodies: Bodies,
        world: ContactWorld,
        requirements: Requirements,
        team: Team,
        totals: ImpactTotals | None = None,
    ) -> None:
        planes, materials = world.planes, world.materials
        # in a sheared box, contacts either last or are impacts during the drift
        self._shear = None if requirements.impact_time.modelled else world.shear
        self._skips_end = world.shear is not None and self._shear is None
        self._flow = world.flow(float(bodies.radius.max()))  # m/s²
        box = self._shear.at_present if self._shear else world.box
        self.settings = contact  # the section of the scene
        self._bodies = bodies
        self.boundary = BoundaryMotion(bodies, planes, self._shear)
        self._field, self._team, self._needs = world.field, team, requirements
        self._lasts = contact.solver == "lasting" and requirements.resting.modelled
        self._near = NearPairs(contact, bodies, world, self._lasts, team)
        self.most_sweeps = contact.sweeps if isinstance(contact.sweeps, int) else MOST_SWEEPS[contact.sweeps]
        self._pushes = contact.stabilisation == "split"
        self._guard = PlaneGuard(bodies, planes, team) if len(planes) else None
        self._was_crossed = False  # whether a body was put back in front of a plane in this step
        self.warned: set[str] = set()  # texts of the limits reported so far
        friction = requirements.friction.modelled
        # islands are of interest only where contacts last
        sweeps = contact.sweeps if self._lasts or contact.sweeps != "auto" else "converged"
        self.solver = ContactSolver(bodies, planes, materials, box, friction, team, totals is not None, sweeps)
        if not self._lasts:
            self.solver.assume_loads()
        self._near.pressing = self.solver.pressing[: len(bodies)]
        self.torques = Torques(bodies, team)
        self.contacts = OrderedContacts.of(empty_graph().pairs, bodies, contact.colouring)  # the contacts of the step
        self.snapshots = SnapshotSource(self.solver, bodies.ends.inverse_mass)
        self.event_drift: EventDrivenDrift | None = None
        if requirements.impact_time.modelled:
            event_driven = load("model", "time-of-impact")
            drift = (friction, self._near.has_statics, requirements.resting.modelled)
            self.event_drift = event_driven(bodies, world, self.solver.loads, *drift, self._near.search, team)
            self.event_drift.pressing = self.solver.pressing
        self.tap = ContactTap(bodies, materials, box, friction, totals) if totals else None
        self.signs = SignsOfDissipation(bodies, materials, not planes.moves and world.shear is None, planes.moves)
        self.sleepers: Sleepers | None = None
        if contact.sleep and self._lasts:
            self.sleepers = load("model", "sleep")(contact.sleep, bodies, planes, box)
        self._compile()

    def forget(self) -> None:
        """Return to the state before the first step."""
        self._impulses = ImpulseCache.empty()
        if self._lasts:
            self.solver.find_loads(0.0)
        self._order_contacts(empty_graph().pairs, 0.0)
        self._fell_asleep = False  # whether contacts fell asleep at the end of this step
        self._slept: SleepingContacts | None = None  # contacts that slept in this step
        self._lost = NO_ENTRIES  # J, ledger of the contacts that woke in this step or fell asleep after it
        self._first_kick = 0.0  # s, the first kick of the step
        if self.sleepers:
            self.sleepers.forget()
        if self._needs.torque.modelled:
            self.torques.remember()
        self.ledger_apart = NO_ENTRIES  # (k, 3) J, entries of the step that belong to no contact
        self.impacts: Impacts = NO_IMPACTS  # of the drift
        self.statistics = NO_CONTACTS  # of the step's contacts
        self.counts_impacts = True  # whether they include impacts during the drift; a look-ahead needs no statistics
        self.snapshots.forget()
        self.boundary.forget()
        self.signs.forget()
        if self.tap:
            self.tap.forget()

    @property
    def memory(self) -> ContactCheckpoint | None:
        """A copy of the state that the next step needs; None if contacts cannot last."""
        if not self._lasts:
            return None
        hold, sleepers = self._impulses, self.sleepers
        pairs, (rest_speed, load_speed) = self.contacts.pairs, self.solver.speeds_by_pair()
        impulse = hold.impulse_of(self.solver.contacts)
        if sleepers is None:
            moved = self.boundary.memory
            return ContactCheckpoint(
                pairs, rest_speed, load_speed, self._dt, hold.pairs, impulse, hold.kick, piston=moved
            )
        awake, held = sleepers.have_awake_end(pairs), sleepers.have_awake_end(hold.pairs)
        kept = pairs[awake], rest_speed[awake], load_speed[awake], self._dt, hold.pairs[held], impulse[held], hold.kick
        return ContactCheckpoint(*kept, sleepers.memory)

    @property
    def supported_acceleration(self) -> FloatArray:
        """(n + p,) m/s², the supported acceleration of each body in the last kick; empty if contacts supported none."""
        inverse_mass = self._bodies.ends.inverse_mass
        by_awake = supported_acceleration(self._impulses, inverse_mass)
        if not (self.sleepers and self.sleepers.any) or self._fell_asleep:
            return by_awake
        slept = self.sleepers.contacts
        by_sleepers = supported_acceleration(ImpulseCache(slept.pairs, slept.place, slept.contacts, 1.0), inverse_mass)
        return by_sleepers + by_awake if len(by_awake) else by_sleepers

    def recall(self, memory: ContactCheckpoint | None) -> None:
        """Restore the state of `memory`; positions must already be those of that step."""
        self.forget()
        if memory is not None:
            if memory.highest >= len(self._bodies.ends.radius):
                raise PhysicsError("the checkpoint has contacts of bodies that are not in the scene")
            self.boundary.recall(memory.piston)
            if self.sleepers:
                self.sleepers.recall(memory.sleep)
                self._slept = self.sleepers.contacts
            self._recall_contacts(memory)

    def _recall_contacts(self, memory: ContactCheckpoint) -> None:
        """Restore the contacts that are not asleep."""
        self._order_contacts(memory.pairs, memory.dt)
        self.solver.rest_speed[self.solver.order.place] = memory.rest_speed
        self.solver.load_speed[self.solver.order.place] = memory.load_speed
        self._presses = bool(memory.load_speed.max(initial=0.0) > 0.0)
        self._impulses = ImpulseCache.of(memory.held_pairs, memory.impulse, memory.kick)

    def begin(self, dt: float) -> None:
        """Find the contacts at the start of a run whose first step is about dt s."""
        if self._lasts:
            self._order_contacts(self._near.find(dt), dt)

    def hold(self, kick: float, dt: float, booked: float, against: FloatArray | None = None) -> None:
        """Hold the contacts of the previous step after the first kick, so that they do not close during the drift.

        Times are in s. ``booked`` is the part of the drift dt for which the work of the forces is already booked: the
        length of the kick, unless there is drag. Contacts hold against the accelerations ``against``, (n + p, 3) m/s²
        (default: those of the bodies).
        """
        if self._needs.torque.modelled:
            self.torques.remember()
        self.ledger_apart, self._lost, self._first_kick = NO_ENTRIES, NO_ENTRIES, kick
        if self._fell_asleep:  # contacts that fell asleep after the last step are no longer computed
            memory = self.memory
            assert memory is not None and self.sleepers is not None, "only lasting contacts fall asleep"
            self._recall_contacts(memory)
            self._fell_asleep, self._slept = False, self.sleepers.contacts
        self.boundary.begin(dt, booked)
        if self._guard:
            self._guard.remember()
        if self.event_drift is not None and self._lasts:  # mark the bodies that contacts pressed in the last step
            pressed = self.solver.pressed
            pressed[:] = False
            if self.sleepers:
                pressed[: len(self._bodies)] = self.sleepers.asleep
            self.solver.mark_pressed(self._impulses)
        if self._is_at_rest():
            if self.tap:  # a step begins; these entries belong to the previous step, which is already booked
                self.solver.ledger[:] = 0.0
            if self.signs.judges:
                self.signs.before_hold(self.contacts, self.solver, self._impulses)
            self._hold_contacts(self._dt, kick, dt, 0.0, booked, against)
            if self.signs.judges and kick > 0.0:
                self.signs.after_hold(self.contacts, self.solver, kick)
            self.ledger_apart = self.solver.audited
            self.solver.find_loads(kick)
            self.boundary.add_contacts(self.solver, self.solver.contacts)
            if self.tap:
                self.tap.add_hold(self.contacts.pairs, self.solver)
        elif self._lasts:
            self.solver.find_loads(0.0)
        self.boundary.begin_drift()

    def drift(self, kick: float, dt: float, damping: float = 0.0, strength: float = 1.0) -> None:
        """Move all bodies for dt after a kick, both in s, and resolve impacts at their own times.

        Drag slows bodies down at the rate ``damping`` in 1/s; see `DampedPath`.
        """
        assert self.event_drift is not None, "the scene asks for times of impact"
        if self.sleepers and self.sleepers.all:
            self.impacts = NO_IMPACTS
            return
        held = self._impulses if self._is_at_rest() else ImpulseCache.empty()
        asleep = self.sleepers.asleep if self.sleepers else None
        self.impacts = self.event_drift.drift(
            kick, dt, *self._near.margins(dt), self._near.loading, held, self.solver.pressed, asleep, damping, strength
        )
        if len(self.impacts):
            self.boundary.add_impacts(self.impacts.log)
            self.signs.judge_impacts(self.impacts, dt, self.solver.loads)
        if self.tap:
            self.tap.add_drift(self.impacts)

    @property
    def longest_step(self) -> float:
        """The longest step (s) that walls allow: by the motion of a piston, or by the turning of a normal."""
        turning = self.solver.turning if self._presses else 0.0
        return min(self.boundary.longest_step, LARGEST_TURN / turning if turning > 0.0 else np.inf)

    @property
    def is_quiet(self) -> bool:
        """Whether nothing touched in the last step, and nothing is held at the start of the next one."""
        touches = len(self.contacts) or self.statistics.contacts or len(self._impulses.pairs)
        return not (touches or self._is_at_rest() or (self.sleepers and self.sleepers.any))

    @property
    def holds(self) -> bool:
        """Whether contacts are held at the start of the next step."""
        return len(self._impulses.pairs) > 0

    def step_by_impacts(self, span: float) -> float:
        """Return the longest step (s) that the next impact allows; infinite if there is none within a span (s)."""
        assert self.event_drift is not None, "the integrator ends its steps at impacts"
        return self.event_drift.step_by_impacts(self.contacts.pairs, span)

    def time_to_stick(self, dt: float, tolerance: float) -> float:
        """Return the time (s) until a held contact stops sliding or rolling; see `sticking`."""
        held, contacts = self._impulses, self.contacts
        if not (self._needs.friction.modelled and held.kick > 0.0 and np.array_equal(held.pairs, contacts.pairs)):
            return np.inf
        records = self.solver.contacts
        moving = SlidingContacts(contacts.pairs, contacts.order.place, records, held.impulse_of(records), held.kick)
        return time_to_stick(moving, self._bodies.ends, dt, tolerance)

    def add_quiet_steps(self) -> None:
        """Account for steps without contacts that followed a quiet step."""
        self.ledger_apart, self.impacts, self.statistics = NO_ENTRIES, NO_IMPACTS, NO_CONTACTS
        self.snapshots.set_quiet(self.contacts)

    @property
    def is_steady(self) -> bool:
        """Whether the contacts of the last step are held as the next one begins, and nothing else happened in it."""
        held, statistics, stopped = self._impulses, self.statistics, self._guard is not None and self._guard.has_stopped
        are_held = held.contacts is self.solver.contacts and held.place is self.contacts.order.place and held.kick > 0.0
        happened = stopped or len(self.impacts) or statistics.impacts or self.contacts.overflows
        return self._is_at_rest() and are_held and statistics.contacts > 0 and not happened

    @property
    def last_kick(self) -> float:
        """Length in s of the kick in which the contacts were last held; 0 if none were."""
        return self._impulses.kick

    def add_steady_steps(self, kick: float, dt: float, sweeps: int) -> None:
        """Account for steps with the same contacts; ``kick`` and ``dt`` are those of the last step, in s."""
        self._impulses = ImpulseCache(self.contacts.pairs, self.contacts.order.place, self.solver.contacts, kick)
        self._dt, self.sweeps = dt, sweeps
        self.ledger_apart, self.impacts = NO_ENTRIES, NO_IMPACTS
        self.snapshots.set_step(self.contacts, None, NO_IMPACTS, dt)
        self.statistics = self.solver.statistics()

    def begin_batch(self) -> None:
        """Begin steps that end at impacts, before the bodies move."""
        if self._needs.torque.modelled:
            self.torques.remember()
        self.impacts = NO_IMPACTS

    def resolve_meeting(self, pair: tuple[int, int] | None, dt: float) -> None:
        """Resolve impacts of pairs that touch at the end of a step of dt s; without a pair, only load the kernels."""
        assert self.event_drift is not None, "the integrator ends its steps at impacts"
        self.impacts = self.impacts.followed_by(self.event_drift.resolve_meeting(pair, dt))

    def end_batch(self, dt: float, profile: Profile) -> None:
        """Collect the effects of the impacts at the end of the last step, of dt s."""
        if self.tap:
            self.tap.add_drift(self.impacts)
        self.resolve(dt, 0.0, profile)
        if self._needs.torque.modelled:
            self.torques.write(dt)

    def find(self, dt: float, profile: Profile) -> None:
        """Find the contacts at the present positions, colour them, and correct the overlaps of resting ones."""
        self.boundary.arrive()
        if self._skips_end:
            return
        self._was_crossed = self._guard is not None and self._guard.stop()
        sleepers = self.sleepers
        if sleepers and sleepers.all and not sleepers.is_disturbed():
            pairs = empty_graph().pairs
        else:
            pairs = self._near.find(dt)
            if sleepers:  # wake the islands that are disturbed; pairs of sleepers are not computed
                self._impulses, self._lost = sleepers.wake(pairs, self._impulses, self._first_kick, dt)
                if self.tap and len(self._lost):
                    self.tap.copy_hold()
                self._slept = sleepers.contacts
                pairs = sleepers.awake(pairs)
        profile.mark("search")
        if len(pairs) == 0 and len(self.contacts) == 0:
            return
        self._order_contacts(pairs, dt)
        profile.mark("colouring")
        if self._pushes and len(pairs):
            self.boundary.add_corrections(self.solver, self.solver.correct_positions(self.most_sweeps))
            if self._guard:
                self._guard.stop()
        profile.mark("stabilisation")

    def resolve(self, dt: float, kick: float, profile: Profile) -> None:
        """Apply the impulses of these contacts after the last kick of a step, both in s, at the final positions."""
        self.boundary.finish()
        if self._guard and self._guard.has_stopped:
            self.ledger_apart = np.concatenate((self.ledger_apart, self._guard.work()))
        if len(self.contacts):
            self._resolve(dt, kick, profile)
        else:
            self._impulses = ImpulseCache.empty()
        self.boundary.settle()
        self.solver.find_pressing()  # of the state that a checkpoint stores
        self.snapshots.set_step(self.contacts, self._slept, self.impacts, dt)
        self.statistics = self.solver.statistics() if len(self.contacts) else NO_CONTACTS
        if self._slept:
            self.statistics = self.statistics.plus(self._slept.statistics)
        if len(self.impacts) and self.counts_impacts:
            self._count_impacts()
        if self.signs.judges and len(self.contacts):
            self.signs.judge_contacts(self.contacts, self.solver, self.impacts, dt, kick)

    def fall_asleep(self, dt: float) -> None:
        """Put islands that have been slow for long enough to sleep, after a step of dt s."""
        assert self.sleepers is not None, "the scene has contact.sleep"
        lost = self.sleepers.fall_asleep(self.contacts.pairs, self._impulses, dt)
        self._fell_asleep = len(lost) > 0
        self._lost = np.concatenate((self._lost, lost))
        if len(self._lost):
            self.ledger_apart = np.concatenate((self.ledger_apart, self._lost))

    def rows(self, buffer: Buffer | None = None) -> Records:
        """Return the contact table of the last step, (m,) `CONTACT_ROW`; see `ContactTap.rows`."""
        assert self.tap is not None, "contacts are recorded"
        return self.tap.rows(self.contacts.pairs, self.solver, buffer, self._slept)

    def impulses(self) -> Iterator[Impulses]:
        """Yield the impulses of the last step in the order in which they acted, if contacts are recorded."""
        assert self.tap is not None, "contacts are recorded"
        return self.tap.impulses(self.solver)

    def work(self) -> FloatArray:
        """Return the ledger of the last step's contacts and of bodies stopped at planes, (k, 3) J."""
        assert self.tap is not None, "contacts are recorded"
        work = np.concatenate((self.tap.work(self.solver), self._lost))
        return np.concatenate((work, self._guard.work())) if self._guard and self._guard.has_stopped else work

    def limits_reached(self) -> list[tuple[str, str]]:
        """Return the limits of the method first reached in this step: level, `WARN` or `INFO`, and text."""
        reached = limits_of(
            self.settings,
            serial_stage=self.contacts.overflows and not self.boundary.is_guided,  # each of its contacts has a colour
            too_few_sweeps=self._too_few_sweeps,
            exhausted=self.event_drift is not None and self.event_drift.is_exhausted,
            crossed=self._was_crossed,
            deepest=self.statistics.deepest,
            at_impacts=self.event_drift is not None,
        )
        fresh = [(level, text) for level, text in reached if text not in self.warned]
        self.warned.update(text for _, text in fresh)
        return fresh

    def _count_impacts(self) -> None:
        """Add the impacts during the drift to the statistics of the step."""
        records = (self.contacts, self.solver.contacts, self.solver.states)
        self.statistics = self.statistics.with_impacts(self.impacts, *records, self._bodies.ends.inverse_mass)

    def _order_contacts(self, pairs: IntArray, dt: float) -> None:
        """Begin the contacts of a step of dt s: order them, lay out their records, and find their rest speeds."""
        # a pile at rest keeps its contacts, and therefore their order
        if not np.array_equal(pairs, self.contacts.pairs):
            self.contacts = OrderedContacts.of(pairs, self._bodies, self.settings.colouring)
        self.solver.lay(self.contacts.order, self._impulses.contacts, self._near.rounding)
        loaded = self._near.loading * dt
        self._presses = self._needs.resting.modelled and self.solver.find_rest_speeds(self._field, loaded)
        if self._shear and self._needs.resting.modelled:
            closing = PER_STEP * self._flow * dt  # m/s
            for speeds in (self.solver.rest_speed, self.solver.load_speed):
                np.maximum(speeds, closing, out=speeds)
            self._presses = self._presses or (closing > 0.0 and len(pairs) > 0)
        self._dt, self.sweeps, self._too_few_sweeps = dt, 0, False

    def _resolve(self, dt: float, kick: float, profile: Profile) -> None:
        contact, solver = self.settings, self.solver
        solver.update_geometry()
        if self._pushes:
            solver.audit_corrections()
        self.boundary.accelerate()
        bias_rate = BAUMGARTE / dt if contact.stabilisation == "baumgarte" else 0.0
        lasting = self._is_at_rest()
        # where a piston or a force acts on some bodies only, others are near without being pressed: open gaps stay open
        impacts_only = lasting or self._near.lists_open
        self.sweeps = solver.resolve_impacts(bias_rate, self.most_sweeps, impacts_only=impacts_only)
        if self.tap:
            self.tap.add_impacts(self.contacts.pairs, solver)
        profile.mark("response")
        if lasting and (solver.any_rests or self.sweeps == self.most_sweeps):
            held = self._hold_contacts(dt, kick, 0.0, bias_rate, kick)
            self.sweeps = max(self.sweeps, held)
            profile.mark("resting")
        else:
            self._impulses = ImpulseCache.empty()
        self.boundary.add_contacts(solver, solver.recorded)
        self.boundary.add_contacts(solver, solver.contacts)
        self.boundary.rest()
        if self.sweeps >= self.most_sweeps and still_closing(contact) not in self.warned:
            self._too_few_sweeps = solver.is_closing(dt)
        profile.mark("response")

    def _is_at_rest(self) -> bool:
        """Return whether contacts may be at rest: without a force that presses them together, all are impacts."""
        return self._lasts and self._presses

    def _hold_contacts(
        self, dt: float, kick: float, drift: float, bias_rate: float, booked: float, against: FloatArray | None = None
    ) -> int:
        """Hold the contacts after a kick and before a drift (0: no drift); times in s. Return the number of sweeps."""
        solver, pairs = self.solver, self.contacts.pairs
        place = solver.order.place
        self._impulses.carry_to(pairs, place, kick, solver.contacts, self._team)
        if kick > 0.0:  # Euler's step ends without a kick, so the next one starts from the impulses of the first kick
            self._impulses = ImpulseCache(pairs, place, solver.contacts, kick)
        return solver.hold(dt, booked, drift, bias_rate, self.most_sweeps, against)

    def _compile(self) -> None:
        """Run every kernel without contacts, so that the first contact does not wait for compilation."""
        self.forget()
        if self._pushes:
            self.boundary.add_corrections(self.solver, self.solver.correct_positions(1))
        self._resolve(1.0, 1.0, Profile())
        self.solver.is_closing(1.0)
        self.solver.statistics()
        if self.event_drift:
            self.impacts = Impacts(self.event_drift.log[:0])
            self._count_impacts()
            self.boundary.add_impacts(self.impacts.log)
            self.signs.judge_impacts(self.impacts, 1.0, self.solver.loads)
        if self._lasts:
            self.signs.before_hold(self.contacts, self.solver, self._impulses)
            for drift in (1.0, 0.0):
                self._hold_contacts(1.0, 1.0, drift, 0.0, 1.0)
            self.signs.after_hold(self.contacts, self.solver, 1.0)
        self.signs.judge_contacts(self.contacts, self.solver, NO_IMPACTS, 1.0, 1.0)
        if self._needs.torque.modelled:
            self.torques.write(1.0)
        if self.tap:
            self.rows()
        self.forget()
