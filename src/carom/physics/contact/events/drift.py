"""The drift of a step whose impacts are resolved at their exact times.

Neighbours are searched once per drift, within a search radius around the initial position of each body. A body that
leaves its search radius after an impact is a stray: from then on, its impacts with all other bodies are predicted.

Rejected: search radii that no impact can exceed. One fast body would make all bodies neighbours.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray, Records
from carom.physics.contact.broad_phase.grid import HierarchicalGrid
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.events.collision import collide
from carom.physics.contact.events.event_loop import (
    MAX_ELASTIC,
    SLOW,
    SLOW_IN_SPACE,
    predict,
    resolve,
)
from carom.physics.contact.events.event_queue import put
from carom.physics.contact.events.held_group import hold_group
from carom.physics.contact.events.nearest_velocities import MOST_CONTACTS, Group, empty_group
from carom.physics.contact.events.supports import correct_impulses, mark_supported
from carom.physics.contact.events.time_of_impact import step_by_impacts
from carom.physics.contact.events.trajectories import (
    DRIFT,
    MOST_HOLDS,
    SUPPORT,
    TRAJECTORY,
    Neighbours,
    Trajectories,
    arrive,
    begin,
    both_ways,
    finish,
    narrow,
    straighten,
    write_search_radii,
)
from carom.physics.contact.hooks import NO_ENTRIES, Mover, PresentStep
from carom.physics.contact.impact_log import IMPACT, MAX_IN_COLLAPSE, NO_IMPACTS, ROLLING_IMPACT, ROUNDING, Impacts
from carom.physics.contact.islands import island_load_speeds
from carom.physics.contact.law import dissipates, has_torque, material_index
from carom.physics.contact.near_pairs import are_present
from carom.physics.contact.records import ImpactRecord
from carom.physics.contact.solver.prepare import ImpulseCache
from carom.physics.integrators.kick_drift import MIN_BODIES_PER_TASK, advance
from carom.physics.jit.decorators import entry_of, inline, kernel, long_kernel
from carom.physics.vector import between, vector

if TYPE_CHECKING:
    from carom.physics.contact.pipeline import ContactPipeline

LOG_ROWS = 4096  # largest number of impacts in one call
MOST_TOUCHING = 16  # largest mean number of contacts per body at one moment
SINGLE_ROWS = 4  # in the log of touching bodies, one row in this many is for single impacts, the others for groups
GAP_ROUNDING = 16 * 2.0**-53  # relative rounding of the coordinates and of the sum of radii
WIDEST = 2.0  # factor on the radii up to which the search for contacts also finds neighbours
# Range of the largest search radius, in body radii, in which `narrow` is used: below it, narrowing would save no time;
# above it, squares would not be finite.
NARROWED = 0.25, 1e100


class EventDrivenDrift(Mover):
    """Moves bodies through a drift and resolves their impacts."""

    needs_every_step = False

    def __init__(self, contacts: ContactPipeline) -> None:
        world, bodies, near, solver = contacts.world, contacts.bodies, contacts.near, contacts.solver
        planes, materials, shear = world.planes, world.materials, world.shear
        n, ends = len(bodies), bodies.ends
        spin = slice(None) if contacts.needs.friction.modelled else slice(0)  # whether impulses change spins
        self._contacts, self._bodies, self.anchored = contacts, bodies, near.has_statics
        self._forces = contacts.needs.resting.modelled  # whether a force presses contacts together
        self._search, self._team, self._box, self._shear = near.search, contacts.team, world.box, shear
        self._fixed = ends.inverse_mass[:n] == 0.0
        self.pressing = solver.pressing  # (n + p, 3) m/s², accelerations that press contacts together
        self.field, self.bending = world.field, world.bending
        self._supports = contacts.lasts and shear is None and self.anchored
        self._group = empty_group()  # workspace of held contacts
        self._losses = NO_ENTRIES  # (k, 3) J, losses by supports of the bodies that were hit in the last drift
        self._absent: BoolArray | None = None  # (n,) absent bodies, which `trajectories.everyone` lacks
        self._is_open = not (shear or world.box.any())  # no axis is periodic
        # log of the impacts in a call; the log grows with the number of impacts in a step
        self.log = np.empty(LOG_ROWS, dtype=ROLLING_IMPACT if has_torque(materials.rows.dtype) else IMPACT)
        zeros = np.zeros(n, dtype=np.int64)
        self.trajectories = Trajectories(
            body=np.zeros(n, dtype=TRAJECTORY),
            drift=np.zeros(1, dtype=DRIFT),
            x=bodies.position,
            v=ends.velocity,
            a=ends.acceleration,
            q=bodies.orientation[spin],
            omega=ends.angular_velocity[spin],
            inverse_mass=ends.inverse_mass,
            inverse_inertia=ends.inverse_inertia,
            radius=ends.radius,
            load_speed=np.zeros(len(ends.radius)),
            loads=solver.loads,
            support=np.zeros(n, dtype=SUPPORT),
            box=shear.at(0.0) if shear else world.box,
            surface=planes.surface,
            offset=planes.offset,
            materials=materials.rows,
            places=materials.places,
            queue=np.empty(n, dtype=np.int64),
            everyone=Neighbours(zeros, np.full(n, n), np.arange(n)),
            strays=Neighbours(zeros, np.zeros(n, dtype=np.int64), np.empty(n, dtype=np.int64)),
        )
        drift = self.trajectories.drift
        drift["slow"] = SLOW if self.anchored else SLOW_IN_SPACE
        drift["field_x"], drift["field_y"], drift["field_z"] = self.bending
        self._compile()

    def compile(self) -> None:
        """Run the kernels of the hooks without contacts."""
        self._contacts.impacts = Impacts(self.log[:0])
        self._count_impacts()

    def _compile(self) -> None:
        """Run every kernel of a drift without impacts, so that the first impact does not wait for compilation."""
        T, nobody, nothing = self.trajectories, np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64)
        alone, pressed = Neighbours(nothing, nothing, nothing), np.ones(len(T.load_speed), dtype=np.bool_)
        self._begin = entry_of(begin, T, 1.0, 0.0, 0.0, False, pressed)
        self._predict = entry_of(predict, 0, 0, alone, T)
        self._fill_queue = entry_of(_fill_queue, T)
        self._resolve_most = entry_of(resolve, alone, T, self.log, None)
        self._finish = entry_of(finish, 0, 0, T)
        self._begin(T, 1.0, 0.0, 0.0, False, pressed)
        self._straighten(ImpulseCache.empty(), None)
        if self._supports:
            nothing_held = nobody, nothing, ImpulseCache.empty().contacts
            mark_supported(*nothing_held, 1.0, T)
            correct_impulses(*nothing_held, 1.0, T)
        if self._forces:
            self._write_load_speeds(nobody, 1.0, 1.0, 0.0)
        if self._is_open:
            narrow(nobody, 1.0, 0.0, T, nobody)
        self._resolve(nobody, T)

    def warnings(self) -> Iterable[str]:
        """Return a warning if a body reached its limit of impacts in the last drift."""
        if self.trajectories.drift["exhausted"][0]:
            yield (
                "A body had so many impacts in one step that its last ones were resolved together, and without a "
                "rebound where energy is lost; shorter steps (time.fixed_dt, time.cfl) resolve more of them."
            )

    def prepare(self, step: PresentStep) -> None:
        """Mark the bodies that contacts pressed in the last step."""
        contacts, pressed = self._contacts, self._contacts.solver.pressed
        if contacts.lasts:
            pressed[:] = False
            if contacts.unmoved is not None:
                pressed[: len(self._bodies)] = contacts.unmoved
            contacts.solver.mark_pressed(contacts.impulses)

    def move(self, step: PresentStep) -> None:
        """Move the bodies of a step and resolve their impacts."""
        contacts, unmoved = self._contacts, self._contacts.unmoved
        if unmoved is not None and (unmoved | self._fixed).all():
            contacts.impacts = NO_IMPACTS
        else:
            contacts.add_impacts(step, self._move(step))
        step.profile.mark("impacts")

    def conclude(self, step: PresentStep) -> None:
        """Add the impacts to the statistics of the step."""
        if len(self._contacts.impacts) and self._contacts.counts_impacts:
            self._count_impacts()

    def _count_impacts(self) -> None:
        contacts, inverse_mass = self._contacts, self._bodies.ends.inverse_mass
        records = contacts.contacts, contacts.solver.contacts, contacts.solver.states
        contacts.statistics = contacts.statistics.with_impacts(contacts.impacts, *records, inverse_mass)

    def _move(self, step: PresentStep) -> Impacts:
        (kick, damping, strength), dt, contacts = step.path, step.drift, self._contacts
        self._losses = NO_ENTRIES
        scale, skin = contacts.near.margins(dt)  # near bodies belong to one island
        held = contacts.impulses if contacts.is_at_rest else ImpulseCache.empty()
        T, bodies, n = self.trajectories, self._bodies, len(self._bodies)
        if damping > 0.0:
            self.bend_by(strength)
            T = T if strength == 1.0 else T._replace(a=strength * T.a)
        T.drift["exhausted"] = 0
        self._leave_out(contacts.absent)
        velocity = self._shear.relative(bodies.velocity, bodies.position) if self._shear else bodies.velocity
        largest = write_search_radii(velocity, bodies.mass, bodies.radius, self.anchored, dt, T.body, T.drift)
        narrows = self._is_open and damping == 0.0 and NARROWED[0] < largest < NARROWED[1]
        pairs = self._neighbours(largest, scale, skin, dt, narrows)
        if contacts.absent is not None:
            pairs = pairs[are_present(pairs, contacts.absent)]
        impacts = NO_IMPACTS
        if len(pairs) or len(T.offset):
            # paths bend only if the velocities are means over the drift
            bends = bool(self.bending.any()) and (damping > 0.0 or kick == 0.5 * dt)
            self._begin(T, dt, kick, damping, bends, contacts.solver.pressed)
            self._straighten(held, contacts.unmoved)
            if self._forces:
                self._write_load_speeds(pairs, contacts.near.loading * dt, scale, skin)
            if narrows:
                near = np.empty_like(pairs)
                pairs = near[: narrow(pairs, scale, skin, T, near)]
            ends = np.searchsorted(pairs[:, 0], np.arange(n + 1))
            later = Neighbours(ends[:-1], ends[1:], np.ascontiguousarray(pairs[:, 1]))
            self._team.divide(n, MIN_BODIES_PER_TASK, predict, later, T, alone=self._predict)
            if self._fill_queue(T):
                supports = self._supports and held.kick > 0.0
                if supports:
                    acted = held.pairs, held.place, held.contacts, strength / held.kick
                    mark_supported(*acted, T)
                impacts = self._resolve(pairs, T)
                if supports:
                    if T.drift["hit"][0]:
                        correct_impulses(*acted, T)
                    self._book_supports()
        if len(impacts):
            if contacts.lasts:  # a contact that opens along the arc of a curved surface is held after the last kick
                contacts.solver.pressed[:n] |= T.body["has_landed"]
            self._team.divide(n, MIN_BODIES_PER_TASK, finish, T, alone=self._finish)
        else:
            self._team.divide(len(bodies), MIN_BODIES_PER_TASK, advance, bodies.position, bodies.velocity, dt)
        return impacts

    def _leave_out(self, absent: BoolArray | None) -> None:
        """Let strays meet only bodies that exist now."""
        if absent is not self._absent and absent is not None:
            present = np.flatnonzero(~absent)
            everyone = self.trajectories.everyone
            everyone.bodies[: len(present)] = present
            everyone.last[:] = len(present)
            self._absent = absent

    def bend_by(self, strength: float) -> None:
        """Let the uniform field, times a factor, bend the paths."""
        drift, field = self.trajectories.drift, strength * self.bending
        drift["field_x"], drift["field_y"], drift["field_z"] = field

    def resolve_meeting(self, pair: tuple[int, int] | None, dt: float) -> Impacts:
        """Resolve the impacts of a pair that meets at the end of a step of dt s, and of all pairs that touch there.

        Without a pair, only the kernels are loaded.
        """
        T, bodies = self.trajectories, self._bodies
        T.load_speed[:] = 0.0
        drift = T.drift
        drift["dt"] = drift["kick"] = drift["clock"] = dt
        drift["exhausted"] = drift["strays"] = 0
        pairs = np.empty((MOST_TOUCHING * len(bodies) + 1 if pair else 0, 2), dtype=np.int64)
        pairs[:1] = pair or 0
        count = resolve_touching(T, pairs, self.log, self._group)
        return Impacts(self.log[:count].copy())

    def step_by_impacts(self, span: float) -> float:
        """Return the longest step (s) that the next impact allows; infinite if there is none within a span (s)."""
        T, bodies, pairs = self.trajectories, self._bodies, self._contacts.contacts.pairs
        moving = (bodies.position, bodies.velocity, bodies.acceleration, bodies.radius)
        return step_by_impacts(*moving, T.surface, T.offset, pairs, span)

    def _straighten(self, held: ImpulseCache, unmoved: BoolArray | None) -> None:
        """Make the paths of held and unmoved bodies straight, and mark held bodies as not free."""
        straighten(held.pairs, held.place, held.contacts, self.trajectories)
        if unmoved is not None:
            self.trajectories.body["is_straight"][unmoved] = True

    def _book_supports(self) -> None:
        """Book what the supports of the bodies that were hit lost beyond their kicks."""
        contacts, drift = self._contacts, self.trajectories.drift
        losses = np.array([[drift["restitution"][0], drift["friction"][0], 0.0]])
        if losses.any():
            self._losses = losses
            contacts.ledger_apart = np.concatenate((contacts.ledger_apart, losses))

    def losses(self) -> FloatArray:
        """Return what the supports of the bodies that were hit in the last drift lost beyond their kicks."""
        return self._losses

    def _write_load_speeds(self, pairs: IntArray, dt: float, scale: float, skin: float) -> None:
        """Compute the load speed of each body."""
        island_load_speeds(pairs, self.trajectories, scale, skin, self.pressing, self.field, dt)

    def _neighbours(self, largest: float, scale: float, skin: float, dt: float, narrows: bool) -> IntArray:
        """Return the pairs whose search radii overlap; a small ``largest`` (in body radii) holds for all bodies."""
        T, radius, position = self.trajectories, self._bodies.radius, self._bodies.position
        if self._shear:
            position, stretch = self._shear.carried(position), self._shear.stretch(dt)
            scale, skin = stretch * scale, stretch * skin
        if largest <= WIDEST - 1.0:
            if not narrows:
                T.body["search_radius"] = largest * radius
            return self._search.pairs(position, scale * (1.0 + largest), skin)
        return HierarchicalGrid(radius + T.body["search_radius"], self._box, self._team).pairs(position, scale, skin)

    def _resolve(self, pairs: IntArray, T: Trajectories) -> Impacts:
        n = len(self._bodies)
        ends, others = np.zeros(n + 1, dtype=np.int64), np.empty(2 * len(pairs), dtype=np.int64)
        both_ways(pairs, ends, others)
        neighbours = Neighbours(ends[:-1], ends[1:], others)
        logs: list[Records] = []
        step, group, count = self._resolve_most, None, 0
        while not logs or T.drift["queued"][0] > 0:
            if logs:
                logs[-1] = logs[-1].copy()  # the copy survives the next call, which overwrites the log
            count = step(neighbours, T, self.log, group)
            logs.append(self.log[:count])
            # the log is not full, so the kernel stopped at an exhausted body
            if count + MOST_CONTACTS <= len(self.log):
                step, group = resolve, self._group
        total = sum(map(len, logs))
        if total > len(self.log):  # the next step may have as many impacts
            self.log = np.empty(2 * total, dtype=self.log.dtype)
        return Impacts(logs[0] if len(logs) == 1 else np.concatenate(logs))


@kernel
def _fill_queue(T: Trajectories) -> int:
    """Put the bodies with a predicted impact into the event queue; return their number."""
    size = 0
    for i in range(len(T.body)):
        if T.body[i].impact_time < np.inf:
            size = put(i, size, T.queue, T.body)
    T.drift[0].queued = size
    return size


@long_kernel
def resolve_touching(T: Trajectories, pairs: IntArray, log: RecordArray[ImpactRecord], group: Group) -> int:
    """Resolve the impacts of all pairs that touch at one moment; return their number.

    The pairs are resolved one by one, in the order of the event loop, until none closes. Rigid bodies have no unique
    solution where several pairs meet at once. If the sequence of impacts does not end, the contacts are held
    (`held_group`).

    The bodies are at their positions at the impact. In `DRIFT`, clock and kick are equal, and ``exhausted`` and
    ``strays`` are 0. The first pair in the buffer ``pairs`` counts as touching, whatever its gap. If the buffer has no
    rows, nothing happens.
    """
    count, row = _touching_pairs(T, pairs), 0
    for i in range(len(T.x) if count > 0 else 0):
        arrive(i, T)
    for sweep in range(MAX_ELASTIC + MOST_HOLDS):
        before = row
        for c in range(count):
            i, j = ends_of(pairs, c)
            rate, length, speeds = 0.0, 0.0, 0.0
            for k in range(3):
                d = -T.surface[j - len(T.x), k] if j >= len(T.x) else T.x[j, k] - T.x[i, k]
                rate, length = rate + d * (T.v[j, k] - T.v[i, k]), length + d * d
                speeds += abs(T.v[i, k]) + abs(T.v[j, k])
            speed = -rate / np.sqrt(length)
            if not (speed > ROUNDING * speeds or (sweep == 0 and c == 0)):
                continue
            lossy = dissipates(T.materials[material_index(i, j, len(T.x), T.places)])
            if sweep < (MAX_IN_COLLAPSE if lossy else MAX_ELASTIC) and row < len(log) // SINGLE_ROWS:
                collide(i, j, log, row, T)
                row += 1
            elif row + MOST_CONTACTS <= len(log):
                for end in (i, j):  # the contacts of these bodies are held from now on
                    if end < len(T.x):
                        T.body[end].exhausted = T.inverse_mass[end] > 0.0
                row = hold_group(i, j, T.everyone, T, log, row, group)[1]
            else:
                T.drift[0].exhausted = 1
                return row
        if row == before:
            return row
    T.drift[0].exhausted = 1
    return row


@inline
def _touching_pairs(T: Trajectories, pairs: IntArray) -> int:
    """Write the other touching pairs after the first pair; return the number of all touching pairs."""
    x, radius, offset, surface, n = T.x, T.radius, T.offset, T.surface, len(T.x)
    count = min(1, len(pairs))
    for i in range(n if count > 0 else 0):
        xi, yi, zi = vector(x, i)
        size = abs(xi) + abs(yi) + abs(zi)
        for j in range(i + 1, n):
            dx, dy, dz = between(x, i, j)
            R = radius[i] + radius[j]
            limit = R + GAP_ROUNDING * (R + size)
            if dx * dx + dy * dy + dz * dz <= limit * limit and T.inverse_mass[i] + T.inverse_mass[j] > 0.0:
                count = _add(i, j, count, pairs)
        for p in range(len(offset) if T.inverse_mass[i] > 0.0 else 0):
            nx, ny, nz = vector(surface, p)
            height = nx * xi + ny * yi + nz * zi - offset[p]
            if height - radius[i] <= GAP_ROUNDING * (radius[i] + size):
                count = _add(i, n + p, count, pairs)
    return count


@inline
def _add(i: int, j: int, count: int, pairs: IntArray) -> int:
    """Add a pair, unless it is the first pair or the buffer is full."""
    if (i == pairs[0, 0] and j == pairs[0, 1]) or count == len(pairs):
        return count
    pairs[count, 0], pairs[count, 1] = i, j
    return count + 1
