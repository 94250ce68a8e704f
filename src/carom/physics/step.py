"""One step of kicks and drifts, in the order of docs/physics.md, section 2."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carom.arrays import FloatArray
from carom.physics.contact.hooks import PresentStep, StepHooks
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.contact.reactions import NO_SUPPORT
from carom.physics.diagnostics.bookkeeper import Bookkeeper
from carom.physics.diagnostics.run_monitor import refuse_infinities, refuse_many_crossings
from carom.physics.few_bodies import FewBodies, Flight, can_fly
from carom.physics.forces.force import Potentials
from carom.physics.integrators.kick_drift import MIN_BODIES_PER_TASK, advance, wrap_rows
from carom.physics.jit.team import Team
from carom.physics.rotation import rotate
from carom.physics.schedule import Goal, looks_before
from carom.physics.time_step import Timestep
from carom.physics.world import World
from carom.plan.auto import integrator
from carom.registry import load, names
from carom.state.checkpoint import Checkpoint

WARM_UP_STEPS = 3
STICKING = "friction"  # name of the limit of a step that ends when a contact stops sliding or rolling
# Length of the first step in contact, whose friction is not known yet, as a fraction of a usual step. If a contact
# sticks within this step, the error is smaller than usual by the square of the fraction.
FIRST_IN_CONTACT = 1.0 / 64.0


class KickDriftStepper:
    """Advances a world by kicks, drifts and contacts, one step at a time, and keeps its books.

    ``timestep`` chooses the steps. If ``timestep`` allows longer steps than the scene does, ``asked`` computes the
    scene's own steps, which are only counted.
    """

    def __init__(self, world: World, books: Bookkeeper, timestep: Timestep, asked: Timestep | None = None) -> None:
        self._world = world
        self._books = books
        self.timestep = timestep
        self._asked = asked
        self._substeps = integrator(world.scene).substeps
        self._ends_with_forces = integrator(world.scene).ends_with_forces
        self._hooks, self._now = world.hooks, world.step
        self._kicks = world.needs.accelerates and not world.hooks.kick_before
        self._wraps = world.is_periodic and not world.hooks.wrap
        self._flight = FewBodies(world, timestep) if asked is None and can_fly(world) else None
        # accuracy that must be kept if contacts stick within a step; None if none is requested
        self._sticks_within = world.scene.time.accuracy if world.scene.promise and world.contact else None
        self._is_first = False  # whether contacts carry no impulses yet
        self._advance_steadily: Callable[[Goal], bool] | None = None  # takes many steps of few bodies in contact
        if self._flight and world.contact and self._hooks.move and "steady-steps" in names("model"):
            steady = load("model", "steady-steps")(world, books, timestep, self._flight)
            self._advance_steadily = steady.advance if steady else None

    @property
    def checkpoint(self) -> None:
        """None, since a step depends only on the bodies, the contacts and `previous_dt`."""

    @property
    def previous_dt(self) -> float:
        """The step (s) that enters the moving average: after smoothing, but before the cut at the end of a run."""
        return self.timestep.previous

    @property
    def first_dt(self) -> float:
        """The step (s) that the limits allow in the present state, before smoothing."""
        return self.timestep.first(self._world.bodies, self.supported_acceleration())

    def supported_acceleration(self) -> FloatArray:
        """Return the accelerations that contacts support, (n + p,) m/s²; empty if no step depends on them."""
        contact = self._world.contact
        return contact.supported_acceleration if contact and self.timestep.spares_held else NO_SUPPORT

    def warm_up(self, dt: float) -> None:
        """Take a few steps of dt seconds without booking them; the steps also compute the initial accelerations."""
        # a scene that requires no warm-up makes a single step, which loads the kernels
        for _ in range(WARM_UP_STEPS if self._world.needs.warm_up.modelled else 1):
            self._step(dt, with_potential=False)
        if self._flight:
            self._flight.take(0.0, np.inf, np.inf, most=0)  # loads the kernel
        for part in self._world.parts:
            part.discard()

    def begin(self) -> None:
        """Start at the present state, in which touching contacts carry no impulses yet."""
        if self._world.contact:
            self._world.contact.forget()
        self.take_over()

    def take_over(self) -> None:
        """Continue from the present state of a run, in place of another stepper."""
        world = self._world
        if world.needs.adaptive_step.modelled:
            self.timestep.previous = self.timestep.target(world.bodies)[0]
        for part in world.parts:
            part.place(world.clock.time)
        if world.contact:
            world.contact.begin(self.first_dt)
        self._is_first = True

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint, whose bodies are already restored."""
        self.timestep.previous, self._is_first = checkpoint.previous_dt, checkpoint.step == 0
        for part in self._world.parts:
            part.place(self._world.clock.time)
        if self._world.contact:
            self._world.contact.recall(checkpoint.contacts)

    def advance(self, goal: Goal) -> bool:
        """Take a step, or many if nothing touches; return whether a frame is due.

        Raises PhysicsError if the state is no longer finite, or a step no longer changes the clock.
        """
        if self._sticks_within is None or self._world.contact is None:
            return self._advance(goal)
        clock = self._world.clock
        end = clock.time + self._time_to_stick(self._world.contact, self._sticks_within)
        due = self._advance(goal if goal.end <= end else goal._replace(end=end, shows_end=False))
        if clock.time == end < goal.end:
            clock.limit = STICKING
        return due

    def _time_to_stick(self, contact: ContactPipeline, tolerance: float) -> float:
        """Return the latest time (s) at which a step may end, so that no contact stops sliding or rolling within it."""
        is_first, self._is_first = self._is_first and len(contact.contacts) > 0, False
        dt = self.timestep.first(self._world.bodies, self.supported_acceleration())
        if is_first:
            return FIRST_IN_CONTACT * dt
        time = contact.time_to_stick(dt, tolerance)
        return time if time <= 2.0 * dt else 0.5 * time  # a time far ahead is uncertain, as forces may change

    def _advance(self, goal: Goal) -> bool:
        """Take a step, or many if nothing touches, up to the goal; return whether a frame is due."""
        contact, clock, flight = self._world.contact, self._world.clock, self._flight
        if flight is None:
            return self._advance_once(goal)
        if contact and not contact.is_quiet:
            is_done = self._advance_steadily is not None and self._advance_steadily(goal)
            return False if is_done else self._advance_once(goal)
        most, until, stops_before = goal.most, np.inf, looks_before(goal.schedule)
        if most > 1 or stops_before:
            steps, until = goal.quiet(clock)
            most, until = int(min(most, steps)), min(until, self._books.kept_until)
        for lend in self._hooks.lend:
            lend(self._books.audit)
        energy = self._books.activity.impact_energy
        taken = flight.take(clock.time, goal.end, until, most, energy, stops_before=stops_before)
        return self._land(taken, goal) if taken.steps else self._advance_once(goal)

    def _land(self, taken: Flight, goal: Goal) -> bool:
        """Book steps without contacts; return whether a frame is due."""
        world, books, clock = self._world, self._books, self._world.clock
        clock.advance(taken.steps, taken.before, taken.time, taken.dt, taken.limit)
        for settle in self._hooks.settle:
            settle(books.audit)
        due, judged = goal.is_reached(clock), goal.is_check(clock)
        if world.contact:
            world.contact.add_quiet_steps()
            books.activity.impact_energy = taken.impact_energy
            if judged:
                books.suspect_contacts(clock.step - 1)
            books.begin_contacts()
        world.profile.mark("integrate")
        computed = due or judged
        self._finish(self._sum_forces(True, computed) if computed and world.needs.accelerates else {}, computed, judged)
        return due

    def _advance_once(self, goal: Goal) -> bool:
        """Take a step; return whether a frame is due."""
        world, books, clock = self._world, self._books, self._world.clock
        clock.advance(1, clock.time, *self._choose(goal.end))
        due, judged = goal.is_reached(clock), goal.is_check(clock)  # schedules must be called for every step
        books.begin_step(judged)
        world.profile.mark("timestep")
        potentials = self._step(clock.dt, with_potential=due or judged)
        for book in self._hooks.book:
            book(books.audit)
        self._finish(potentials, due or judged, judged)
        return due

    def _finish(self, potentials: Potentials, computed: bool, judged: bool) -> None:
        """Book the last step; check energy and pace if due."""
        world, books = self._world, self._books
        books.finish_step(potentials, computed, judged)
        if books.pace and world.clock.step % world.scene.record.check_every == 0:
            books.check_pace(*self.timestep.target(world.bodies, self.supported_acceleration()))

    @property
    def has_solution(self) -> bool:
        """False: kicks and drifts have no dense output."""
        return False

    def between(self, earlier: float) -> None:
        """Return None: kicks and drifts have no dense output."""

    def _choose(self, end: float) -> tuple[float, float, str]:
        """Choose the next step of a run that ends at a time; return the time at its end, its length, and its limit."""
        world, time = self._world, self._world.clock.time
        change = np.inf
        for latest_end in self._hooks.latest_end:
            change = min(change, latest_end(time, self.timestep.fixed_dt is None))
        dt, limit = self.timestep.choose(world.bodies, min(end, change) - time, self.supported_acceleration())
        if self._asked:
            asked, asked_limit = self._asked.target(world.bodies, self.supported_acceleration())
            world.clock.foresee(asked_limit, dt / asked if asked > 0.0 else np.inf)
        if limit == "end" and change < end:
            return change, dt, "motion"
        return end if limit == "end" else time + dt, dt, limit

    def _step(self, dt: float, with_potential: bool) -> Potentials:
        """Take a step of dt seconds; return the potential energies at its end if requested.

        Overlaps are corrected after the last drift, so that forces belong to the final positions. The reference engine
        (docs/validation.md) corrects overlaps at the end of the step. Unless it computes forces twice, they belong to
        the uncorrected positions. The next kick is then not central, and angular momentum drifts by overlap × force.
        """
        world, contact, hooks, step = self._world, self._world.contact, self._hooks, self._now
        potentials: Potentials = {}
        step.before, step.time, step.dt = world.clock.before, world.clock.time, dt
        for index, substep in enumerate(self._substeps):
            is_last = index == len(self._substeps) - 1
            step.set_kicks(substep.before * dt, substep.drift * dt, substep.after * dt)
            self._change_velocities(hooks.kick_before)
            if step.kick and self._kicks:
                self._kick(step.kick)
            if index == 0 and contact:
                world.profile.mark("integrate")
                contact.hold(step)
                world.profile.mark("resting")
            if index == 0 and world.needs.orientation.modelled:  # the spins of the drift
                rotate(world.bodies.orientation, world.bodies.angular_velocity, dt, world.team)
                world.profile.mark("orientation")
            self._drift(step)
            if is_last and contact:  # the contacts at the final positions
                self._refuse_infinities()
                contact.find(step)
            for travelled in hooks.travelled:
                travelled(step)
            self._change_velocities(hooks.wrap)
            if self._wraps:
                wrap(world.bodies.position, world.box, world.team)
            if world.needs.accelerates:
                potentials = self._sum_forces(is_last, with_potential)
                self._change_velocities(hooks.kick_after)
                if step.last_kick and self._kicks:
                    self._kick(step.last_kick)
            world.profile.mark("integrate")
        if contact:
            self._resolve(contact)
        return potentials

    def _drift(self, step: PresentStep) -> None:
        """Drift along straight lines, unless a part moves the bodies."""
        world, bodies, clock = self._world, self._world.bodies, self._world.clock
        for depart in self._hooks.depart:
            depart(step)
        if world.is_periodic:
            refuse_many_crossings(bodies.velocity, step.drift, world.box, clock.step, clock.time, clock.units)
        for move in self._hooks.move:
            self._refuse_infinities()
            move(step)
        if not self._hooks.move:
            drift(bodies.position, bodies.velocity, step.drift, world.team)
            world.profile.mark("integrate")

    def _refuse_infinities(self) -> None:
        world, clock = self._world, self._world.clock
        refuse_infinities(world.bodies, world.names.bodies, clock.step, clock.time, clock.units, world.team)

    def _sum_forces(self, is_last: bool, with_potential: bool) -> Potentials:
        """Update the accelerations if a kick will use them; return the potential energies if requested."""
        forces = self._world.forces
        if not is_last or self._ends_with_forces:
            return forces.accelerate(with_potential and is_last)
        if not with_potential:
            return {}
        potentials = forces.potentials()
        self._world.profile.mark("gravity")
        return potentials

    def _resolve(self, contact: ContactPipeline) -> None:
        """Apply the impulses of the contacts after the last kick, and compute their torques."""
        world = self._world
        contact.resolve(self._now)
        if world.needs.torque.modelled:
            contact.torques.write(self._now.dt)
            world.profile.mark("torque")
        self._change_velocities(self._hooks.end)

    def _kick(self, dt: float) -> None:
        bodies = self._world.bodies
        kick(bodies.velocity, bodies.acceleration, dt, self._world.team)
        if self._books.impulse_audit:
            self._books.impulse_audit.add_kick(bodies.acceleration, dt)
        self._change_velocities(self._hooks.kicked)

    def _change_velocities(self, hooks: StepHooks) -> None:
        """Let parts change velocities, and report the changes to the impulse audit."""
        for hook in hooks:
            with self._books.change:
                hook(self._now)


def kick(velocity: FloatArray, acceleration: FloatArray, dt: float, team: Team) -> None:
    """Kick: v += a dt, both (n, 3)."""
    team.divide(len(velocity), MIN_BODIES_PER_TASK, advance, velocity, acceleration, dt)


def drift(position: FloatArray, velocity: FloatArray, dt: float, team: Team) -> None:
    """Drift: x += v dt, both (n, 3)."""
    team.divide(len(position), MIN_BODIES_PER_TASK, advance, position, velocity, dt)


def wrap(position: FloatArray, box: FloatArray, team: Team) -> None:
    """Wrap every centre into the periodic box about the origin."""
    team.divide(len(position), MIN_BODIES_PER_TASK, wrap_rows, position, box)
