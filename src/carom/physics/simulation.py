"""A scene in motion: its world, stepper and books; `carom.physics.step` shows the stages of a step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, Records
from carom.contact_table import NO_ROWS
from carom.physics.batch_step import BatchStepper
from carom.physics.bodies import Bodies
from carom.physics.contact.contact_tap import ContactTap
from carom.physics.diagnostics.bookkeeper import Bookkeeper
from carom.physics.diagnostics.run_monitor import PaceMonitor, remedies_of
from carom.physics.forces.force import Potentials
from carom.physics.frame_store import FrameStore, copies
from carom.physics.integrators.batch_integrator import batch_integrator_of
from carom.physics.jit import cores
from carom.physics.jit.team import Team
from carom.physics.promised_step import PromisedStepper, Stepper, without_accuracy
from carom.physics.schedule import Checks, Goal, Pause, Schedule, at, every
from carom.physics.step import KickDriftStepper
from carom.physics.time_step import Timestep
from carom.physics.world import World
from carom.plan.auto import (
    StepLimits,
    auto_interval,
    frame_interval,
    holding,
    integrator,
    shorter_steps,
    step_limits,
    wider_limits,
)
from carom.plan.features import require
from carom.scene.load import Scene
from carom.scene.start import EntryStates, InitialBodies
from carom.state.checkpoint import Checkpoint, fingerprint_of
from carom.state.energies import Energy
from carom.state.frame import CollisionGraph, Frame, empty_graph

WARM_UP_DT = 1e-3  # length of a warm-up step, as a fraction of the first step that the limits allow


class StepStatus(NamedTuple):
    """Progress of a run at the end of a step."""

    step: int
    time: float  # s
    dt: float  # s
    dt_limit: str  # the limit that set dt
    contacts: int  # number of contacts that touch or carry an impulse
    energy: Energy  # energies at the last check or frame

    @property
    def energy_error(self) -> float:
        """Magnitude of the integration error, relative to the energy scale."""
        return self.energy.relative_error


class Simulation:
    """A scene in motion, given its stepper; `Space` documents the parameters.

    Only one thread may step a simulation. Meanwhile, other threads may only read ``status`` and call ``stop``.

    Errors are checked at the first step at or after each multiple of `check_interval` (s), at every
    ``record.check_every``-th step, and at the end of a run. The interval follows from the scene, so a verdict does not
    depend on the recording. If the interval is None, errors are checked at the frames.
    """

    def __init__(
        self,
        scene: Scene,
        start: InitialBodies,
        threads: int | None = None,
        stride: float = 1.0,
        record_contacts: bool = False,
    ) -> None:
        self.scene = scene
        self.names = start.name
        self.groups = start.group
        self.mass = start.mass  # (n,) kg, including bodies that wait to enter or have left
        self.entries = EntryStates(start.position, start.velocity, start.angular_velocity)
        self.threads = threads or cores()
        self.ends_with_forces = integrator(scene).ends_with_forces
        self.check_interval: float | None = auto_interval(scene, scene.time.duration)
        self._records_contacts = record_contacts
        audited = scene.expect.contact_audit is not None
        self._world = World.at_start(scene, start, Team(self.threads), record_contacts or audited)
        self.requirements = self._world.needs
        self.planes = self._world.planes
        self.state = self._world.bodies
        self.profile = self._world.profile
        self._contact = self._world.contact
        self._tap = self._contact.part(ContactTap) if self._contact else None
        self._books = Bookkeeper(self._world)
        self._stepper = _stepper_of(self._world, self._books, stride)
        self._stopping = False
        self._no_turns = np.zeros_like(self.state.torque)  # N m s, angular impulses of a step without impacts
        potentials = warm_up(self._world, self._stepper)
        if scene.time.fixed_dt is None and not integrator(scene).controls_error:
            own = scene.unit_system, remedies_of(scene)
            self._books.pace = PaceMonitor(scene.time.duration, self.first_dt, *own)
        self._books.measure(potentials, judged=True)
        self._publish()
        self.profile.clear()

    @property
    def step(self) -> int:
        """Number of the last step."""
        return self._world.clock.step

    @property
    def time(self) -> float:
        """The time after the last step (s)."""
        return self._world.clock.time

    @property
    def dt(self) -> float:
        """The length of the last step (s); 0 before the first."""
        return self._world.clock.dt

    @property
    def dt_limit(self) -> str:
        """The limit that set the length of the last step, as in `Frame`."""
        return self._world.clock.limit

    @property
    def box(self) -> FloatArray | None:
        """Size of the periodic domain, (3,) m, or None in open space."""
        return self._world.box if self._world.is_periodic else None

    @property
    def contacts(self) -> CollisionGraph:
        """The contacts of the last step, for the stepping thread only; built at the first access."""
        return self._contact.snapshots.snapshot.graph if self._contact else empty_graph()

    @property
    def status(self) -> StepStatus:
        """The status at the end of the last finished step; any thread may read it."""
        return StepStatus(*self._published)

    @property
    def first_dt(self) -> float:
        """The step in seconds that the limits allow in the present state."""
        return self._stepper.first_dt

    @property
    def has_solution(self) -> bool:
        """Whether the integrator has dense output for the last step, which `between` needs."""
        return self._stepper.has_solution

    def between(self, time: float) -> tuple[FloatArray, FloatArray] | None:
        """Return positions and velocities, (n, 3) m and m/s, at a time (s) within the last step.

        Return None if the integrator has no dense output.
        """
        return self._stepper.between(self.time - time)

    def fingerprint(self) -> int:
        """Return a 64-bit fingerprint of the exact state."""
        bodies = self.state
        state = bodies.position, bodies.velocity, bodies.orientation, bodies.angular_velocity
        return fingerprint_of(self.time, state)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore a checkpoint of the same scene; the following steps have the same bits as in the original run.

        The torques and the contact graph of the previous step are not stored, so they are empty until the next step.
        """
        clock = self._world.clock
        _write(checkpoint, self.state)
        clock.step, clock.time, clock.dt, clock.limit = checkpoint.step, checkpoint.time, 0.0, "start"
        self._stepper.restore(checkpoint)
        self._books.restore(checkpoint)
        self._books.measure(self._world.forces.potentials(), judged=False)
        self._publish()

    def accelerated(self) -> FloatArray:
        """Compute the accelerations of the present state anew; return a copy, (n, 3) m/s²."""
        self._world.forces.accelerate(potential=False)
        return self.state.acceleration.copy()

    def begin_as(self, start: Checkpoint) -> None:
        """Measure errors relative to the reference values of a recorded start, whose rounding may differ."""
        if self._books.audit.refer_to(start.books):
            self._books.measure(self._world.forces.potentials(), judged=True)
            self._publish()

    def run(
        self, until: float | None = None, store: FrameStore | None = None, schedule: Schedule | None = None
    ) -> Iterator[Frame]:
        """Step until a time, by default the end of the scene, and yield the frames requested by ``record.every``.

        The first frame is the present state, the last frame is the state at the end. Frames change neither the steps
        nor the verdict. A stopped run is also checked at its end, after its last frame.

        Parameters
        ----------
        until
            s.
        store
            Memory for the arrays of the frames; without it, each frame owns its arrays.
        schedule
            Steps after which frames are yielded; by default the steps of ``record.every``.

        Raises
        ------
        PhysicsError
            If the state is no longer finite, or a step no longer changes the clock.
        """
        end = self.scene.end if until is None else until
        shown_after, interval = schedule or every(frame_interval(self.scene)), self.check_interval
        steps = self.scene.record.check_every
        checks = Checks(steps, shown_after if interval is None else every(interval))
        goal = Goal(end, shown_after, checks, most=steps)
        try:
            yield self.frame(store)
            shown = self.step
            while self.time < end and not self._stopping:
                if self._advance(goal):
                    yield self.frame(store)
                    shown = self.step
            if self.step != shown:
                yield self.frame(store)
            if self.time < end:  # stopped
                self._books.measure(self._world.forces.potentials(), judged=True)
        finally:
            self._stopping = False

    def reach(self, time: float) -> None:
        """Step until a time in s, without frames or checks; see `run`."""
        goal = Goal(time, at(()), at(()), most=self.scene.record.check_every, shows_end=False)
        while self.time < time and not self._stopping:
            self._advance(goal)
        self._stopping = False

    def approach(self, time: float, most: int, *, ends_there: bool) -> None:
        """Take one step, or ``most`` steps in one call, but not beyond a time (s), without frames or checks.

        While contacts last, a call takes one step. Whether a kernel could take several steps depends on what this
        process has compiled; the work of a look-ahead is counted in calls and must not depend on that.
        """
        if self._contact and not self._contact.is_quiet:
            most = 1
        end = time if ends_there else self.scene.time.duration
        self._advance(Goal(end, at(()) if ends_there else Pause(time), at(()), most, shows_end=False))

    @property
    def contact_work(self) -> tuple[int, int, int]:
        """Numbers of contacts, of solver sweeps and of impacts in the last step."""
        contact = self._contact
        return (contact.statistics.contacts, contact.sweeps, len(contact.impacts)) if contact else (0, 0, 0)

    def count_no_impacts(self) -> None:
        """Exclude impacts during drifts from the statistics, which saves a quarter of the time of a look-ahead."""
        if self._contact:
            self._contact.counts_impacts = False

    def stop(self) -> None:
        """End `run` after the current step, with a last frame; any thread may call this.

        Between two runs, the call ends the next run at its first frame.
        """
        self._stopping = True

    def frame(self, store: FrameStore | None = None) -> Frame:
        """Copy the state of the last step, with its energy and momentum."""
        books, audit = self._books, self._books.audit
        if audit.step != self.step:
            books.measure(self._world.forces.potentials(), judged=self.check_interval is None)
        books.activity.judge(audit.energy)
        state, needs, momentum = self.state, self.requirements, audit.momentum
        slot = None if store is None else store.keep()
        buffer = None if store is None or slot is None else store.contact_rows[slot]
        impacts: Records | None = NO_ROWS if self._records_contacts else None
        contact_rows, left_out, sums = impacts, 0, None
        if self._records_contacts and self._tap:
            impacts, left_out, sums = self._tap.pop_impacts()
            contact_rows = self._tap.rows(buffer)
        arrays = copies(state) if store is None or slot is None else store.kept(slot)
        position, velocity, acceleration, orientation, angular_velocity, torque, angular_acceleration = arrays
        angular_impulse = self.without_impacts(torque, angular_acceleration)
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
            energy=audit.energy,
            momentum=momentum.linear,
            angular_momentum=momentum.angular,
            sweeps=self._contact.sweeps if self._contact else 0,
            phase=books.activity.phase,
            events=books.pop_events(),
            previous_dt=self._stepper.previous_dt,
            memory=self._contact.memory if self._contact else None,
            books=books.state,
            integrator=self._stepper.checkpoint,
            momentum_error=momentum.linear_error,
            angular_momentum_error=momentum.angular_error,
            slot=slot,
            impacts=impacts,
            impacts_left_out=left_out,
            impact_sums=sums,
            contact_rows=contact_rows,
            angular_impulse=angular_impulse if needs.torque.modelled else None,
            expected_error=0.0 if self.scene.promise is None else self.scene.promise.error_at(self.time),
        )

    def without_impacts(self, torque: FloatArray, angular_acceleration: FloatArray) -> FloatArray:
        """Subtract impacts from copies of the last step's torques and angular accelerations, (n, 3) N m and rad/s².

        Return the angular impulses of impacts in the step, (n, 3) N m s, as an array that must not be modified.
        """
        turns = self._contact.turns_of_impacts if self._contact and len(torque) else None
        if turns is None:
            return self._no_turns
        state = self.state
        turns.take_from(torque, angular_acceleration, self.dt, state.angular_velocity, state.inertia)
        return turns.sum

    def _publish(self) -> None:
        """Replace the status that other threads read; other threads get either the previous or the new status."""
        clock, contacts = self._world.clock, self._contact.statistics.contacts if self._contact else 0
        # a plain tuple, since a named tuple takes 0.2 µs to create, and a step of a few bodies takes 8 µs
        self._published = (clock.step, clock.time, clock.dt, clock.limit, contacts, self._books.audit.energy)

    def _advance(self, goal: Goal) -> bool:
        """Advance by at least one step; return whether a frame is due."""
        self.profile.start()
        due = self._stepper.advance(goal)
        self._publish()
        return due


