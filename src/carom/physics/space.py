"""The order of one step, and the run of many."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies, BodyProxy
from carom.physics.contact.graph import CollisionGraph, empty_graph
from carom.physics.contact.stage import ContactStage
from carom.physics.energy import Energy, EnergyAccount, Ledger
from carom.physics.error import PhysicsError
from carom.physics.fingerprint import fingerprint
from carom.physics.frame import Checkpoint, Event, Frame, FrameStore, copies
from carom.physics.gravity.method import gravity_of
from carom.physics.integrator import SUBSTEPS, add_field, drift, kick, wrap
from carom.physics.moments import Moments
from carom.physics.momentum import MomentumAccount
from carom.physics.names import Names
from carom.physics.profile import Profile
from carom.physics.rotation import rotate
from carom.physics.timestep import Timestep
from carom.physics.watch import EnergyWatch, Suspects
from carom.scene.halfspace import half_spaces
from carom.scene.limits import refuse_impossible
from carom.scene.placement import place
from carom.scene.requirements import frame_interval, require
from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]

WARM_UP_STEPS = 3
WARM_UP_DT = 1e-3  # of the step that the limits allow at the start
MULTIPLE_TOLERANCE = 1e-9  # of a time, within which it counts as a multiple of the frames' interval
SETTLED_MEMORY = 50  # steps over which the energy of impacts is summed
SETTLED_BELOW = 1e-3  # of the energy scale; a pile whose impacts sum to less has settled


class Space:
    """Bodies in motion: the seed's public calls, and what people need besides.

    Parameters
    ----------
    scene
        What to simulate.
    threads
        Threads for the kernels, by default one a core. The bits do not depend on it.

    Raises
    ------
    SceneError
        If the scene cannot run on this machine or in this version, or its bodies cannot be placed.
    """

    def __init__(self, scene: Scene, threads: int | None = None) -> None:
        refuse_impossible(scene)
        self.scene = scene
        self.requirements = require(scene)
        start = place(scene)
        self.names = start.name
        self.groups = start.group
        self.planes = half_spaces(scene)
        self.state = Bodies.at_start(start, self.requirements.spin.modelled, len(self.planes))
        self.threads = threads or _cores()
        self.time = 0.0  # s
        self.step = 0
        self.dt = 0.0  # s
        self.dt_limit = "start"
        self.ledger = Ledger()
        self.moments = Moments()
        self.profile = Profile()
        self.contacts: CollisionGraph = empty_graph()
        self._field = np.array(scene.gravity.uniform)
        self._box = np.array(scene.domain.size if scene.domain.boundary == "periodic" else (0.0, 0.0, 0.0))
        self._fixed = np.flatnonzero(start.fixed)
        # where something stands still, speeds count from it, and the field does not pull all alike
        self._falling = np.zeros(3) if scene.anchored else self._field
        self._substeps = SUBSTEPS[scene.time.integrator]
        self._gravity = gravity_of(scene, self.state.mass, self.threads)
        self._contact = self._make_contact()
        self._timestep = Timestep(scene.time, self._falling, scene.anchored)
        self._energy_account = EnergyAccount(self._field, scene.anchored)
        self._momentum_account = MomentumAccount(self.state, self._field, self._box[0] > 0.0, scene.anchored)
        self._watch = EnergyWatch(scene.record.energy_tolerance, Names(self.names, self.planes.name))
        self._suspects: list[Suspects] = []
        self._events: list[Event] = []
        self._activity = 0.0  # J, ½ μ v_n² of the impacts in the last steps
        self._stopping = False
        self._counted = -1  # the step whose energy and momentum are known
        self._phase = "warm-up"
        self._warm_up()
        self._take_stock(self._accelerate(potential=True), checked=True)
        self.profile.clear()

    @property
    def box(self) -> FloatArray | None:
        """Size of the periodic domain, (3,) m, or None in open space."""
        return self._box if self._box[0] > 0.0 else None

    @property
    def first_dt(self) -> float:
        """The step in seconds that the limits allow in the present state."""
        return self.scene.time.fixed_dt or self._timestep.target(self.state)[0]

    @property
    def checked_energy(self) -> Energy:
        """The energy as of the last check or frame, without computing it anew."""
        return self._energy

    @property
    def bodies(self) -> list[BodyProxy]:
        """One view for each body, in the order of the scene."""
        return [BodyProxy(self.state, index) for index in range(len(self.state))]

    def compute_dynamics(self, iteration: int) -> None:
        """Compute one step.

        Parameters
        ----------
        iteration
            Number of the step; every ``record.log_freq``-th checks the energy.

        Raises
        ------
        PhysicsError
            If the state is no longer finite.
        """
        self._advance(np.inf, checked=iteration % self.scene.record.log_freq == 0, interval=np.inf)

    def get_body_data_for_display(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions (n, 3), quaternions (n, 4) xyzw, torques (n, 3) and angular accelerations (n, 3) as copies.

        Bodies that the scene does not require to spin have the identity and zeros.
        """
        state, n = self.state, len(self.state)
        if self.requirements.spin.modelled:
            turning = (state.orientation.copy(), state.torque.copy(), state.angular_acceleration.copy())
        else:
            turning = (np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((n, 3)), np.zeros((n, 3)))
        return (state.position.copy(), *turning)

    def energy(self) -> Energy:
        """Take stock of the energy now: terms, ledger, integration error."""
        return self._energy_account.balance(self.state, self._accelerate(potential=True), self.ledger)

    def momentum(self) -> FloatArray:
        """Σ m v, (3,) kg m/s."""
        return self._momentum_account.balance(self.state, self.time).linear

    def angular_momentum(self) -> FloatArray:
        """Σ (m x × v + I ω) about the origin, (3,) kg m²/s."""
        return self._momentum_account.balance(self.state, self.time).angular

    def fingerprint(self) -> int:
        """64 bits of the exact state."""
        return fingerprint(self.state, self.time)

    def run(self, until: float | None = None, store: FrameStore | None = None) -> Iterator[Frame]:
        """Step until a time, by default the scene's duration, and hand out the frames that ``record.every`` asks for.

        The first frame is the state now, the last one the state at the end. The frames asked for do not change the
        steps.

        Parameters
        ----------
        until
            s.
        store
            Where the arrays of the frames are kept; without one each frame owns its own.

        Raises
        ------
        PhysicsError
            If the state is no longer finite, or a step no longer moves the clock.
        """
        end = self.scene.time.duration if until is None else until
        interval = frame_interval(self.scene)
        yield self.frame(store)
        while self.time < end and not self._stopping:
            checked = (self.step + 1) % self.scene.record.log_freq == 0
            if self._advance(end, checked, interval):
                yield self.frame(store)
        if self._stopping:
            yield self.frame(store)

    def stop(self) -> None:
        """Let `run` end after the step it is in, with a last frame of that moment; any thread may call it."""
        self._stopping = True

    def highlights(self) -> tuple[Event, ...]:
        """Return the extremes of the run so far as events, each at its own time."""
        return self.moments.highlights(Names(self.names, self.planes.name))

    def frame(self, store: FrameStore | None = None) -> Frame:
        """Copy the state of the last step, with its energy and momentum."""
        if self._counted != self.step:
            self._take_stock(self._accelerate(potential=True), checked=False)
        state, spins, momentum = self.state, self.requirements.spin.modelled, self._momentum
        turns = spins and self.requirements.torque.modelled
        events, self._events = tuple(self._events), []
        slot = None if store is None else store.keep(state)
        arrays = copies(state) if store is None or slot is None else store.kept(slot)
        position, velocity, acceleration, orientation, angular_velocity, torque, angular_acceleration = arrays
        return Frame(
            step=self.step,
            time=self.time,
            dt=self.dt,
            dt_limit=self.dt_limit,
            position=position,
            velocity=velocity,
            orientation=orientation if spins else None,
            angular_velocity=angular_velocity if spins else None,
            torque=torque if turns else None,
            angular_acceleration=angular_acceleration if turns else None,
            contacts=self.contacts,
            energy=self._energy,
            momentum=momentum.linear,
            angular_momentum=momentum.angular,
            sweeps=self._contact.sweeps if self._contact else 0,
            phase=self._phase,
            events=events,
            fingerprint=self.fingerprint(),
            checkpoint=Checkpoint(acceleration, self._timestep.previous),
            momentum_error=momentum.linear_error,
            angular_momentum_error=momentum.angular_error,
            slot=slot,
        )

    def _make_contact(self) -> ContactStage | None:
        if not self.requirements.contact.modelled:
            return None
        return ContactStage(self.scene.contact, self.state, self.planes, self.requirements, self._box, self._falling)

    def _advance(self, end: float, checked: bool, interval: float) -> bool:
        """Do one step; tell whether a frame is due after it.

        Frames are due at the first step at or after each multiple of ``interval``, and at the end.
        """
        self.profile.start()
        state, contact = self.state, self._contact
        self.dt, self.dt_limit = self._timestep.choose(state, end - self.time)
        before, self.time = self.time, end if self.dt_limit == "end" else self.time + self.dt
        if not self.time > before:
            raise PhysicsError(self._stuck(before))
        due = (
            self.dt_limit == "end" or interval == 0.0 or _multiples(self.time, interval) > _multiples(before, interval)
        )
        if checked and contact:
            self._suspect(contact)
        self.step += 1
        self.profile.mark("timestep")
        potential = self._integrate(self.dt, with_potential=due or checked)
        if contact:
            self._respond(contact)
            if checked:
                self._suspect(contact)
        else:
            self._phase = "free"
        if due or checked:
            self._take_stock(potential, checked)
        return due

    def _integrate(self, dt: float, with_potential: bool) -> float:
        """Kick, drift, kick; overlaps are undone after the last drift, so that forces belong to the final positions.

        The seed pushes bodies apart at the end of the step. The forces would then be those of other positions, the next
        kick would not be central, and angular momentum would drift by overlap × force; or they would have to be
        computed twice.
        """
        state = self.state
        rotate(state.orientation, state.angular_velocity, dt)
        potential = 0.0
        for index, substep in enumerate(self._substeps):
            last = index == len(self._substeps) - 1
            kick(state.velocity, state.acceleration, substep.before * dt)
            if index == 0 and self._contact:
                self.profile.mark("integrate")
                self._contact.hold(substep.before * dt, dt)
                self.profile.mark("response")
            drift(state.position, state.velocity, substep.drift * dt)
            self.profile.mark("integrate")
            if last and self._contact:
                self._refuse_infinities()
                self._contact.find(dt, self.profile)
            if self._box[0] > 0.0:
                wrap(state.position, self._box)
            potential = self._accelerate(with_potential and last)
            self.profile.mark("gravity")
            kick(state.velocity, state.acceleration, substep.after * dt)
            self.profile.mark("integrate")
        return potential

    def _accelerate(self, potential: bool) -> float:
        """Fill the accelerations; return the gravitational energy if it is asked for."""
        acceleration = self.state.acceleration
        energy = None
        if self._gravity:
            energy = self._gravity.accelerate(self.state.position, acceleration, potential)
        else:
            acceleration[:] = 0.0
        if self.requirements.field.modelled:
            add_field(acceleration, self._field)
        if len(self._fixed):
            acceleration[self._fixed] = 0.0
        return energy or 0.0

    def _respond(self, contact: ContactStage) -> None:
        """Resolve the contacts and book what they did."""
        contact.resolve(self.dt, self._substeps[-1].after * self.dt)
        self.contacts = contact.graph
        self.profile.mark("response")
        if len(contact.held):
            self.ledger = self.ledger.plus(contact.held)
        if len(self.contacts):
            if self.moments.contacts is None:
                i, j = self.contacts.pairs[0]
                names = Names(self.names, self.planes.name)
                self._log("INFO", f"First contact: {names.of(i)} and {names.of(j)}.")
            self.ledger = self.ledger.plus(contact.work)
            struck = self.moments.see_contacts(
                self.step, self.time, self.contacts, contact.approach, contact.rest_speed, self.state
            )
            self._activity += struck - self._activity / SETTLED_MEMORY
            self._phase = "settled" if self._is_settled() else "colliding"
            for text in contact.limits_reached():
                self._log("WARN", text)
        else:
            self._activity -= self._activity / SETTLED_MEMORY
            self._phase = "free"
        contact.turn(self.dt)
        self.profile.mark("torque")

    def _suspect(self, contact: ContactStage) -> None:
        """Keep the contacts of the present step for a warning that may come."""
        self._suspects.append(Suspects.of(self.step, self.contacts, contact.contributions, self.state))

    def _is_settled(self) -> bool:
        """Tell whether most bodies touch and the impacts of late were slight."""
        quiet = self._activity <= SETTLED_BELOW * self._energy.scale
        return quiet and 2 * len(self.contacts) >= len(self.state)

    def _take_stock(self, potential: float, checked: bool) -> None:
        """Compute energy and momentum, and compare them with before."""
        self._energy = self._energy_account.balance(self.state, potential, self.ledger)
        if not np.isfinite(self._energy.total):
            self._refuse_infinities()
            raise PhysicsError(f"the energy is no longer finite at step {self.step}, t = {self.time:.6g} s")
        self.moments.see_energy_error(self.step, self.time, self._energy.relative_error)
        self._momentum = self._momentum_account.balance(self.state, self.time)
        self.moments.see_momentum_error(self._momentum.linear_error, self._momentum.angular_error)
        self._counted = self.step
        if checked:
            warning = self._watch.check(self.step, self.time, self._energy, self._suspects)
            self._suspects = []
            if warning:
                self._events.append(warning)
        self.profile.mark("energy")

    def _warm_up(self) -> None:
        """Take a few tiny steps, then put the state back: frame 0 is the scene as written.

        They fill the accelerations that the first adaptive step is chosen from, and compile the kernels.
        """
        state = self.state
        changing = (state.position, state.velocity, state.orientation, state.angular_velocity)
        saved = [array.copy() for array in changing]
        self._accelerate(potential=False)
        tiny = WARM_UP_DT * self.first_dt
        for _ in range(WARM_UP_STEPS if self.requirements.warm_up.modelled else 1):  # one loads the kernels
            self._integrate(tiny, with_potential=False)
            if self._contact:
                self._contact.resolve(tiny, self._substeps[-1].after * tiny)
        for array, value in zip(changing, saved, strict=True):
            array[:] = value
        self._accelerate(potential=True)
        if self.requirements.warm_up.modelled:
            self._timestep.previous = self._timestep.target(state)[0]
        self.contacts = empty_graph()
        if self._contact:
            self._contact.forget()
            self._contact.begin(self.first_dt)

    def _log(self, level: str, text: str) -> None:
        self._events.append(Event(self.step, self.time, level, text))

    def _stuck(self, time: float) -> str:
        return (
            f"step {self.step + 1} of {self.dt:.3g} s no longer moves the clock at t = {time:.6g} s "
            f"(limit: {self.dt_limit}); raise time.target_dx or time.cfl, or set time.fixed_dt"
        )

    def _refuse_infinities(self) -> None:
        finite = np.isfinite(self.state.position) & np.isfinite(self.state.velocity)
        if finite.all():
            return
        lost = np.flatnonzero(~finite.all(axis=1))
        names = ", ".join(f'{body} "{self.names[body]}"' for body in lost[:5])
        at = f"step {self.step}, t = {self.time:.6g} s"
        raise PhysicsError(f"the state is no longer finite at {at}: {len(lost)} bodies, among them {names}")


def _multiples(time: float, interval: float) -> float:
    """Count the multiples of an interval up to a time, forgiving the rounding of a clock that adds up steps."""
    return time / interval * (1.0 + MULTIPLE_TOLERANCE) // 1.0


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
