"""Sleep: islands at rest on something fixed are not computed until something disturbs them.

A body is slow while |v| ≤ s and |ω| r ≤ 10 s, with s = `contact.sleep.speed`. An island whose bodies have all been slow
for `contact.sleep.after` falls asleep if a contact presses it against something fixed. The velocities of its bodies
become 0, and its contacts keep the forces of the last kick. Forces do not move sleepers, and pairs of sleepers are not
contacts of the solver.

An island wakes as a whole when

- an impact in the drift has moved one of its bodies,
- an awake body comes near it, or
- the acceleration of one of its bodies has changed by more than s / after.

The contacts of a woken island start with their stored forces.

Rejected: single bodies that sleep (bodies resting on them would wake them in the next step).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.physics.contact.constraints import CONTACT, CONTACT_STATE, RECORDED, ends_of
from carom.physics.contact.hooks import NO_ENTRIES, OptionalPart, PresentStep
from carom.physics.contact.islands import join_islands, root_of
from carom.physics.contact.law import IMPULSES, NORMAL
from carom.physics.contact.reactions import supported_acceleration
from carom.physics.contact.snapshot import late_contacts
from carom.physics.contact.solver.prepare import ImpulseCache, begin_contacts, impulses_of
from carom.physics.contact.statistics import NO_CONTACTS, ContactStatistics
from carom.physics.diagnostics.ledger import FRICTION, RESTITUTION, TERMS
from carom.physics.jit.decorators import kernel
from carom.physics.jit.team import SOLO
from carom.physics.vector import square, write
from carom.state.checkpoint import ContactCheckpoint, SleepCheckpoint
from carom.state.frame import CollisionGraph, empty_graph

if TYPE_CHECKING:
    from carom.physics.contact.pipeline import ContactPipeline

# largest surface speed of a slow body, divided by s: nothing brakes a spin about a normal, and it moves no neighbour
SPIN = 10.0
ASLEEP = -1.0  # marks a sleeping body in `_calm`


@dataclass(frozen=True, slots=True)
class SleepingContacts:
    """The contacts of sleepers with each other and with fixed ends; sorted by pair, never modified."""

    pairs: IntArray  # (k, 2)
    force: FloatArray  # (k, 4) N, normal and tangential force
    contacts: Records  # (k,) CONTACT, with the impulses of one second
    states: Records  # (k,) CONTACT_STATE
    normals: FloatArray  # (k, 3)
    statistics: ContactStatistics

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def place(self) -> IntArray:
        """Indices of the contacts' records, (k,)."""
        return np.arange(len(self))

    def graph(self) -> CollisionGraph:
        """Return the contacts that touch or carry a force."""
        colours = np.zeros(len(self), dtype=np.int64)
        records = self.place, self.contacts, self.states, self.normals
        return late_contacts(self.pairs, colours, None, *records)[0].graph

    def records(self, dt: float) -> tuple[IntArray, IntArray, Records, Records, Records]:
        """Return pairs, places, `CONTACT` with the impulses of dt s, `CONTACT_STATE` and `RECORDED`."""
        contacts = self.contacts.copy()
        impulses_of(contacts)[:] = dt * self.force
        return self.pairs, self.place, contacts, self.states, np.zeros(len(self), RECORDED)


_NO_RECORDS = np.empty(0, CONTACT), np.empty(0, CONTACT_STATE), np.empty((0, 3))
NO_SLEEPERS = SleepingContacts(empty_graph().pairs, np.empty((0, 4)), *_NO_RECORDS, NO_CONTACTS)