def _stepper_of(world: World, books: Bookkeeper, stride: float) -> Stepper:
    """Return the stepper of a world, with steps up to ``stride`` times as long as the scene's steps."""
    scene = world.scene
    if scene.promise is not None:
        until, ordinary = scene.promise.kept_until, without_accuracy(scene)
        plain = replace(world, scene=ordinary, needs=require(ordinary))
        accurate = _own_stepper_of(world, books, stride)
        return PromisedStepper(world.clock, until, accurate, lambda: _own_stepper_of(plain, books, stride))
    return _own_stepper_of(world, books, stride)


def _own_stepper_of(world: World, books: Bookkeeper, stride: float) -> KickDriftStepper | BatchStepper:
    """Return a stepper that takes all steps of a world in the same way."""
    scene = world.scene

    def timestep(limits: StepLimits, scene: Scene) -> Timestep:
        return Timestep.of(scene, limits, world.bodies, world.falling, world.team)

    def kick_drift(world: World) -> KickDriftStepper:
        asked = timestep(step_limits(world.scene), world.scene)
        if stride > 1.0:
            return KickDriftStepper(world, books, timestep(wider_limits(world.scene, stride), world.scene), asked)
        if stride < 1.0:
            return KickDriftStepper(world, books, timestep(*shorter_steps(world.scene, stride)))
        return KickDriftStepper(world, books, asked)

    batches = batch_integrator_of(scene, world.needs, world.bodies, world.forces.uniform)
    if batches:
        held = holding(scene)
        holder = kick_drift(replace(world, scene=held, needs=require(held))) if world.contact else None
        return BatchStepper(world, books, batches, timestep(step_limits(scene), scene), holder)
    return kick_drift(world)


