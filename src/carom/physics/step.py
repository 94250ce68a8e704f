"""One step of kicks and drifts, in the order of docs/physics.md, section 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from carom.arrays import FloatArray
from carom.physics.checkpoint import Checkpoint
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.contact.reactions import NO_SUPPORT
from carom.physics.diagnostics.bookkeeper import Bookkeeper
from carom.physics.diagnostics.run_monitor import refuse_infinities, refuse_many_crossings
from carom.physics.forces.force import Damping, Exchange, Potentials
from carom.physics.free_flight import Flight, FreeFlight, can_fly
from carom.physics.integrators.kick_drift import DampedStep, drift, kick, wrap
from carom.physics.rotation import rotate
from carom.physics.schedule import Goal, looks_before
from carom.physics.time_step import Timestep
from carom.physics.world import World
from carom.plan.auto import integrator
from carom.registry import load, names

if TYPE_CHECKING:
    from carom.physics.contact.events.steady_steps import SteadySteps

WARM_UP_STEPS = 3
STICKING = "friction"  # the limit of a step that ends where a contact stops sliding or rolling
# Of the step: the first one in contact, whose friction is not known. A contact that sticks within it makes an error
# that is smaller than usual by the square.
FIRST_IN_CONTACT = 1.0 / 64.0


class KickDriftStepper:
    """Advances a world by kicks, drifts and contacts, one step at a time, and keeps its books.

    ``timestep`` chooses the steps. If it allows longer ones than the scene, ``asked`` chooses the scene's own steps.
    """

    def __init__(self, world: World, books: Bookkeeper, timestep: Timestep, asked: Timestep | None = None) -> None:
        self._world = world
        self._books = books
        self.timestep = timestep
        self._asked = asked
        self._substeps = integrator(world.scene).substeps
        self._ends_with_forces = integrator(world.scene).ends_with_forces
        self._damping = world.forces.damping
        self._exchanges: list[Exchange] = []  # of the bodies with a medium, in this step
        self._flight = FreeFlight(world, timestep) if asked is None and can_fly(world) else None
        # the accuracy that contacts which stick within a step must keep; None without one
        self._sticks_within = world.scene.time.accuracy if world.scene.promise and world.contact else None
        self._is_first = False  # whether contacts carry no impulses yet
        self._steady: SteadySteps | None = None  # of few bodies in contact
        if self._flight and world.contact and world.contact.event_drift and "steady-steps" in names("model"):
            self._steady = load("model", "steady-steps")(world, books, timestep, self._flight)

    @property
    def checkpoint(self) -> None:
        """None: a step depends only on the bodies, the contacts and `previous_dt`."""

    @property
    def previous_dt(self) -> float:
        """The step (s) from which the next one is averaged: smoothed, and not cut at the end of a run."""
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
        """Take a few steps of dt seconds without booking them; they also compute the initial accelerations."""
        for _ in range(WARM_UP_STEPS if self._world.needs.warm_up.modelled else 1):  # a single step loads the kernels
            self._step(dt, with_potential=False)
        if self._flight:
            self._flight.take(0.0, np.inf, np.inf, most=0)  # loads the kernel
        self._exchanges.clear()
        for work in self._world.forces.path_works:
            work.pop()
        if self._world.shear:
            self._world.shear.pop()

    def begin(self) -> None:
        """Start at the present state, where touching contacts carry no impulses yet."""
        if self._world.contact:
            self._world.contact.forget()
        self.take_over()

    def take_over(self) -> None:
        """Continue from the present state of a run, in place of another stepper."""
        world = self._world
        if world.needs.adaptive_step.modelled:
            self.timestep.previous = self.timestep.target(world.bodies)[0]
        if world.shear:
            world.shear.begin(world.clock.time)
        if world.contact:
            world.contact.boundary.place(world.clock.time)
            world.contact.begin(self.first_dt)
        self._is_first = True

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint, whose bodies are already restored."""
        self.timestep.previous, self._is_first = checkpoint.previous_dt, checkpoint.step == 0
        if self._world.shear:
            self._world.shear.begin(self._world.clock.time)
        if self._world.contact:
            self._world.contact.boundary.place(self._world.clock.time)
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
        """Return the time (s) at which a step is to end so that no contact stops sliding or rolling within it."""
        is_first, self._is_first = self._is_first and len(contact.contacts) > 0, False
        dt = self.timestep.first(self._world.bodies, self.supported_acceleration())
        if is_first:
            return FIRST_IN_CONTACT * dt
        time = contact.time_to_stick(dt, tolerance)
        return time if time <= 2.0 * dt else 0.5 * time  # far ahead, the forces may change

    def _advance(self, goal: Goal) -> bool:
        """Take a step, or many if nothing touches, up to the goal; return whether a frame is due."""
        contact, clock, flight = self._world.contact, self._world.clock, self._flight
        if flight is None or looks_before(goal.schedule):
            return self._advance_once(goal)
        if contact and not contact.is_quiet:
            is_done = self._steady is not None and self._steady.advance(goal)
            return False if is_done else self._advance_once(goal)
        most, until = goal.most, np.inf
        if most > 1:
            steps, until = goal.quiet(clock)
            most, until = int(min(most, steps)), min(until, self._books.kept_until)
        if self._damping:
            self._damping.exchanged[:] = self._books.audit.exchanged(self._damping.kind.loss)
        taken = flight.take(clock.time, goal.end, until, most, self._books.activity.impact_energy)
        return self._land(taken, goal) if taken.steps else self._advance_once(goal)

    def _land(self, taken: Flight, goal: Goal) -> bool:
        """Book steps without contacts; return whether a frame is due."""
        world, books, clock = self._world, self._books, self._world.clock
        clock.advance(taken.steps, taken.before, taken.time, taken.dt, taken.limit)
        if self._damping:
            books.audit.exchange_up_to(self._damping.kind.loss, self._damping.exchanged)
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
        due, judged = goal.is_reached(clock), goal.is_check(clock)  # a schedule is called for every step
        books.begin_step(judged)
        world.profile.mark("timestep")
        potentials = self._step(clock.dt, with_potential=due or judged)
        if self._damping:
            books.book_exchanges(self._damping.kind.loss, self._exchanges)
            self._exchanges.clear()
        books.book_path_works()
        if world.shear:
            books.book_shear(world.shear)
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
        """False: there is no solution within a step."""
        return False

    def between(self, earlier: float) -> None:
        """Return None: there is no solution within a step."""

    def _choose(self, end: float) -> tuple[float, float, str]:
        """Choose the next step of a run that ends at a time; return the time at its end, its length, and its limit."""
        world, time = self._world, self._world.clock.time
        change = np.inf
        if world.contact and world.planes.translates:
            change = world.contact.boundary.next_change(time)
        if world.contact and world.planes.curves and self.timestep.fixed_dt is None:
            change = min(change, time + world.contact.longest_step)
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
        corrects them at the end of the step. Its forces then belong to other positions, the next kick is not central,
        and angular momentum drifts by overlap × force, unless forces are computed twice.
        """
        world, contact, damping = self._world, self._world.contact, self._damping
        potentials: Potentials = {}
        last_kick = 0.0
        if contact and world.planes.translates:
            contact.boundary.set_span(world.clock.before, world.clock.time)
        if world.shear:
            world.shear.begin(world.clock.before)
        if world.needs.orientation.modelled:
            rotate(world.bodies.orientation, world.bodies.angular_velocity, dt, world.team)
            world.profile.mark("orientation")
        for index, substep in enumerate(self._substeps):
            is_last = index == len(self._substeps) - 1
            damped = damping.step(dt) if damping else None
            first_kick, last_kick = substep.before * dt, substep.after * dt
            booked = first_kick  # s, part of the drift for which the first kick has done the work of the forces
            if damped:
                booked, last_kick = damped.booked, damped.last_kick
            if damping and damped:  # drag has its own kicks
                self._exchange(damping, damping.begin, damped)
            elif first_kick and world.needs.accelerates:
                self._kick(first_kick)
            if index == 0 and contact:
                self._hold(contact, first_kick, dt, booked, damped)
            for work in world.forces.path_works:
                work.begin()
            self._drift(substep.drift * dt, booked, damped)
            if world.shear:  # contacts are resolved where the images are at the end of the step
                world.shear.begin(world.clock.time)
            if is_last and contact:  # at the final positions
                clock = world.clock
                refuse_infinities(world.bodies, world.names.bodies, clock.step, clock.time, clock.units, world.team)
                contact.find(dt, world.profile)
            for work in world.forces.path_works:
                work.end()
            if world.shear:  # changes velocities
                audit = self._books.impulse_audit
                before = world.bodies.velocity.copy() if audit else None
                world.shear.wrap(world.bodies, world.clock.time)
                if audit and before is not None:
                    audit.add_change(before)
            elif world.is_periodic:
                wrap(world.bodies.position, world.box, world.team)
            if world.needs.accelerates:
                potentials = self._sum_forces(is_last, with_potential)
                if damping and damped:
                    self._exchange(damping, damping.end, damped)
                elif last_kick:
                    self._kick(last_kick)
            world.profile.mark("integrate")
        if contact:
            self._resolve(contact, dt, last_kick)
        return potentials

    def _hold(self, contact: ContactPipeline, kick: float, dt: float, booked: float, damped: DampedStep | None) -> None:
        """Hold lasting contacts after the first kick, against the accelerations of the bodies; times in s."""
        profile = self._world.profile
        profile.mark("integrate")
        if self._damping and damped:
            contact.hold(damped.held_kick, dt, booked, self._damping.against)
            if len(contact.ledger_apart):
                loss = self._damping.lost_in_hold(damped)
                self._exchanges.append(Exchange(loss, np.zeros(3), np.zeros(3)))
        else:
            contact.hold(kick, dt, booked)
        profile.mark("resting")

    def _drift(self, dt: float, kick: float, damped: DampedStep | None) -> None:
        """Drift for a time (s), with impacts at their exact times if the scene requires it.

        ``kick`` is the length (s) of the previous kick.
        """
        world, bodies, clock = self._world, self._world.bodies, self._world.clock
        if world.is_periodic:
            refuse_many_crossings(bodies.velocity, dt, world.box, clock.step, clock.time, clock.units)
        if world.contact and world.needs.impact_time.modelled:
            refuse_infinities(bodies, world.names.bodies, clock.step, clock.time, clock.units, world.team)
            if self._damping and damped:
                before = bodies.ends.velocity.copy()
                world.contact.drift(*damped.path[:1], dt, *damped.path[1:])
                if len(world.contact.impacts):
                    self._exchanges.append(self._damping.exchange_in_impacts(damped, before, world.contact.impacts))
                    if self._books.impulse_audit:
                        self._books.impulse_audit.add_force(before[: len(bodies)])
            else:
                world.contact.drift(kick, dt)
            world.profile.mark("impacts")
        else:
            drift(bodies.position, bodies.velocity, dt, world.team)
            world.profile.mark("integrate")

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

    def _resolve(self, contact: ContactPipeline, dt: float, last_kick: float) -> None:
        """Apply the impulses of the contacts after the last kick, and compute their torques."""
        world = self._world
        contact.resolve(dt, last_kick, world.profile)
        if world.needs.torque.modelled:
            contact.torques.write(dt)
            world.profile.mark("torque")
        if contact.sleepers:
            audit, bodies = self._books.impulse_audit, world.bodies
            before = (bodies.velocity.copy(), bodies.angular_velocity.copy()) if audit else None
            contact.fall_asleep(dt)
            if audit and before is not None:
                audit.add_sleep(*before)
            world.profile.mark("sleep")

    def _kick(self, dt: float) -> None:
        bodies = self._world.bodies
        kick(bodies.velocity, bodies.acceleration, dt, self._world.team)
        audit, contact = self._books.impulse_audit, self._world.contact
        if audit:
            audit.add_kick(bodies.acceleration, dt)
        if contact and contact.sleepers:
            before = bodies.velocity.copy() if audit else None
            contact.sleepers.stop()
            if audit and before is not None:
                audit.add_change(before)

    def _exchange(self, damping: Damping, act: Callable[[DampedStep], Exchange], damped: DampedStep) -> None:
        """Let drag act on the velocities before or after the drift."""
        audit, velocity = self._books.impulse_audit, self._world.bodies.velocity
        before = velocity.copy() if audit else None
        self._exchanges.append(act(damped))
        if audit and before is not None:
            audit.add_change(before)
        self._world.profile.mark(damping.kind.short_name)