class Sleepers(OptionalPart):
    """Decides which bodies sleep, and keeps their contacts."""

    needs_every_step = False

    def __init__(self, contacts: ContactPipeline) -> None:
        sleep, bodies, planes = contacts.settings.sleep, contacts.bodies, contacts.world.planes
        assert sleep is not None, "see `carom.plan.step_parts`"
        self._sleep, self._bodies, self._all_contacts = sleep, bodies, contacts
        self._shapes = bodies.position, bodies.radius, contacts.world.box, planes.surface, planes.offset
        self._fixed = bodies.ends.inverse_mass == 0.0
        self._movable = int(np.count_nonzero(~self._fixed[: len(bodies)]))
        self._compile()
        self.forget()

    def _compile(self) -> None:
        """Run every kernel without sleepers, so that the first sleeper does not wait for compilation."""
        self.forget()
        ends, nobody = self._bodies.ends, np.zeros(len(self._bodies), dtype=np.bool_)
        pairs, shape = empty_graph().pairs, (ends.velocity, ends.angular_velocity, ends.inverse_mass)
        _stop(self._calm, *shape[:2])
        self._disturbed(pairs)
        self.have_awake_end(pairs)
        _wake_islands(pairs, ends.inverse_mass, nobody, nobody.copy())
        _kick_energy(nobody, ends.acceleration, ends.inverse_mass, 0.0)
        _put_to_sleep(pairs, np.empty((0, 4)), (*shape, ends.inverse_inertia), np.inf, self._calm, nobody)
        self._fall_asleep(pairs, ImpulseCache.empty(), 0.0)
        self._keep(pairs, np.empty((0, 4)))
        self.contacts.graph()

    def forget(self) -> None:
        """Wake all bodies, as before the first step."""
        n = len(self._bodies)
        self._calm = np.zeros(n)  # s, time for which each body has been slow, or `ASLEEP`
        self._still = self._fixed.copy()  # (n + p,) whether an end is fixed or asleep
        self._reference = np.zeros((n, 3))  # m/s², accelerations of the sleepers when they fell asleep
        self._count = 0  # number of sleepers
        self.contacts = NO_SLEEPERS
        self._fell_asleep = False  # whether any contact fell asleep at the end of the last step
        self._slept = NO_SLEEPERS  # contacts that slept in the last step
        self._first_kick = 0.0  # s, length of the first kick of the step
        self._lost = NO_ENTRIES  # J, losses of the contacts that woke in this step or fell asleep after it

    def is_busy(self) -> bool:
        """Whether a body sleeps."""
        return self._count > 0

    @property
    def _all_sleep(self) -> bool:
        """Whether every body sleeps or is fixed."""
        return self._count == self._movable

    def remember(self, memory: ContactCheckpoint) -> ContactCheckpoint:
        """Leave the contacts of sleepers out of a checkpoint, and add the state that the next step needs."""
        awake, held = self.have_awake_end(memory.pairs), self.have_awake_end(memory.held_pairs)
        slept = SleepCheckpoint(self._calm.copy(), self._reference.copy(), self.contacts.pairs, self.contacts.force)
        return replace(memory.among(awake, held), sleep=slept)

    def recall(self, memory: ContactCheckpoint) -> None:
        """Restore the state of a checkpoint; the bodies must already be at their positions of that step."""
        self.forget()
        if memory.sleep is not None:
            self._calm, self._reference = memory.sleep.calm.copy(), memory.sleep.reference.copy()
            self._count_sleepers()
            self._keep(memory.sleep.pairs, memory.sleep.force)
        self._leave_out()

    def support(self, by_solver: FloatArray) -> FloatArray:
        """Add the accelerations that the contacts of sleepers support."""
        if not self._count or self._fell_asleep:
            return by_solver
        slept = self.contacts
        cache = ImpulseCache(slept.pairs, slept.place, slept.contacts, 1.0)
        by_sleepers = supported_acceleration(cache, self._bodies.ends.inverse_mass)
        return by_sleepers + by_solver if len(by_solver) else by_sleepers

    def losses(self) -> FloatArray:
        """Return the energies of contacts that woke or fell asleep in the last step, (k, 3) J, by term."""
        return self._lost

    def kicked(self, step: PresentStep) -> None:
        """Set the velocities of the sleepers to 0 after a kick."""
        if self._count:
            ends = self._bodies.ends
            _stop(self._calm, ends.velocity, ends.angular_velocity)

    def prepare(self, step: PresentStep) -> None:
        """Begin a step without the contacts that fell asleep after the last step."""
        contacts, self._lost, self._first_kick = self._all_contacts, NO_ENTRIES, step.kick
        if self._fell_asleep:
            memory = contacts.memory
            assert memory is not None, "only lasting contacts fall asleep"
            contacts.lay_out(memory)
            self._fell_asleep = False
            self._leave_out()
        contacts.unmoved = np.asarray(self._calm == ASLEEP)

    def search(self, step: PresentStep, others: Callable[[PresentStep], IntArray]) -> IntArray:
        """Wake the islands that are disturbed; return the pairs with an awake end."""
        if self._all_sleep and not self.is_disturbed():
            return empty_graph().pairs
        pairs, contacts = others(step), self._all_contacts
        impulses, self._lost = self._wake(pairs, contacts.impulses, self._first_kick, step.dt)
        if len(self._lost):
            contacts.restart(impulses)
        self._leave_out()
        return pairs[self.have_awake_end(pairs)] if self._count else pairs

    def conclude(self, step: PresentStep) -> None:
        """Count the contacts of sleepers."""
        if self._slept:
            self._all_contacts.statistics = self._all_contacts.statistics.plus(self._slept.statistics)

    def end(self, step: PresentStep) -> None:
        """Put to sleep the islands that have been slow for long enough."""
        contacts = self._all_contacts
        lost = self._fall_asleep(contacts.contacts.pairs, contacts.impulses, step.dt)
        self._fell_asleep = len(lost) > 0
        self._lost = np.concatenate((self._lost, lost))
        if len(self._lost):
            contacts.ledger_apart = np.concatenate((contacts.ledger_apart, self._lost))
        step.profile.mark("sleep")

    def _leave_out(self) -> None:
        """Let this part, not the solver, keep the present contacts of sleepers during this step."""
        self._slept = self._all_contacts.idle = self.contacts

    def have_awake_end(self, pairs: IntArray) -> BoolArray:
        """Return which pairs have an end that is neither fixed nor asleep."""
        return _has_awake_end(pairs, self._still)

    def is_disturbed(self) -> bool:
        """Return whether a sleeper moves, or its acceleration has changed since it fell asleep."""
        return self._count > 0 and bool(self._disturbed(empty_graph().pairs).any())

    def _wake(self, pairs: IntArray, cache: ImpulseCache, kick: float, dt: float) -> tuple[ImpulseCache, FloatArray]:
        """Wake the islands that are disturbed, or near awake bodies, given all near pairs.

        The first kick and the step take ``kick`` and ``dt`` s. Return the impulses with which the next kick starts,
        from ``cache`` and from the woken contacts, and the energies -½ m (a h)² that contacts removed after the first
        kick, (k, 3) J, by term. For bodies at rest, the energy audit books the same energy after the first kick, and
        the opposite after the last kick.
        """
        disturbed = self._disturbed(pairs) if self._count else np.zeros(0, dtype=np.bool_)
        if not disturbed.any():
            return cache, NO_ENTRIES
        ends, slept, n = self._bodies.ends, self.contacts, len(self._bodies)
        woken = np.zeros(n, dtype=np.bool_)
        _wake_islands(slept.pairs, ends.inverse_mass, disturbed, woken)
        self._calm[woken] = 0.0
        self._count_sleepers()
        awake = self.have_awake_end(slept.pairs)
        self._keep(slept.pairs[~awake], slept.force[~awake])
        length = cache.kick if cache.kick > 0.0 else dt
        joined = np.concatenate((cache.pairs, slept.pairs[awake]))
        given = cache.impulse
        impulse = np.zeros((len(joined), given.shape[1]))  # the impulse of rolling resistance starts at 0
        impulse[: len(given)], impulse[len(given) :, : len(IMPULSES)] = given, length * slept.force[awake]
        order = np.lexsort((joined[:, 1], joined[:, 0]))
        lost = np.zeros((1, len(TERMS)))
        lost[0, RESTITUTION] = -_kick_energy(woken, ends.acceleration, ends.inverse_mass, kick)
        return ImpulseCache.of(joined[order], impulse[order], length), lost

    def _fall_asleep(self, pairs: IntArray, cache: ImpulseCache, dt: float) -> FloatArray:
        """Put islands to sleep after a step of dt s; return the energy that they lose, (k, 3) J, by term.

        Nothing falls asleep unless the impulses of the last kick, in ``cache``, belong to ``pairs``, which are the
        step's contacts and near contacts.
        """
        bodies, ends = self._bodies, self._bodies.ends
        motion = (ends.velocity, ends.angular_velocity, bodies.radius, ends.inverse_mass)
        is_due = _count_calm(*motion, self._sleep.speed, dt, self._sleep.after, self._calm)
        if not is_due or cache.kick == 0.0 or not np.array_equal(cache.pairs, pairs):
            return NO_ENTRIES
        impulse = cache.impulse[:, : len(IMPULSES)]
        slept = np.zeros(len(self._calm), dtype=np.bool_)
        moving = ends.velocity, ends.angular_velocity, ends.inverse_mass, ends.inverse_inertia
        energy = _put_to_sleep(pairs, impulse, moving, self._sleep.after, self._calm, slept)
        if not slept.any():
            return NO_ENTRIES
        self._reference[slept] = ends.acceleration[: len(slept)][slept]
        self._count_sleepers()
        _stop(self._calm, ends.velocity, ends.angular_velocity)
        kept = ~_has_awake_end(pairs, self._still)
        joined = np.concatenate((self.contacts.pairs, pairs[kept]))
        force = np.concatenate((self.contacts.force, impulse[kept] / cache.kick))
        order = np.lexsort((joined[:, 1], joined[:, 0]))
        self._keep(joined[order], force[order])
        lost = np.zeros((1, len(TERMS)))
        lost[0, FRICTION] = energy
        return lost

    def _disturbed(self, pairs: IntArray) -> BoolArray:
        """Return which sleepers are disturbed, (n,)."""
        ends, limit = self._bodies.ends, self._sleep.speed / self._sleep.after
        disturbed = np.zeros(len(self._calm), dtype=np.bool_)
        _mark_disturbed(
            pairs, self._still, self._calm, ends.velocity, ends.acceleration, self._reference, limit, disturbed
        )
        return disturbed

    def _count_sleepers(self) -> None:
        asleep = self._calm == ASLEEP
        self._still = self._fixed.copy()
        self._still[: len(asleep)] |= asleep
        self._count = int(np.count_nonzero(asleep))

    def _keep(self, pairs: IntArray, force: FloatArray) -> None:
        """Keep the contacts of the sleepers."""
        k = len(pairs)
        contacts, states, normals = np.zeros(k, CONTACT), np.zeros(k, CONTACT_STATE), np.empty((k, 3))
        begin_contacts(0, k, pairs, self._shapes, contacts, states, 0.0, normals)
        impulses_of(contacts)[:] = force
        statistics = ContactStatistics.of(pairs, contacts, states, self._bodies.ends, SOLO)._replace(work=NO_ENTRIES)
        self.contacts = SleepingContacts(pairs, force, contacts, states, normals, statistics)