def warm_up(world: World, stepper: Stepper) -> Potentials:
    """Take a few tiny steps, then restore the state, so that frame 0 is the scene as written.

    The steps load the kernels and compute the accelerations for the first adaptive step. Return the potential energies.
    """
    bodies = world.bodies
    moved = (bodies.position, bodies.velocity, bodies.orientation, bodies.angular_velocity)
    changing = (*moved, bodies.torque, bodies.angular_acceleration)
    saved = [array.copy() for array in changing]
    world.forces.accelerate(potential=False)
    stepper.warm_up(WARM_UP_DT * stepper.first_dt)
    for array, value in zip(changing, saved, strict=True):
        array[:] = value
    potentials = world.forces.accelerate(potential=True)
    stepper.begin()
    return potentials


def _write(checkpoint: Checkpoint, bodies: Bodies) -> None:
    """Restore the state of the bodies. Torques are not stored, so they are zero until the next step."""
    bodies.position[:] = checkpoint.position
    bodies.velocity[:] = checkpoint.velocity
    bodies.acceleration[:] = checkpoint.acceleration
    bodies.torque[:] = 0.0
    bodies.angular_acceleration[:] = 0.0
    if checkpoint.orientation is not None:
        bodies.orientation[:] = checkpoint.orientation
    if checkpoint.angular_velocity is not None:
        bodies.angular_velocity[:] = checkpoint.angular_velocity
