"""Many steps of few bodies in one kernel, as long as the same contacts last: at rest, sliding or rolling.

A step of two balls in contact takes a few microseconds in one kernel, and nearly two hundred if Python calls a kernel
for each of its stages. `KickDriftStepper` therefore leaves the steps before the next frame or check to this module, as
it leaves steps without contacts to `carom.physics.free_flight`. It makes the step that ends at the frame or check
itself, since Python needs the contacts of this step. Kernels and bits are the same as in single steps.

Entries of the books are summed here in the same order: the ledger, the numbers of contacts, the deepest overlap. A step
that Python must process is undone and left to `KickDriftStepper`; `steady_contacts` lists these cases.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray, dtype_of
from carom.physics.contact.contact_tap import ContactTap
from carom.physics.contact.events.drift import EventDrivenDrift
from carom.physics.contact.events.steady_contacts import (
    MOST_CONTACTS,
    SteadyContacts,
    copy_contacts,
    drift_steady,
    find_steady,
    hold_steady,
    resolve_steady,
)
from carom.physics.contact.graph import OrderedContacts
from carom.physics.contact.plane_guard import PlaneGuard
from carom.physics.contact.reactions import add_support, write_torques
from carom.physics.diagnostics.bookkeeper import Bookkeeper
from carom.physics.diagnostics.run_monitor import remembered
from carom.physics.free_flight import (
    MOST_STEPS,
    FlightBuffers,
    FlightClock,
    FlightLaws,
    FreeFlight,
    KeptState,
    MovedState,
    choose_step,
    copy_state,
    sum_accelerations,
)
from carom.physics.integrators.kick_drift import (
    KickedBodies,
    advance,
    book_exchange,
    damped_step,
    kick_after_drift,
    kick_before_drift,
    measure_hold,
    wrap_rows,
)
from carom.physics.jit.by_address import by_address
from carom.physics.jit.decorators import borrowing, compiles_all, entry_if_worthwhile, inline
from carom.physics.jit.inside import PLAIN
from carom.physics.rotation import rotate_one
from carom.physics.schedule import Goal
from carom.physics.step_rule import END, FIXED, LIMIT_NAMES
from carom.physics.time_step import Timestep
from carom.physics.vector import is_periodic
from carom.physics.world import World
from carom.plan.auto import integrator

PATIENCE = 256  # single steps after which it is decided, each time, whether to load or compile the kernel
LONGEST_PAUSE = 16  # single steps between two calls if each call ends at a step that Python must process


class SteadyTotalsRecord(Protocol):
    """Totals of steps, to be added to the books."""

    restitution: float  # J, this and the next two as in `Ledger`
    friction: float
    stabilisation: float
    impact_energy: float  # J, see `Activity`; before the last step
    deepest: float  # overlap / smaller radius, the largest of the run
    deepest_i: int
    deepest_j: int
    deepest_step: int  # 0 if it was before these steps
    deepest_time: float  # s
    most: int  # contacts in a step, the largest of the run
    most_step: int  # 0 if it was before these steps
    most_time: float  # s
    contacts: int  # sum over these steps
    last_kick: float  # s
    last_dt: float  # s
    sweeps: int  # of the last step


STEADY_TOTALS = dtype_of(SteadyTotalsRecord)


class SteadySteps:
    """Makes steps of a world in which the same contacts last, with the laws and the state of a `FreeFlight`."""

    def __init__(self, world: World, books: Bookkeeper, timestep: Timestep, flight: FreeFlight) -> None:
        assert world.contact is not None, "see `make`"
        self._world, self._books, self._timestep, self._contact = world, books, timestep, world.contact
        laws, moved, kept, buffers = flight.arguments
        kept = kept._replace(supported=np.empty(len(world.bodies.ends.radius) if timestep.spares_held else 0))
        self._arguments = laws, moved, kept, buffers
        self._totals = np.zeros(1, STEADY_TOTALS)
        self._last: OrderedContacts | None = None  # the contacts of the last step that was examined
        self._go_on: Callable[..., tuple[Any, ...]] | None = None  # the kernel; None until it is worthwhile
        self._first: float = np.inf  # number of the first step that was examined
        self._pause, self._next_pause = 0, 1  # single steps before the next call, and after it if it is in vain
        self._waited = 0  # single steps that the kernel could have made
        self._next_decision = PATIENCE  # number of such steps at which to decide again whether the kernel is worthwhile

    def advance(self, goal: Goal) -> bool:
        """Make the steps before the next frame or check, if the same contacts last; return whether there were any."""
        world, books, contact, clock = self._world, self._books, self._contact, self._world.clock
        lasts, self._last = contact.contacts is self._last, contact.contacts
        self._first = min(self._first, clock.step)
        if not (lasts and contact.is_steady and (self._go_on or self._is_patient())):
            return False
        if self._pause > 0:
            self._pause -= 1
            return False
        every, (steps, until) = world.scene.record.check_every, goal.quiet(clock)
        most = int(min(goal.most, steps, every - clock.step % every, MOST_STEPS + 1)) - 1
        if most < 1 or len(contact.contacts) > MOST_CONTACTS or not contact.solver.code.is_complete:
            return False
        totals = self._totals
        contacts = SteadyContacts.of(contact, world.bodies, world.step.against)
        for name, value in books.steady_totals().items():
            totals[name] = value
        totals["deepest_step"] = totals["most_step"] = totals["contacts"] = 0
        totals["last_kick"], totals["last_dt"] = contact.last_kick, clock.dt
        until, timestep = min(until, books.kept_until), self._timestep
        for lend in world.hooks.lend:
            lend(books.audit)
        asked = FlightClock(clock.time, goal.end, until, most, timestep.previous, 0.0, True), clock.step
        if self._go_on is None:
            share = self._waited / (clock.step - self._first + 1) * most / (most + 1)
            coming = (goal.end - clock.time) / clock.dt * share
            self._next_decision = self._waited + PATIENCE
            self._go_on = entry_if_worthwhile(_go_on, coming, *asked, *self._arguments, contacts, totals)
        if self._go_on is None:
            return False
        taken, before, time, dt, limit, timestep.previous = self._go_on(*asked, *self._arguments, contacts, totals)
        self._next_pause = 1 if taken else min(2 * self._next_pause, LONGEST_PAUSE)
        self._pause = self._next_pause  # the kernel has left the next step to Python
        if taken == 0:
            return False
        clock.advance(taken, before, time, dt, LIMIT_NAMES[limit])
        contact.add_steady_steps(float(totals["last_kick"][0]), dt, int(totals["sweeps"][0]))
        books.book_steady_steps(totals)
        for settle in world.hooks.settle:
            settle(books.audit)
        books.activity.add_step(contact.statistics.contacts, 0.0)
        world.profile.mark("resting")
        return True

    def _is_patient(self) -> bool:
        """Count a single step that the kernel could have made; return whether there were enough for a decision."""
        self._waited += 1
        return self._waited >= self._next_decision or compiles_all()


def make(world: World, books: Bookkeeper, timestep: Timestep, flight: FreeFlight) -> SteadySteps | None:
    """Return a `SteadySteps`; None if the scene has features that its kernel does not support."""
    contact, substeps = world.contact, integrator(world.scene).substeps
    if PLAIN or contact is None or contact.part(EventDrivenDrift) is None or len(substeps) > 1:
        return None
    known = EventDrivenDrift, PlaneGuard, ContactTap, type(world.forces.damping)  # parts that its kernel replaces
    if not all(isinstance(part, known) for part in contact.parts):
        return None
    settings, is_held_twice = contact.settings, min(substeps[0]) > 0.0
    is_known = settings.stabilisation != "baumgarte" and settings.search != "k-d-tree"  # which rounds otherwise
    return SteadySteps(world, books, timestep, flight) if is_held_twice and is_known else None


@borrowing
def _go_on(
    clock: FlightClock,
    step: int,
    laws: FlightLaws,
    moved: MovedState,
    kept: KeptState,
    buffers: FlightBuffers,
    contacts: SteadyContacts,
    totals: RecordArray[SteadyTotalsRecord],
) -> tuple[int, float, float, float, int, float]:
    """Make steps; return their number, the times before and after the last one, its length, limit, and the average."""
    contacts = by_address(contacts)
    time, end, until, most, average, _, _ = clock
    position, velocity, acceleration, orientation, spin = moved
    T, saved, n = totals[0], buffers.saved, len(position)
    first, whole, last = laws.substeps[0, 0], laws.substeps[0, 1], laws.substeps[0, 2]
    kicked = KickedBodies(position, velocity, acceleration, kept.mass, kept.inverse_mass)
    before, dt, limit, steps = time, 0.0, FIXED, 0
    while steps < most:
        if len(kept.supported) > 0:
            kept.supported[:] = 0.0
            touching = contacts.pairs, contacts.place, contacts.system.contacts, contacts.system.inverse_mass
            add_support(*touching, T.last_kick, kept.supported)
        length, why, following = choose_step(laws, moved, kept, buffers, average, end - time)
        after = time + length
        first_kick, last_kick = first * length, last * length
        if why == END or not time < after < until or not min(first_kick, last_kick) > 0.0:
            break
        copy_state(position, velocity, acceleration, saved[0], saved[1], saved[2])
        copy_contacts(contacts, False)
        for i in range(len(orientation)):
            rotate_one(i, orientation, spin, length)
        damped = damped_step(laws.damping, length, first_kick, last_kick)
        kick_before_drift(laws.damping, kicked, damped, True)
        first_kick, last_kick = damped.held_kick, damped.last_kick
        hold_steady(contacts, first_kick, T.last_kick, T.last_dt, length, damped.booked)
        measure_hold(laws.damping, kicked, damped)
        restitution, friction, stabilisation = 0.0, 0.0, 0.0
        for piece in range(len(contacts.system.piece_results)):
            found = contacts.system.piece_results[piece]
            restitution += found.restitution_loss
            friction += found.friction_loss
            stabilisation += found.stabilisation_gain
        is_steady, sweeps = damped.path.strength == 1.0 and _are_finite(position, velocity), 0
        if is_periodic(kept.box):
            is_steady = is_steady and not _crosses(velocity, kept.box, whole * length)
        if is_steady:
            is_steady = drift_steady(contacts, damped.path, whole * length)
        if is_steady:
            advance(0, n, position, velocity, whole * length)
            is_steady = _are_finite(position, velocity)
        if is_steady:
            is_steady = find_steady(contacts, position, kept.radius, length)
            if is_periodic(kept.box):
                wrap_rows(0, n, position, kept.box)
        if is_steady:
            sum_accelerations(laws, moved, kept, buffers)
            kick_after_drift(laws.damping, kicked, damped)
            is_steady, sweeps = resolve_steady(contacts, position, kept.radius, first_kick, last_kick, length)
        if not is_steady:
            copy_state(saved[0], saved[1], saved[2], position, velocity, acceleration)
            copy_contacts(contacts, True)
            break
        book_exchange(laws.damping)
        torques = contacts.torque, contacts.angular_acceleration
        write_torques(0, len(contacts.torque), contacts.buffers.spins, spin, contacts.inertia, length, *torques)
        before, time, dt, limit, average = time, after, length, why, following
        if steps > 0:
            T.impact_energy = remembered(T.impact_energy, 0.0)
        steps += 1
        T.restitution += restitution
        T.friction += friction
        T.stabilisation += stabilisation
        T.last_kick, T.last_dt, T.sweeps = last_kick, length, sweeps
        _book(contacts, totals, step + steps, time)
    return steps, before, time, dt, limit, average


@inline
def _are_finite(position: FloatArray, velocity: FloatArray) -> bool:
    rest = 0.0
    for i in range(len(position)):
        for k in range(3):
            x, v = position[i, k], velocity[i, k]
            rest += (x - x) + (v - v)  # 0, or not a number
    return rest == 0.0


@inline
def _crosses(velocity: FloatArray, box: FloatArray, dt: float) -> bool:
    """Return whether a body crosses a whole box in dt s; single steps refuse many crossings."""
    for i in range(len(velocity)):
        for k in range(3):
            if abs(velocity[i, k]) * dt >= box[k]:
                return True
    return False


@inline
def _book(contacts: SteadyContacts, totals: RecordArray[SteadyTotalsRecord], step: int, time: float) -> None:
    """Add the entries of a step's contacts to the books."""
    T, counts = totals[0], contacts.buffers.counts[0]
    T.restitution += counts.restitution_loss
    T.friction += counts.friction_loss
    T.stabilisation += counts.stabilisation_gain
    touching = int(counts.contacts)
    T.contacts += touching
    if touching > T.most:
        T.most, T.most_step, T.most_time = touching, step, time
    if not counts.deepest <= T.deepest:
        T.deepest, T.deepest_step, T.deepest_time = counts.deepest, step, time
        T.deepest_i, T.deepest_j = int(counts.deepest_i), int(counts.deepest_j)