@kernel
def _stop(calm: FloatArray, velocity: FloatArray, spin: FloatArray) -> None:
    """Set the velocities of the sleepers to 0."""
    for i in range(len(calm)):
        if calm[i] < 0.0:
            write(velocity, i, 0.0, 0.0, 0.0)
            if len(spin):
                write(spin, i, 0.0, 0.0, 0.0)


@kernel
def _has_awake_end(pairs: IntArray, still: BoolArray) -> BoolArray:
    """Return which pairs have an end that is neither fixed nor asleep."""
    awake = np.empty(len(pairs), dtype=np.bool_)
    for c in range(len(pairs)):
        awake[c] = not (still[pairs[c, 0]] and still[pairs[c, 1]])
    return awake


@kernel
def _mark_disturbed(
    pairs: IntArray,
    still: BoolArray,
    calm: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    reference: FloatArray,
    limit: float,
    disturbed: BoolArray,
) -> None:
    """Mark sleepers that move, whose acceleration has changed by more than a limit, or that are near an awake body."""
    n = len(calm)
    for i in range(n):
        if calm[i] < 0.0:
            moves, change = False, 0.0
            for k in range(3):
                moves = moves or velocity[i, k] != 0.0
                da = acceleration[i, k] - reference[i, k]
                change += da * da
            disturbed[i] = moves or change > limit * limit
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        if still[i] != still[j]:
            sleeper = i if still[i] else j
            if sleeper < n and calm[sleeper] < 0.0:
                disturbed[sleeper] = True


