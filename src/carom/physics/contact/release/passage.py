"""Passing bodies: they wait outside of the physics, enter at their places, and leave through outlets.

A waiting body has no mass: it has no energy, no force moves it, and nothing can push it. It is kept beside the scene,
and its pairs with other bodies are not contacts. Bodies enter and leave as a step begins:

- a body whose centre is in an outlet leaves, and its contacts end; then it waits, or stays outside for good
- an adaptive step ends when a body is due, so that it enters at its time; equal steps let it enter as the next begins
- it enters at its place, with the velocity and the spin of the scene, if no sphere and no moving wall overlaps it there
- in a group with a rate, one body enters at each multiple of 1/rate; others pass a body whose place is taken, and a
  body that could not enter in time enters as soon as there is room
- bodies are tried in the order in which they began to wait

The ledger books the kinetic and potential energies of bodies that enter and leave.

Rejected: arrays that grow and shrink, because each buffer, checkpoint and drawing has a row for each body.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carom.arrays import FloatArray, IntArray
from carom.errors import PhysicsError
from carom.physics.contact.hooks import LedgerAccount, OptionalPart, PresentStep, WorldForces
from carom.physics.contact.near_pairs import are_present
from carom.physics.contact.release.inlets import Inlets
from carom.physics.contact.release.outlets import find_leaving, outlets_of
from carom.physics.contact.release.waiting_places import choose, waiting_places
from carom.state.checkpoint import GONE, PRESENT, ContactCheckpoint, ReleaseCheckpoint

if TYPE_CHECKING:
    from carom.physics.contact.pipeline import ContactPipeline

ENTRY = "passage"  # name of the ledger entry
PATIENCE = 0.05  # fraction of the run's duration for which a place may be taken before a warning
# largest displacement of a body in the step in which it enters, in radii; the same value as `auto.LATE_CFL`
LARGEST_MOVE = 0.5


class PassingBodies(OptionalPart):
    """Lets bodies enter and leave the physics."""

    entries = (ENTRY,)

    def __init__(self, contacts: ContactPipeline) -> None:
        scene, bodies, ends = contacts.scene, contacts.bodies, contacts.bodies.ends
        self._contacts, self._bodies, self._ends = contacts, bodies, ends
        self._solids, self._box = contacts.world.planes, contacts.world.box
        self._forces: WorldForces | None = None
        self._inlets = Inlets(scene, len(bodies))
        self._patience = PATIENCE * scene.time.duration
        # the state of each body as it enters
        self._place, self._velocity = bodies.position.copy(), bodies.velocity.copy()
        self._spin, self._mass = bodies.angular_velocity.copy(), bodies.mass.copy()
        n = len(bodies)
        self._inverse_mass, self._inverse_inertia = ends.inverse_mass[:n].copy(), ends.inverse_inertia[:n].copy()
        self._outside = waiting_places(self._place, bodies.radius, scene.domain, self._solids)
        self._largest = float(bodies.radius.max())
        contacts.near.has_statics = True  # pairs of bodies that cannot move are left out
        self._outlets, self._through = outlets_of(scene), np.empty(n, dtype=np.int64)
        self._comes_back = np.array([outlet.to == "inlet" for outlet in scene.outlet], dtype=np.bool_)
        # number and mass (kg) of the bodies that left through each outlet since the start
        self._totals = np.zeros((len(scene.outlet), 2))
        self._time = 0.0  # s, time at which the step began
        self._exchanged: list[tuple[float, FloatArray, FloatArray]] = []  # J, N s and N m s of bodies that entered
        self._restore(self._at_start)
        self._place_outside(np.flatnonzero(self._waits))

    def join(self, forces: WorldForces) -> None:
        """Note the forces of the world."""
        self._forces = forces
        forces.find_fixed()

    def compile(self) -> None:
        """Load the kernels."""
        self._free(np.empty(0, dtype=np.int64), np.zeros(len(self._inlets), dtype=np.int64))
        if len(self._outlets):
            find_leaving(self._bodies.position, np.ones_like(self._waits), self._outlets, self._through)
        are_present(np.empty((0, 2), dtype=np.int64), self._waits)

    def forget(self) -> None:
        """Return to the state before the first step; positions and velocities are restored by the caller."""
        self._restore(self._at_start)

    def remember(self, memory: ContactCheckpoint) -> ContactCheckpoint:
        """Add the waiting bodies, the taken slots, and the totals of bodies that have left."""
        state = self._since, self._inlets.slots, self._totals
        return replace(memory, release=ReleaseCheckpoint(*(array.copy() for array in state)))

    def recall(self, memory: ContactCheckpoint) -> None:
        """Return to the state of a checkpoint; positions and velocities must already be restored."""
        state, own = memory.release, self._at_start
        if state is None or (state.slots.shape, state.totals.shape) != (own.slots.shape, own.totals.shape):
            raise PhysicsError("the checkpoint does not state how the bodies of the scene enter and leave")
        self._restore(state)

    def discard(self) -> None:
        """Discard the exchanges that are not booked yet."""
        self._exchanged.clear()

    def latest_end(self, time: float, adaptive: bool) -> float:
        """Return when the next body is due, or when a body that enters now has moved by half a radius, if sooner."""
        if not adaptive or not self._count:
            return np.inf
        due, end = self._due(time), self._inlets.next_due(time, self._waiting)
        if len(due):
            speed = np.sqrt((self._velocity[due] * self._velocity[due]).sum(axis=1))
            fast = speed > 0.0
            longest = LARGEST_MOVE * self._bodies.radius[due][fast] / speed[fast]
            end = min(end, time + float(longest.min(initial=np.inf)))
        return end

    def begin(self, step: int, began: float, ended: float) -> None:
        """Let due bodies enter, where there is room."""
        self._time = began
        if len(self._outlets):
            stays = self._waits | (self._inverse_mass == 0.0)
            if find_leaving(self._bodies.position, stays, self._outlets, self._through):
                self._leave(np.flatnonzero(self._through >= 0))
        if not self._count:
            return
        for inlet in self._inlets.closed(began, self._waiting).tolist():
            self._set_since(np.flatnonzero((self._inlets.of_body == inlet) & (self._since >= 0.0)), GONE)
        due = self._due(began)
        if len(due):
            entering = self._free(due, self._inlets.room(began, self._waiting))
            if len(entering):
                self._enter(entering)

    def search(self, step: PresentStep, others: Callable[[PresentStep], IntArray]) -> IntArray:
        """Leave out the pairs of waiting bodies."""
        pairs = others(step)
        if self._are_outside:
            step.profile.mark("search")
            pairs = pairs[are_present(pairs, self._waits)]
            step.profile.mark("release")
        return pairs

    def book(self, account: LedgerAccount) -> None:
        """Book the energies and momenta of the bodies that entered or left as the step began."""
        for energy, impulse, angular_impulse in self._exchanged:
            account.exchange(ENTRY, -energy, impulse, angular_impulse)
        self._exchanged.clear()

    def warnings(self) -> Iterable[str]:
        """Return a warning for each inlet at which a body has been due for long."""
        if self._count:
            yield from self._inlets.blocked(self._time, self._since, self._waiting, self._patience)

    @property
    def _at_start(self) -> ReleaseCheckpoint:
        return ReleaseCheckpoint(self._inlets.begun, self._inlets.first_slots, np.zeros_like(self._totals))

    def _due(self, time: float) -> NDArray[np.intp]:
        """Return the bodies that may enter at a time (s), in the order in which they began to wait."""
        open_ = self._inlets.room(time, self._waiting) > 0
        if not open_.any():
            return np.empty(0, dtype=np.intp)
        due = np.flatnonzero((self._since >= 0.0) & open_[self._inlets.of_body])
        return due[np.lexsort((due, self._since[due]))]

    def _free(self, due: NDArray[np.intp], room: IntArray) -> IntArray:
        """Return the bodies that enter, given the due bodies and how many may enter at each inlet."""
        if self._solids.moves and len(due):
            due = due[(self._solids.heights(self._place[due]) >= self._bodies.radius[due][:, None]).all(axis=1)]
        bodies = self._bodies.position, self._bodies.radius, self._waits
        return np.asarray(choose(due, self._inlets.of_body, room, self._place, bodies, self._box, self._largest))

    def _enter(self, which: IntArray) -> None:
        """Give bodies their places, their mass, and the acceleration with which the step begins."""
        assert self._forces is not None, "the world must join its forces to this part first"
        bodies, before = self._bodies, sum(self._forces.potentials().values())
        bodies.position[which], bodies.velocity[which] = self._place[which], self._velocity[which]
        for name in ("orientation", "angular_velocity"):
            state = getattr(bodies, name)
            if len(state):
                state[which] = (0.0, 0.0, 0.0, 1.0) if name == "orientation" else self._spin[which]
        self._inlets.take(self._inlets.of_body[which])
        self._set_since(which, PRESENT)
        self._forces.find_fixed()
        potential = sum(self._forces.accelerate(potential=True).values()) - before
        self._exchanged.append(self._motion_of(which, potential))

    def _leave(self, which: NDArray[np.intp]) -> None:
        """Remove bodies and their contacts from the physics."""
        assert self._forces is not None, "the world must join its forces to this part first"
        before, through = sum(self._forces.potentials().values()), self._through[which]
        motion = self._motion_of(which, 0.0)
        for column, amounts in enumerate((np.ones(len(which)), self._mass[which])):
            np.add.at(self._totals[:, column], through, amounts)
        back = self._comes_back[through]
        self._inlets.begin_again(self._inlets.of_body[which[back]], self._time, self._waiting)
        self._since[which] = np.where(back, self._time, GONE)
        self._place_outside(which)
        self._weigh()
        self._forces.accelerate(potential=False)
        energy = motion[0] + before - sum(self._forces.potentials().values())
        self._exchanged.append((-energy, -motion[1], -motion[2]))
        memory = self._contacts.memory
        if memory is not None:
            kept, held = (are_present(pairs, self._waits) for pairs in (memory.pairs, memory.held_pairs))
            self._contacts.lay_out(memory.among(kept, held))

    def _motion_of(self, which: IntArray, potential: float) -> tuple[float, FloatArray, FloatArray]:
        """Return the energy (J), the momentum and the angular momentum (N s and N m s) of some bodies."""
        bodies, mass = self._bodies, self._mass[which][:, None]
        x, v = bodies.position[which], bodies.velocity[which]
        angular, kinetic = np.cross(x, mass * v), 0.5 * mass * v * v
        if len(bodies.angular_velocity):
            spin, inertia = bodies.angular_velocity[which], bodies.inertia[which][:, None]
            angular, kinetic = angular + inertia * spin, kinetic + 0.5 * inertia * spin * spin
        return potential + float(kinetic.sum()), (mass * v).sum(axis=0), angular.sum(axis=0)

    def _place_outside(self, which: IntArray) -> None:
        """Move bodies to their waiting places."""
        bodies = self._bodies
        bodies.position[which] = self._outside[which]
        for state in (bodies.velocity, bodies.angular_velocity):
            if len(state):
                state[which] = 0.0

    def _restore(self, state: ReleaseCheckpoint) -> None:
        """Set which bodies wait and which slots are taken; the time of the next step is not known."""
        self._exchanged.clear()
        self._inlets.slots[:], self._totals[:] = state.slots, state.totals
        self._since = state.since.copy()
        self._weigh()

    def _set_since(self, which: IntArray, since: float) -> None:
        """Set the time since which bodies wait, or that they no longer wait."""
        self._since[which] = since
        self._weigh()

    def _weigh(self) -> None:
        """Give present bodies their mass, and the others no mass."""
        n, waits = len(self._bodies), self._since != PRESENT
        self._waits, self._are_outside = waits, bool(waits.any())
        self._contacts.absent = waits
        self._waiting = np.bincount(self._inlets.of_body[self._since >= 0.0], minlength=len(self._inlets))
        self._count = int(self._waiting.sum())  # number of bodies that may still enter
        self._bodies.mass[:] = np.where(waits, 0.0, self._mass)
        self._ends.inverse_mass[:n] = np.where(waits, 0.0, self._inverse_mass)
        self._ends.inverse_inertia[:n] = np.where(waits, 0.0, self._inverse_inertia)
        if self._forces is not None:
            self._forces.find_fixed()
