"""`Space`: the order of one step, and the run of many."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carom.physics.aligned import Room
from carom.physics.bodies import Bodies
from carom.physics.checkpoint import Books, Checkpoint
from carom.physics.contact.constraint_graph import CollisionGraph, empty_graph
from carom.physics.contact.contact_table import CONTACT_ROW
from carom.physics.contact.continuous.drift import NO_IMPACTS, Impacts
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.contact.support import NOTHING_BORNE
from carom.physics.diagnostics.activity import Activity
from carom.physics.diagnostics.audit import Audit
from carom.physics.diagnostics.energy import Energy
from carom.physics.diagnostics.extremes import NOTHING, Extremes
from carom.physics.diagnostics.fingerprint import fingerprint
from carom.physics.diagnostics.finite import refuse_infinities, refuse_lost_turns
from carom.physics.diagnostics.impulse_audit import ImpulseAudit
from carom.physics.diagnostics.ledger import Ledger
from carom.physics.diagnostics.pace import PaceMonitor, PaceTally
from carom.physics.diagnostics.profile import Profile
from carom.physics.error import PhysicsError
from carom.physics.event import Event
from carom.physics.forces.force import DampedStep, Damping, Exchange, Force, Potentials, accelerate, forces_of
from carom.physics.forces.gravity import gravity_of
from carom.physics.frame import Frame, FrameStore, copies
from carom.physics.integrators.gauss_radau15 import GaussRadau15
from carom.physics.integrators.kick_drift import drift, kick, wrap
from carom.physics.parallel.cores import cores
from carom.physics.parallel.thread_team import Team
from carom.physics.pull_time import PullTime
from carom.physics.reference_api import BodyProxy
from carom.physics.rotation import rotate
from carom.physics.schedule import Schedule, at, every, quiet
from carom.physics.status import StepStatus
from carom.physics.time_step import Timestep
from carom.plan.auto import frame_interval, integrator
from carom.plan.features import require
from carom.plan.limits import refuse_impossible
from carom.plan.step_limits import StepLimits, step_limits, wider_limits
from carom.scene.half_space import half_spaces
from carom.scene.names import Names
from carom.scene.placement import Start, place
from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]
Rows = NDArray[np.void]

WARM_UP_STEPS = 3
WARM_UP_DT = 1e-3  # of the step that the limits allow at the start


class Space:
    """A simulation of a scene, with the public calls of the reference engine and more.

    One thread steps it. Meanwhile other threads may only read ``status`` and call ``stop``.

    Parameters
    ----------
    scene
        The scene to simulate.
    threads
        Threads for the kernels, by default one per core. The bits do not depend on it.
    start
        Initial states of the bodies, by default those that the scene places.
    stride
        Up to so many times the steps that the scene asks for, as far as the method bears: for a coarse look ahead,
        which counts in `foreseen` the steps that the scene would take.
    record_contacts
        Whether frames carry what the contacts did, in `Frame.impacts` and `Frame.contact_rows`. The bits do not depend
        on it.

    Raises
    ------
    SceneError
        If the scene cannot run on this machine or in this version, or its bodies cannot be placed.
    """

    def __init__(
        self,
        scene: Scene,
        threads: int | None = None,
        start: Start | None = None,
        stride: float = 1.0,
        record_contacts: bool = False,
    ) -> None:
        refuse_impossible(scene)
        self.scene = scene
        self.requirements = require(scene)
        start = start or place(scene)
        self.names = start.name
        self.groups = start.group
        self.planes = half_spaces(scene)
        self.state = Bodies.at_start(
            start,
            spins=self.requirements.spin.modelled,
            orients=self.requirements.orientation.modelled,
            torques=self.requirements.torque.modelled,
            planes=len(self.planes),
        )
        self.threads = threads or cores()
        self._team = Team(self.threads)
        self.time = 0.0  # s
        self.step = 0
        self.dt = 0.0  # s
        self.dt_limit = "start"
        self.extremes = self._beginning(Extremes())
        self.profile = Profile()
        self._box = np.array(scene.domain.size if scene.domain.boundary == "periodic" else (0.0, 0.0, 0.0))
        self._fixed = np.flatnonzero(start.fixed)
        # if something is fixed, speeds are relative to it, and the field does not accelerate all alike
        self._forces: list[Force] = forces_of(scene, self.requirements, self.state, self._team)
        self._uniform = np.sum([np.zeros(3), *(force.uniform for force in self._forces)], axis=0)
        self._falling = np.zeros(3) if scene.anchored else self._uniform
        self._damping = next((force for force in self._forces if isinstance(force, Damping)), None)
        self._exchanged: list[Exchange] = []  # with a medium, in this step
        self._last_kick = 0.0  # s, of the step
        self._substeps = integrator(scene).substeps
        self.ends_with_forces = integrator(scene).ends_with_forces
        self._records_contacts = record_contacts
        audited = scene.expect.contact_audit is not None
        self._contact = self._make_contact(record_contacts or audited)
        self._impulse_audit = ImpulseAudit(self.state) if audited else None
        self._timestep = self._make_timestep(step_limits(scene))
        self._radau = self._make_error_controlled()
        self._asked: Timestep | None = None  # what the scene asks for, where longer steps are taken
        if stride > 1.0 and self._radau is None:
            self._asked, self._timestep = self._timestep, self._make_timestep(wider_limits(scene, stride))
        self.foreseen: dict[str, float] = {}  # steps that the scene would have taken so far, by what sets them
        self._called = Names(self.names, self.planes.name)
        losses = [force.kind.loss for force in self._forces if force.kind.loss]
        constant = self._potential_of_fixed_bodies()
        self._audit = Audit(scene, self.state, self._called, self._uniform, constant, losses)
        self._events: list[Event] = []
        self._activity = Activity(len(self.state), scene.anchored or bool(self._uniform.any()))
        self._stopping = False
        potentials = self._warm_up()
        limited = scene.time.fixed_dt is None and self._radau is None
        self._pace = PaceMonitor(scene.time.duration, self.first_dt) if limited else None
        self._take_stock(potentials, checked=True)
        self._publish()
        self.profile.clear()

    @property
    def records_contacts(self) -> bool:
        """Whether frames carry what contacts did."""
        return self._records_contacts

    @property
    def box(self) -> FloatArray | None:
        """Size of the periodic domain, (3,) m, or None in open space."""
        return self._box if self._box[0] > 0.0 else None

    @property
    def contacts(self) -> CollisionGraph:
        """The contacts of the last step, for the stepping thread; built at the first access."""
        return self._contact.seen.graph if self._contact else empty_graph()

    @property
    def status(self) -> StepStatus:
        """The status at the end of the last finished step; any thread may read it."""
        return StepStatus(*self._published)

    @property
    def first_dt(self) -> float:
        """The step in seconds that the limits allow in the present state."""
        return self.scene.time.fixed_dt or self._timestep.target(self.state, self._borne())[0]

    def between(self, time: float) -> tuple[FloatArray, FloatArray] | None:
        """Return positions and velocities, (n, 3) m and m/s, at a time within the last step, in s.

        None where the integrator has no solution between the steps.
        """
        return self._radau.at(self.time - time) if self._radau else None

    @property
    def ledger(self) -> Ledger:
        """The energies of contacts and forces since the start of the run."""
        return self._audit.ledger

    @property
    def impacts(self) -> Impacts:
        """The impacts during the drift of the last step, in the order of time; empty with end-of-step timing."""
        return self._contact.impacts if self._contact else NO_IMPACTS

    @property
    def bodies(self) -> list[BodyProxy]:
        """One view for each body, in the order of the scene."""
        return [BodyProxy(self.state, index) for index in range(len(self.state))]

    def compute_dynamics(self, iteration: int) -> None:
        """Compute one step.

        Parameters
        ----------
        iteration
            Number of the step; every ``record.check_every``-th checks the energy.

        Raises
        ------
        PhysicsError
            If the state is no longer finite.
        """
        self._advance(np.inf, checked=iteration % self.scene.record.check_every == 0, schedule=at(()), most=1)

    def get_body_data_for_display(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions (n, 3), quaternions (n, 4) xyzw, torques (n, 3) and angular accelerations (n, 3) as copies.

        Orientations or torques that the scene does not require are the identity and zeros.
        """
        state, n, needs = self.state, len(self.state), self.requirements
        orientation = state.orientation if needs.orientation.modelled else np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
        torque, alpha = np.zeros((n, 3)), np.zeros((n, 3))
        if needs.torque.modelled:
            torque, alpha = state.torque.copy(), state.angular_acceleration.copy()
        return state.position.copy(), orientation.copy(), torque, alpha

    def energy(self) -> Energy:
        """Return the present energy: terms, ledger, integration error."""
        return self._audit.energy_now(self._potentials())

    def momentum(self) -> FloatArray:
        """Σ m v, (3,) kg m/s."""
        return self._audit.momentum_now(self.time).linear

    def angular_momentum(self) -> FloatArray:
        """Σ (m x × v + I ω) about the origin, (3,) kg m²/s."""
        return self._audit.momentum_now(self.time).angular

    def fingerprint(self) -> int:
        """64 bits of the exact state."""
        return fingerprint(self.state, self.time)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore a checkpoint of the same scene; the following steps have the same bits as after the original.

        The torques and the contact graph of the previous step are not stored, so they are empty until the next step.
        """
        state, books = self.state, checkpoint.books
        state.position[:] = checkpoint.position
        state.velocity[:] = checkpoint.velocity
        state.acceleration[:] = checkpoint.acceleration
        state.torque[:] = 0.0
        state.angular_acceleration[:] = 0.0
        if checkpoint.orientation is not None:
            state.orientation[:] = checkpoint.orientation
        if checkpoint.angular_velocity is not None:
            state.angular_velocity[:] = checkpoint.angular_velocity
        self.step, self.time = checkpoint.step, checkpoint.time
        self.dt, self.dt_limit = 0.0, "start"
        self._timestep.previous = checkpoint.previous_dt
        if self._radau:
            self._radau.restore(checkpoint.integrator, checkpoint.previous_dt)
        if self._contact:
            self._contact.recall(checkpoint.contacts)
            self._contact.warned = set(books.limits)
        if self._pace:
            self._pace.tally = books.pace
        self._audit.reopen(books, checkpoint.energy.ledger)
        self.extremes = self._beginning(books.moments)
        self._activity.reopen(books.phase, books.activity)
        self._events = []
        self._take_stock(self._potentials(), checked=False)
        self._publish()

    def run(
        self, until: float | None = None, store: FrameStore | None = None, schedule: Schedule | None = None
    ) -> Iterator[Frame]:
        """Step until a time, by default the scene's duration, and yield the frames that ``record.every`` requests.

        The first frame is the present state, the last one the state at the end. Frames do not change the steps.

        Parameters
        ----------
        until
            s.
        store
            Memory for the arrays of the frames; without it each frame owns its arrays.
        schedule
            After which steps frames are yielded; by default as ``record.every`` says.

        Raises
        ------
        PhysicsError
            If the state is no longer finite, or a step no longer changes the clock.
        """
        end = self.scene.time.duration if until is None else until
        schedule = schedule or every(frame_interval(self.scene))
        yield self.frame(store)
        shown = self.step
        while self.time < end and not self._stopping:
            checked = (self.step + 1) % self.scene.record.check_every == 0
            if self._advance(end, checked, schedule):
                yield self.frame(store)
                shown = self.step
        if self.step != shown:  # stopped
            yield self.frame(store)

    def stop(self) -> None:
        """Let `run` end after the current step, with a last frame; any thread may call it."""
        self._stopping = True

    def highlights(self) -> tuple[Event, ...]:
        """Return the extremes of the run so far as events, each at its own time."""
        return self.extremes.highlights(self._called)

    def named_extremes(self) -> Extremes:
        """Return the extremes of the run so far, with bodies and planes by their names."""
        return self.extremes.named(self._called)

    def frame(self, store: FrameStore | None = None) -> Frame:
        """Copy the state of the last step, with its energy and momentum."""
        if self._audit.step != self.step:
            self._take_stock(self._potentials(), checked=True)
        self._activity.judge(self._audit.energy)
        state, needs, momentum = self.state, self.requirements, self._audit.momentum
        events, self._events = tuple(self._events), []
        slot = None if store is None else store.keep(state)
        room = None if store is None or slot is None else store.contact_rows[slot]
        impacts, left_out, contact_rows = self._recorded_contacts(room)
        arrays = copies(state) if store is None or slot is None else store.kept(slot)
        position, velocity, acceleration, orientation, angular_velocity, torque, angular_acceleration = arrays
        return Frame(
            step=self.step,
            time=self.time,
            dt=self.dt,
            dt_limit=self.dt_limit,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            orientation=orientation if needs.orientation.modelled else None,
            angular_velocity=angular_velocity if needs.spin.modelled else None,
            torque=torque if needs.torque.modelled else None,
            angular_acceleration=angular_acceleration if needs.torque.modelled else None,
            contacts=self.contacts,
            energy=self._audit.energy,
            momentum=momentum.linear,
            angular_momentum=momentum.angular,
            sweeps=self._contact.sweeps if self._contact else 0,
            phase=self._activity.phase,
            events=events,
            fingerprint=self.fingerprint(),
            previous_dt=self._timestep.previous,
            memory=self._contact.memory if self._contact else None,
            books=self._books(),
            integrator=self._radau.checkpoint if self._radau else None,
            momentum_error=momentum.linear_error,
            angular_momentum_error=momentum.angular_error,
            slot=slot,
            impacts=impacts,
            impacts_left_out=left_out,
            contact_rows=contact_rows,
        )

    def _recorded_contacts(self, room: Room | None) -> tuple[Rows | None, int, Rows | None]:
        """Return the impacts since the last frame, how many more there were, and the contacts of the last step."""
        if not self._records_contacts:
            return None, 0, None
        if self._contact is None or self._contact.tap is None:
            return np.empty(0, CONTACT_ROW), 0, np.empty(0, CONTACT_ROW)
        return *self._contact.tap.take_impacts(), self._contact.rows(room)

    def _books(self) -> Books:
        return Books(
            energy=self._audit.energy_baseline,
            momentum=self._audit.momentum_baseline,
            watch=self._audit.monitor_state,
            moments=replace(self.extremes),
            activity=self._activity.impact_energy,
            phase=self._activity.phase,
            limits=tuple(sorted(self._contact.warned)) if self._contact else (),
            pace=self._pace.tally if self._pace else PaceTally(),
        )

    def _beginning(self, extremes: Extremes) -> Extremes:
        """Return a copy of the extremes so far that has an entry for all that this run looks at."""
        known, audited = extremes.contact_audit, self.scene.expect.contact_audit is not None
        return replace(extremes, contact_audit=NOTHING if audited and known is None else known)

    def _publish(self) -> None:
        """Replace the status that other threads read; they see either the previous or the new one."""
        contacts = self._contact.statistics.contacts if self._contact else 0
        # a plain tuple: a named one takes 0.2 µs to make, and a step of a few bodies takes 8
        self._published = (self.step, self.time, self.dt, self.dt_limit, contacts, self._audit.energy)

    def _make_timestep(self, limits: StepLimits) -> Timestep:
        scene, fraction = self.scene, limits.pull_fraction
        return Timestep(
            scene.time.model_copy(update={"max_dt": limits.max_dt}),
            limits.cfl,
            limits.target_dx,
            self._falling,
            scene.anchored,
            self._team,
            pull=None if fraction is None else PullTime(scene.gravity, fraction, self.state),
            smoothing=limits.smoothing,
            held_dx=limits.held_dx,
            held_part=limits.held_part,
        )

    def _borne(self) -> FloatArray:
        """Return the part of each acceleration that contacts bear, (n + p,) m/s²; empty if no step depends on it."""
        return self._contact.borne if self._contact and self._timestep.spares_held else NOTHING_BORNE

    def _make_contact(self, records: bool) -> ContactPipeline | None:
        if not self.requirements.contact.modelled:
            return None
        contact, needs = self.scene.contact, self.requirements
        return ContactPipeline(contact, self.state, self.planes, needs, self._box, self._falling, self._team, records)

    def _make_error_controlled(self) -> GaussRadau15 | None:
        if not integrator(self.scene).controls_error:
            return None
        state, rule, gravity = self.state, self.scene.time, self.scene.gravity
        pull = gravity.constant * state.mass if self.requirements.gravity.modelled else np.zeros(len(state))
        steps = (rule.max_dt, rule.fixed_dt)
        return GaussRadau15(state.position, state.velocity, pull, self._fixed, self._uniform, gravity.softening, *steps)

    def _advance(self, end: float, checked: bool, schedule: Schedule, most: int | None = None) -> bool:
        """Do a step, or up to ``most``; tell whether a frame is due, by the schedule or because it was the last.

        An integrator that controls its error does many steps in one call, up to the next check or frame.
        """
        if self._radau:
            due = self._steps(self._radau, end, checked, schedule, most or self.scene.record.check_every)
        else:
            due = self._step(end, checked, schedule)
        self._publish()
        return due

    def _steps(self, radau: GaussRadau15, end: float, checked: bool, schedule: Schedule, most: int) -> bool:
        """Do steps whose length follows from their error, up to the next check or frame."""
        self.profile.start()
        every, turns = self.scene.record.check_every, self.requirements.orientation.modelled
        silent, until = quiet(schedule, self.step, self.time)
        most = 1 if turns else int(min(most, silent, every - self.step % every))
        taken, before, self.time, self.dt, self.dt_limit = radau.advance(self.time, end, until, most)
        self.step += taken
        self._timestep.previous = radau.next_dt
        if not self.time > before:
            raise PhysicsError(self._stuck(before))
        refuse_infinities(self.state, self.names, self.step, self.time)
        if turns:
            rotate(self.state.orientation, self.state.angular_velocity, self.dt, self._team)
        limit = "error" if self.dt_limit == "end" else self.dt_limit  # of the steps, not of the run
        self.foreseen[limit] = self.foreseen.get(limit, 0.0) + taken
        self.profile.mark("integrate")
        due = schedule(self.step, before, self.time) or self.dt_limit == "end"
        checked = checked or due or self.step % every == 0
        potentials = self._accelerate(potential=checked)
        self._activity.see(0, 0.0)
        if checked:
            self._take_stock(potentials, checked)
        return due

    def _step(self, end: float, checked: bool, schedule: Schedule) -> bool:
        self.profile.start()
        state, contact = self.state, self._contact
        self.dt, self.dt_limit = self._timestep.choose(state, end - self.time, self._borne())
        before, self.time = self.time, end if self.dt_limit == "end" else self.time + self.dt
        if not self.time > before:
            raise PhysicsError(self._stuck(before))
        if self._asked:
            asked, limit = self._asked.target(state, self._borne())
            self.foreseen[limit] = self.foreseen.get(limit, 0.0) + (self.dt / asked if asked > 0.0 else np.inf)
        due = schedule(self.step + 1, before, self.time) or self.dt_limit == "end"  # a schedule sees every step
        checked = checked or due
        if checked and contact:
            self._audit.suspect(self.step, contact.seen.graph, contact.contributions)
        self.step += 1
        if contact and contact.tap:
            contact.tap.begin(self.step, before, self.time)
        if self._impulse_audit:
            self._impulse_audit.begin(self.ledger)
        self.profile.mark("timestep")
        potentials = self._integrate(self.dt, with_potential=checked)
        self._book_exchanges()
        if contact:
            self._respond(contact)
            if checked:
                self._audit.suspect(self.step, contact.seen.graph, contact.contributions)
        else:
            self._activity.see(0, 0.0)
        if self._impulse_audit:
            self._audit_impulses(self._impulse_audit)
        if checked:
            self._take_stock(potentials, checked)
        if self._pace and self.step % self.scene.record.check_every == 0:
            crawls = self._pace.look(self.step, self.time, *self._timestep.target(state, self._borne()))
            if crawls:
                self._log(crawls)
        return due

    def _integrate(self, dt: float, with_potential: bool) -> Potentials:
        """Kick, drift, kick; overlaps are undone after the last drift, so that forces belong to the final positions.

        The reference engine pushes bodies apart at the end of the step. The forces would then be those of other
        positions, the next kick would not be central, and angular momentum would drift by overlap × force; or they
        would have to be computed twice.
        """
        state = self.state
        pulls = self.requirements.pulls
        if self.requirements.orientation.modelled:
            rotate(state.orientation, state.angular_velocity, dt, self._team)
            self.profile.mark("orientation")
        potentials: Potentials = {}
        for index, substep in enumerate(self._substeps):
            last = index == len(self._substeps) - 1
            damped, first_kick, share = None, substep.before * dt, substep.before * dt
            self._last_kick = substep.after * dt
            if self._damping:
                damped = self._damping.step(dt)
                first_kick, share, self._last_kick = damped.held_kick, damped.share, damped.last_kick
                self._exchange(self._damping.begin, damped)
                self.profile.mark(self._damping.kind.short_name)
            elif pulls and substep.before:
                self._kick(substep.before * dt)
            if index == 0 and self._contact:
                self.profile.mark("integrate")
                self._hold(self._contact, first_kick, dt, share, damped)
                self.profile.mark("resting")
            if self._box[0] > 0.0:
                refuse_lost_turns(state.velocity, substep.drift * dt, self._box, self.step, self.time)
            if self._contact and self.requirements.impact_time.modelled:
                refuse_infinities(self.state, self.names, self.step, self.time, self._team)
                self._drift_to_impacts(self._contact, share, substep.drift * dt, damped)
                self.profile.mark("impacts")
            else:
                drift(state.position, state.velocity, substep.drift * dt, self._team)
                self.profile.mark("integrate")
            if last and self._contact:
                refuse_infinities(self.state, self.names, self.step, self.time, self._team)
                self._contact.find(dt, self.profile)
            if self._box[0] > 0.0:
                wrap(state.position, self._box, self._team)
            if pulls:
                if not last or self.ends_with_forces:
                    potentials = self._accelerate(with_potential and last)
                elif with_potential:
                    potentials = self._potentials()
                    self.profile.mark("gravity")
                if self._damping and damped:
                    self._exchange(self._damping.end, damped)
                    self.profile.mark(self._damping.kind.short_name)
                elif substep.after:
                    self._kick(substep.after * dt)
            self.profile.mark("integrate")
        return potentials

    def _kick(self, dt: float) -> None:
        """Kick for a time in s."""
        state = self.state
        kick(state.velocity, state.acceleration, dt, self._team)
        if self._impulse_audit:
            self._impulse_audit.see_kick(state.acceleration, dt)

    def _exchange(self, act: Callable[[DampedStep], Exchange], damped: DampedStep) -> None:
        """Let drag act on the velocities before or after the drift."""
        before = self.state.velocity.copy() if self._impulse_audit else None
        self._exchanged.append(act(damped))
        if self._impulse_audit and before is not None:
            self._impulse_audit.see_change(before)

    def _hold(self, contact: ContactPipeline, kick: float, dt: float, share: float, damped: DampedStep | None) -> None:
        """Hold contacts after the first kick, against what accelerates the bodies; times in s."""
        if self._damping is None or damped is None:
            contact.hold(kick, dt, share)
            return
        before = self.state.ends.velocity.copy()
        contact.hold(kick, dt, share, self._damping.against())
        if len(contact.held):
            loss = self._damping.lost_in_hold(damped, before)
            self._exchanged.append(Exchange(loss, np.zeros(3), np.zeros(3)))

    def _drift_to_impacts(self, contact: ContactPipeline, kick: float, dt: float, damped: DampedStep | None) -> None:
        """Drift, with impacts at their own times; kick and drift in s."""
        if self._damping is None or damped is None:
            contact.drift(kick, dt)
            return
        before = self.state.ends.velocity.copy()
        contact.drift(kick, dt, self._damping.along(damped))
        if len(contact.impacts):
            loss = self._damping.lost_in_impacts(damped, before, contact.impacts)
            self._exchanged.append(Exchange(loss, np.zeros(3), np.zeros(3)))

    def _accelerate(self, potential: bool) -> Potentials:
        """Fill the accelerations; return the potential energies if requested."""
        state = self.state
        energies = accelerate(self._forces, state.position, state.acceleration, potential, self.profile)
        if len(self._fixed):
            state.acceleration[self._fixed] = 0.0
        return energies

    def _potentials(self) -> Potentials:
        """Return the potential energies of the present positions.

        The accelerations are not changed. Those of drift-kick-drift are of the middle of the step, and the next step is
        chosen by them whether or not an energy is requested.
        """
        unused = np.empty_like(self.state.acceleration)
        return accelerate(self._forces, self.state.position, unused, True, Profile())

    def _potential_of_fixed_bodies(self) -> float:
        """Return the constant gravitational energy of fixed bodies among each other, in J."""
        fixed = self._fixed
        gravity = gravity_of(self.scene, self.state.mass[fixed], self._team) if len(fixed) > 1 else None
        if gravity is None:
            return 0.0
        return gravity.accelerate(self.state.position[fixed], np.empty((len(fixed), 3)), potential=True) or 0.0

    def _respond(self, contact: ContactPipeline) -> None:
        """Resolve the contacts and book their energies."""
        contact.resolve(self.dt, self._last_kick, self.profile)
        if len(contact.held):
            self._audit.book(contact.held)
        if contact.statistics.contacts:
            if self.extremes.contacts is None:
                graph = contact.seen.graph
                i, j = graph.pairs[graph.first]
                text = f"First contact: {self._called.pair((i, j))}."
                self._log(Event(self.step, self.time, "INFO", text, "first-contact"))
            self._see_contacts(contact, self.extremes)
            for level, text in contact.limits_reached():
                self._log(Event(self.step, self.time, level, text, "limit"))
        self._activity.see(contact.statistics.contacts, contact.statistics.struck)
        self.profile.mark("ledger")
        if self.requirements.torque.modelled:
            contact.turn(self.dt)
            self.profile.mark("torque")

    def _see_contacts(self, contact: ContactPipeline, extremes: Extremes) -> None:
        """Book the contacts of the step."""
        self._audit.book(contact.statistics.work)
        extremes.see_contacts(self.step, self.time, contact.statistics)

    def _audit_impulses(self, audit: ImpulseAudit) -> None:
        """Compare what contacts and forces gave in this step with what the bodies have."""
        contact = self._contact
        impulses, work = (contact.impulses(), contact.work()) if contact else ((), np.zeros((0, 3)))
        self.extremes.see_impulse_audit(self.step, self.time, audit.finish(impulses, work, self.ledger))

    def _book_exchanges(self) -> None:
        """Book the energy and momentum exchanged with a medium in this step."""
        if self._damping:
            for exchange in self._exchanged:
                self._audit.exchange(self._damping.kind.loss, *exchange)
            self._exchanged.clear()

    def _take_stock(self, potentials: Potentials, checked: bool) -> None:
        """Compute energy and momentum, and check them."""
        try:
            self._audit.take_stock(self.step, self.time, potentials, self.extremes)
        except PhysicsError:
            refuse_infinities(self.state, self.names, self.step, self.time)  # says which bodies it was
            raise
        if checked:
            for warning in self._audit.check(self.time, self.extremes):
                self._log(warning)
        self.profile.mark("energy")

    def _warm_up(self) -> Potentials:
        """Take a few tiny steps, then restore the state: frame 0 is the scene as written.

        They compute the accelerations for the first adaptive step, and compile the kernels. Returns the potential
        energies in J.
        """
        state = self.state
        changing = (state.position, state.velocity, state.orientation, state.angular_velocity)
        saved = [array.copy() for array in changing]
        self._accelerate(potential=False)
        tiny = WARM_UP_DT * self.first_dt
        if self._radau:
            self._radau.begin(tiny)
            self._radau.advance(0.0, tiny, np.inf, 1)
        else:
            self._warm_up_steps(tiny)
        for array, value in zip(changing, saved, strict=True):
            array[:] = value
        self._exchanged.clear()
        potentials = self._accelerate(potential=True)
        if self.requirements.adaptive_step.modelled:
            self._timestep.previous = self._timestep.target(state)[0]
        if self._radau:
            self._radau.begin(self.first_dt)
        if self._contact:
            self._contact.forget()
            self._see_contacts(self._contact, Extremes())  # none: loads the kernels
            self._contact.begin(self.first_dt)
        return potentials

    def _warm_up_steps(self, dt: float) -> None:
        for _ in range(WARM_UP_STEPS if self.requirements.warm_up.modelled else 1):  # one loads the kernels
            self._integrate(dt, with_potential=False)
            if self._contact:
                self._contact.resolve(dt, self._last_kick, self.profile)

    def _log(self, event: Event) -> None:
        self._events.append(event)
        if event.level == "WARN":
            self.extremes.see_warning(event.kind)

    def _stuck(self, time: float) -> str:
        remedy = {
            "error": "bodies fall into each other's centres: set gravity.softening",
            "pull": "bodies fall into each other's centres: set gravity.softening, or let them touch, contact.enabled",
            "acceleration": "raise time.target_dx, or set time.fixed_dt",
            "held": "raise time.target_dx, or set time.fixed_dt",
            "velocity": "raise time.cfl, or set time.fixed_dt",
        }.get(self.dt_limit, "raise time.target_dx or time.cfl, or set time.fixed_dt")
        return (
            f"step {self.step + 1} of {self.dt:.3g} s no longer moves the clock at t = {time:.6g} s "
            f"(limit: {self.dt_limit}); {remedy}"
        )