@kernel
def _wake_islands(pairs: IntArray, inverse_mass: FloatArray, disturbed: BoolArray, woken: BoolArray) -> None:
    """Mark all bodies of islands that contain a disturbed body."""
    n = len(disturbed)
    parent = np.arange(n)
    join_islands(pairs, inverse_mass, parent)
    for i in range(n):
        if disturbed[i]:
            woken[root_of(parent, i)] = True
    for i in range(n):
        if woken[root_of(parent, i)]:
            woken[i] = True


@kernel
def _kick_energy(woken: BoolArray, acceleration: FloatArray, inverse_mass: FloatArray, kick: float) -> float:
    """Return Σ ½ m (a h)² of the woken bodies, in J."""
    energy = 0.0
    for i in range(len(woken)):
        if woken[i]:
            energy += 0.5 * kick * kick * square(acceleration, i) / inverse_mass[i]
    return energy


@kernel
def _count_calm(
    velocity: FloatArray,
    spin: FloatArray,
    radius: FloatArray,
    inverse_mass: FloatArray,
    speed: float,
    dt: float,
    after: float,
    calm: FloatArray,
) -> bool:
    """Add dt to the times for which bodies have been slow; return whether a body may fall asleep."""
    is_due = False
    for i in range(len(calm)):
        if calm[i] < 0.0 or inverse_mass[i] == 0.0:
            continue
        v2 = square(velocity, i)
        w2 = square(spin, i) if len(spin) else 0.0
        slow = v2 <= speed * speed and w2 * radius[i] * radius[i] <= SPIN * SPIN * speed * speed
        calm[i] = calm[i] + dt if slow else 0.0
        is_due = is_due or calm[i] >= after
    return is_due


