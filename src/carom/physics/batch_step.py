"""Steps of integrators that choose their own step lengths: many steps per call, up to the next check or frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from carom.arrays import FloatArray
from carom.event import Event
from carom.physics.diagnostics.bookkeeper import Bookkeeper
from carom.physics.diagnostics.run_monitor import refuse_infinities
from carom.physics.integrators.batch_integrator import BY_LEAPFROG, Batch, BatchIntegrator
from carom.physics.rotation import rotate
from carom.physics.schedule import Goal, Pause, quiet
from carom.physics.step import KickDriftStepper
from carom.physics.time_step import Timestep
from carom.physics.world import World
from carom.state.checkpoint import Checkpoint, IntegratorCheckpoint

FREE_DT = 1.0  # s, the first step if nothing limits it; later steps are longer
FORESEEN = 2.0  # largest ratio of the holder's next step to its last step
MOST_STRIKES = 100  # largest number of impacts at one time; bodies that meet again after these rest on each other


class BatchStepper:
    """Advances a world by a `BatchIntegrator`, which ends a step where bodies meet, and keeps the world's books.

    ``timestep`` suggests the first step. The ``holder`` takes the steps once contacts come to rest; it is None if
    nothing can touch. If the scene has an accuracy, the integrator resumes once nothing touches; otherwise the holder
    finishes the run.
    """

    def __init__(
        self,
        world: World,
        books: Bookkeeper,
        integrator: BatchIntegrator,
        timestep: Timestep,
        holder: KickDriftStepper | None = None,
    ) -> None:
        self._world = world
        self._books = books
        self._integrator = integrator
        self.timestep = timestep
        self._holder = holder
        self._held = False  # whether the holder has taken over
        # whether the integrator resumes once nothing touches
        self._takes_back = world.scene.promise is not None
        self._took_last = True  # whether the integrator took the last step, not the holder

    @property
    def previous_dt(self) -> float:
        """The length (s) of the next step to try."""
        return self._holder.previous_dt if self._holder and self._held else self._integrator.next_dt

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the integrator's state, without the bodies."""
        last = self._integrator.checkpoint
        return replace(last, last_dt=BY_LEAPFROG) if self._held else last

    @property
    def first_dt(self) -> float:
        """The step (s) that the scene's limits allow in the present state; `FREE_DT` if nothing limits it."""
        dt = self.timestep.first(self._world.bodies)
        return dt if math.isfinite(dt) else FREE_DT

    def warm_up(self, dt: float) -> None:
        """Take a step of about dt seconds, to load the kernels."""
        self._integrator.begin(dt)
        self._integrator.advance(0.0, dt, np.inf, 1)
        if self._world.contact and self._holder:
            self._world.contact.resolve_meeting(None, dt)
            self._world.contact.step_by_impacts(dt)
            self._holder.warm_up(dt)

    def begin(self) -> None:
        """Begin a run at the present positions and velocities."""
        self._integrator.begin(self.first_dt)
        if self._world.contact:
            self._world.contact.forget()

    def take_over(self) -> None:
        """Continue from the present state of a run, in place of another stepper."""
        self._held, self._took_last = False, True
        self.begin()

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint, whose bodies are already restored."""
        self._held = checkpoint.integrator is not None and checkpoint.integrator.last_dt == BY_LEAPFROG
        self._took_last = not self._held
        if self._holder and self._held:
            self._holder.restore(checkpoint)
            return
        self._integrator.restore(checkpoint.integrator, checkpoint.previous_dt)
        if self._world.contact:
            self._world.contact.recall(checkpoint.contacts)

    def advance(self, goal: Goal) -> bool:
        """Advance up to the goal or the next check; return whether a frame is due.

        Raises PhysicsError if the state is no longer finite, or a step no longer changes the clock.
        """
        if self._holder and self._held:
            return self._hold(self._holder, goal)
        world, clock, bodies = self._world, self._world.clock, self._world.bodies
        rotates, works = world.needs.orientation.modelled, world.forces.path_works
        steps, until = goal.quiet(clock)
        until = min(until, self._books.kept_until)
        most = 1 if rotates or works else int(min(goal.most, steps))
        contact, audit = world.contact, self._books.impulse_audit
        if quiet(goal.checks, clock.step, clock.time)[0] == 1:
            self._books.suspect_contacts(clock.step)
        if contact:
            contact.begin_batch()
        if audit:
            audit.begin(self._books.audit.ledger)
        batch = self._fly(goal.end, until, most)
        if batch.steps == 0 and self._holder and self._held:
            return self._hold(self._holder, goal)
        self._took_last = True
        clock.advance(batch.steps, batch.before, batch.time, batch.dt, batch.limit)
        refuse_infinities(bodies, world.names.bodies, clock.step, clock.time, clock.units)
        for work in works:
            work.follow(batch.dt, self._integrator.at)
            work.book(self._books.audit)
        if rotates:
            rotate(bodies.orientation, bodies.angular_velocity, clock.dt, world.team)
        if contact:
            self._books.begin_contacts()
            if batch.meeting:
                contact.resolve_meeting(batch.meeting.ends, clock.dt)
            world.step.dt, world.step.last_kick = clock.dt, 0.0
            contact.end_batch(world.step)
        # an impact or the end of the run shortens one step, but does not limit the next
        clock.foresee("error" if clock.limit in ("end", "impact") else clock.limit, batch.steps)
        world.profile.mark("integrate")
        due, judged = goal.is_reached(clock), goal.is_check(clock)
        self._books.finish_step(world.forces.accelerate(potential=due or judged), due or judged, judged)
        return due

    def _fly(self, end: float, until: float, most: int) -> Batch:
        """Integrate up to a time, the end of the run, a number of steps, or the next impact.

        Impacts at the present time are resolved first. If contacts are then at rest, the holder takes over.
        """
        world, contact, time = self._world, self._world.contact, self._world.clock.time
        for _ in range(MOST_STRIKES):
            with self._books.change:
                batch = self._integrator.advance(time, end, until, most)
            if contact is None or batch.meeting is None or batch.steps > 0:
                return batch
            ends = batch.meeting.ends
            if batch.meeting.rests:
                break
            contact.resolve_meeting(ends, 0.0)
        if self._holder:
            self._held = True
            since = "while they rest," if self._takes_back else "from now on"
            text = f"Contacts come to rest ({world.names.pair(ends)}): {since} leapfrog integrates all bodies."
            # the event belongs to the step that begins now, since the frame of the last step may already be recorded
            self._books.log(Event(world.clock.step + 1, time, "INFO", text, "at-rest"))
            self._holder.take_over()
        return batch

    def _hold(self, holder: KickDriftStepper, goal: Goal) -> bool:
        """Take a step with the holder. The holder's steps end at pauses, because it has no dense output."""
        contact, clock = self._world.contact, self._world.clock
        self._took_last = False
        if isinstance(goal.schedule, Pause):
            goal = goal._replace(end=min(goal.end, goal.schedule.time))
        if not (self._takes_back and contact):
            return holder.advance(goal)
        end = clock.time + contact.step_by_impacts(FORESEEN * holder.previous_dt) if contact.holds else np.inf
        due = holder.advance(goal if goal.end <= end else goal._replace(end=end, shows_end=False))
        if clock.time == end < goal.end:
            clock.limit = "impact"
        if contact.is_quiet:
            self._held = False
            self._integrator.begin(self.first_dt)
        return due

    @property
    def has_solution(self) -> bool:
        """Whether the last step has dense output, for `between`."""
        return self._took_last

    def between(self, earlier: float) -> tuple[FloatArray, FloatArray] | None:
        """Return positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the last step."""
        return self._integrator.at(earlier) if self._took_last else None
