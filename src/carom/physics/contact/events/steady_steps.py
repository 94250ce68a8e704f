"""Many steps of few bodies in contact, by the kernel of `carom.physics.few_bodies`.

`KickDriftStepper` leaves the steps before the next frame or check to this module, as long as the same contacts last.
`KickDriftStepper` itself makes the last of these steps, since Python needs its contacts for the frame or check.

The kernel keeps the ledger, the numbers of contacts and the deepest overlap as single steps would, and adds them up in
the same order. `steady_contacts` lists the steps that Python must process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from carom.physics.contact.contact_tap import ContactTap
from carom.physics.contact.events.drift import EventDrivenDrift
from carom.physics.contact.events.steady_contacts import MOST_CONTACTS
from carom.physics.contact.events.steady_data import SteadyContacts
from carom.physics.contact.graph import OrderedContacts
from carom.physics.contact.plane_guard import PlaneGuard
from carom.physics.contact.solver.phase_code import IMPACTS, POSITIONS, RESTING
from carom.physics.diagnostics.bookkeeper import Bookkeeper
from carom.physics.few_bodies import MOST_STEPS, FewBodies, FlightClock, take_steps
from carom.physics.jit.decorators import compiles_all, entry_if_worthwhile
from carom.physics.jit.inside import PLAIN
from carom.physics.open_gaps import TOTALS
from carom.physics.schedule import Goal
from carom.physics.step_rule import LIMIT_NAMES
from carom.physics.time_step import Timestep
from carom.physics.world import World
from carom.plan.auto import integrator

PATIENCE = 256  # number of single steps between two decisions whether to load or compile the kernel
LONGEST_PAUSE = 16  # limit on single steps between calls of the kernel, if each call stops at a step for Python


class SteadySteps:
    """Makes steps of a world in which the same contacts last, with the laws and the state of a `FewBodies`."""

    def __init__(self, world: World, books: Bookkeeper, timestep: Timestep, flight: FewBodies) -> None:
        assert world.contact is not None, "see `make`"
        contact = world.contact
        self._world, self._books, self._timestep, self._contact = world, books, timestep, contact
        laws, moved, kept, buffers = flight.arguments
        self._supported = np.empty(len(world.bodies.ends.radius) if timestep.spares_held else 0)
        self._arguments = laws, moved, kept._replace(supported=self._supported), buffers
        self._totals = np.zeros(1, TOTALS)
        self._jobs = (IMPACTS, POSITIONS) if contact.settings.stabilisation == "split" else (IMPACTS,)
        self._last: OrderedContacts | None = None  # contacts of the last examined step
        self._go_on: Callable[..., tuple[Any, ...]] | None = None  # the kernel; None until it is worthwhile
        self._first: float = np.inf  # number of the first examined step
        # number of single steps before the next call; and before the call after it, if the next call makes no step
        self._pause, self._next_pause = 0, 1
        self._waited = 0  # single steps that the kernel could have made
        self._next_decision = PATIENCE  # value of `_waited` at which to decide again whether the kernel is worthwhile

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
        jobs = (*self._jobs, RESTING) if contact.is_at_rest else self._jobs
        if most < 1 or len(contact.contacts) > MOST_CONTACTS or not contact.solver.code.is_ready(jobs):
            return False
        totals = self._totals
        contacts = SteadyContacts.of(contact, world.bodies, world.step.against, self._supported)
        for name, value in books.steady_totals().items():
            totals[name] = value
        totals["deepest_step"] = totals["most_step"] = totals["contacts"] = 0
        totals["last_kick"], totals["last_dt"] = contact.last_kick, clock.dt
        until, timestep = min(until, books.kept_until), self._timestep
        for lend in world.hooks.lend:
            lend(books.audit)
        asked = FlightClock(clock.time, goal.end, until, most, timestep.previous, clock.step, True)
        if self._go_on is None:
            share = self._waited / (clock.step - self._first + 1) * most / (most + 1)
            coming = (goal.end - clock.time) / clock.dt * share
            self._next_decision = self._waited + PATIENCE
            self._go_on = entry_if_worthwhile(take_steps, coming, asked, *self._arguments, contacts, totals)
        if self._go_on is None:
            return False
        taken, before, time, dt, limit, timestep.previous = self._go_on(asked, *self._arguments, contacts, totals)
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


def make(world: World, books: Bookkeeper, timestep: Timestep, flight: FewBodies) -> SteadySteps | None:
    """Return a `SteadySteps`; None if the scene has features that its kernel does not support."""
    contact, substeps = world.contact, integrator(world.scene).substeps
    if PLAIN or contact is None or contact.part(EventDrivenDrift) is None or len(substeps) > 1:
        return None
    known = EventDrivenDrift, PlaneGuard, ContactTap, type(world.forces.damping)  # parts that the kernel replaces
    if not all(isinstance(part, known) for part in contact.parts):
        return None
    settings, is_held_twice = contact.settings, min(substeps[0]) > 0.0
    is_known = settings.stabilisation != "baumgarte" and settings.search != "k-d-tree"  # "baumgarte" rounds differently
    return SteadySteps(world, books, timestep, flight) if is_held_twice and is_known else None