@kernel
def _put_to_sleep(
    pairs: IntArray,
    impulse: FloatArray,
    ends: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    after: float,
    calm: FloatArray,
    slept: BoolArray,
) -> float:
    """Mark the bodies of islands that fall asleep, also in ``calm``; return their kinetic energy in J."""
    velocity, spin, inverse_mass, inverse_inertia = ends
    n = len(calm)
    parent, restless, pressed = np.arange(n), np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    join_islands(pairs, inverse_mass, parent)
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        if impulse[c, NORMAL] > 0.0 and (inverse_mass[i] == 0.0 or inverse_mass[j] == 0.0):
            pressed[root_of(parent, i if inverse_mass[i] > 0.0 else j)] = True
    for i in range(n):
        if inverse_mass[i] > 0.0 and calm[i] < after:
            restless[root_of(parent, i)] = True
    energy = 0.0
    for i in range(n):
        island = root_of(parent, i)
        if inverse_mass[i] == 0.0 or calm[i] < 0.0 or restless[island] or not pressed[island]:
            continue
        slept[i], calm[i] = True, ASLEEP
        energy += 0.5 * square(velocity, i) / inverse_mass[i]
        if len(spin) and inverse_inertia[i] > 0.0:
            energy += 0.5 * square(spin, i) / inverse_inertia[i]
    return energy


def make(contacts: ContactPipeline) -> Sleepers | None:
    """Return the sleepers of a scene with `contact.sleep`; None if its contacts do not last."""
    return Sleepers(contacts) if contacts.lasts else None
