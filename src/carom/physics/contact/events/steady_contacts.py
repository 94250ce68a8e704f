"""The contacts of a step in one kernel, as long as they are the contacts of the previous step.

`ContactPipeline` calls some forty kernels a step. With few bodies, that takes a hundred times as long as the kernels
themselves. The functions here call the same kernels in the same order without Python in between, so the bits are the
same. They return False if Python must process the step: it has other pairs than the previous step, an impact, a body
behind a plane, a deep overlap, a contact that still closes, or a number that is not finite. `steady_steps` then undoes
the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.aligned import aligned_empty, words
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import CONTACTS_PER_BLOCK, ConstraintSystem
from carom.physics.contact.events.drift import WIDEST, EventDrivenDrift
from carom.physics.contact.events.event_loop import predict
from carom.physics.contact.events.trajectories import Neighbours, Trajectories, begin, straighten, write_search_radii
from carom.physics.contact.geometry import are_near, height_above, update_geometry
from carom.physics.contact.islands import excess_square, island_load_speeds, write_load_speeds
from carom.physics.contact.loads import add_loads, clear_loads, write_rest_speeds
from carom.physics.contact.near_pairs import LARGEST_SKIN
from carom.physics.contact.near_pairs import ROUNDING as MOST_ROUNDED
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.contact.plane_guard import mark_behind
from carom.physics.contact.records import ContactRecord
from carom.physics.contact.solver.body_state import gather, scatter
from carom.physics.contact.solver.impacts import CONVERGED, check_closing
from carom.physics.contact.solver.phase_code import IMPACTS, POSITIONS, RESTING
from carom.physics.contact.solver.phases import run_job
from carom.physics.contact.solver.positions import (
    audit_corrections,
    find_push_fractions,
    gather_positions,
    scatter_positions,
)
from carom.physics.contact.solver.prepare import TOUCHING, begin_contacts, carry_each, mark_pressed
from carom.physics.contact.statistics import BLOCK_COUNTS, DEEP_OVERLAP, BlockCountsRecord, count_block
from carom.physics.integrators.kick_drift import DampedPath
from carom.physics.jit.decorators import inline, unowned
from carom.physics.jit.team import ALONE
from carom.physics.vector import between, sizes, vector

MOST_CONTACTS = CONTACTS_PER_BLOCK  # more contacts would be counted in several blocks


Words = tuple[IntArray, ...]  # six, see `SteadyContacts.words`


class SteadyRules(NamedTuple):
    """How contacts are resolved."""

    board: IntArray  # empty; this and the next two fields are arguments of `phases.run_job`
    addresses: IntArray
    kind: int
    most_sweeps: int
    pushes: bool  # whether overlaps are corrected
    bends: bool  # whether a uniform field bends the paths of bodies
    anchored: bool  # whether something is fixed
    deepest: float  # overlap over the smaller radius, above which a run warns
    field: FloatArray  # (3,) m/s², the uniform field if it accelerates all bodies alike; otherwise zeros


class SteadyBuffers(NamedTuple):
    """Copies of the state at the beginning of a step, and workspaces."""

    saved: Words  # the words of `SteadyContacts.words` at the beginning of the step
    spins: FloatArray  # (n, 3) rad/s; no rows where nothing spins
    held: RecordArray[ContactRecord]  # (m,) the contacts as held, before the positions change
    held_words: IntArray  # the words of ``held``
    parent: IntArray  # (n + p,)
    largest: FloatArray  # (n + p,)
    flags: BoolArray  # (2,)
    counts: RecordArray[BlockCountsRecord]  # (1,)
    near: IntArray  # (n (n - 1) / 2, 2) pairs that may meet during the drift
    later: Neighbours  # the same pairs as the neighbours of each body


class SteadyContacts(NamedTuple):
    """The contacts of a step, which the contacts of the next steps have to match."""

    system: ConstraintSystem
    holding: ConstraintSystem  # the same, with the accelerations against which contacts are held before the drift
    trajectories: Trajectories
    rules: SteadyRules
    buffers: SteadyBuffers
    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) index of each contact's record
    counts: IntArray  # (n + p,) contacts of each body and plane
    normals: FloatArray  # (m, 3) before the position correction
    words: Words  # of `CONTACT`, `CONTACT_STATE` and `RECORDED` records, of the normals, orientations and spins
    mass: FloatArray  # (n,) kg
    inertia: FloatArray  # (n,) kg m²
    torque: FloatArray  # (n, 3) N m; no rows where none are modelled
    angular_acceleration: FloatArray  # (n, 3) rad/s²; no rows where no torques are modelled

    @classmethod
    def of(cls, contact: ContactPipeline, bodies: Bodies, against: FloatArray | None) -> SteadyContacts:
        """Gather the contacts of the last step, and memory for the next ones.

        ``against`` are the accelerations against which contacts are held before the drift, (n + p, 3) m/s² (default:
        those of the bodies).
        """
        solver, settings, event_drift = contact.solver, contact.settings, contact.part(EventDrivenDrift)
        assert event_drift is not None, "see `make` of `steady_steps`"
        system, normals, n = solver.system, solver.found_normals, len(bodies)
        ends, most = len(system.inverse_mass), n * (n - 1) // 2
        held, first = aligned_empty(len(normals), system.contacts.dtype), np.empty(n, dtype=np.int64)
        spins = np.empty_like(bodies.angular_velocity)
        records = tuple(map(words, (system.contacts, system.states, system.recorded)))
        numbers = tuple(map(_words_of, (normals, bodies.orientation, bodies.angular_velocity)))
        rules = SteadyRules(
            board=ALONE,
            addresses=solver.code.addresses,
            kind=solver.code.kind,
            most_sweeps=contact.most_sweeps,
            pushes=settings.stabilisation == "split",
            bends=bool(event_drift.bending.any()),
            anchored=event_drift.anchored,
            deepest=np.inf if settings.allow_overlap else DEEP_OVERLAP,
            field=event_drift.field,
        )
        buffers = SteadyBuffers(
            saved=(*map(np.empty_like, (*records, *numbers[:2])), _words_of(spins)),
            spins=spins,
            held=held,
            held_words=words(held),
            parent=np.empty(ends, dtype=np.int64),
            largest=np.empty(ends),
            flags=np.empty(2, dtype=np.bool_),
            counts=np.empty(1, BLOCK_COUNTS),
            near=np.empty((most, 2), dtype=np.int64),
            later=Neighbours(first, first.copy(), np.empty(most, dtype=np.int64)),
        )
        placed = contact.contacts.pairs, contact.contacts.order.place, solver.counts, normals
        moments = bodies.mass, bodies.inertia, bodies.torque, bodies.angular_acceleration
        holding = system if against is None else system._replace(acceleration=against)
        event_drift.bend_by(1.0)
        trajectories, saved = event_drift.trajectories, (*records, *numbers)
        return cls(system, holding, trajectories, rules, buffers, *placed, saved, *moments)


def _words_of(numbers: FloatArray) -> IntArray:
    """Return numbers as words of eight bytes, a view."""
    return numbers.reshape(-1).view(np.int64)


@inline
def copy_contacts(contacts: SteadyContacts, back: bool) -> None:
    """Copy records, normals, orientations and spins as a step begins into the buffers, or back."""
    for k in range(len(contacts.words)):
        if back:
            copy_words(contacts.buffers.saved[k], contacts.words[k])
        else:
            copy_words(contacts.words[k], contacts.buffers.saved[k])


@unowned
def copy_words(words: IntArray, to: IntArray) -> None:
    """Copy words; NumPy's assignment would check for overlapping memory."""
    for k in range(len(words)):
        to[k] = words[k]


@unowned
def hold_steady(
    contacts: SteadyContacts, kick: float, last_kick: float, last_dt: float, drift: float, booked: float
) -> None:
    """Hold the contacts after a kick, before a drift; see `ContactPipeline.hold`. All times are in s."""
    system, place, m = contacts.system, contacts.place, len(contacts.pairs)
    for i in range(len(system.pressed)):
        system.pressed[i] = False
    mark_pressed(0, m, contacts.pairs, place, system.contacts, system.inverse_mass, system.pressed)
    carry_each(0, m, system.contacts, kick / last_kick, system.contacts)
    _hold(contacts, contacts.holding, (last_dt, booked, drift))
    clear_loads(system.active, system.loads)
    add_loads(system.pairs, system.contacts, system.inverse_mass, kick, system.loads)


@unowned
def drift_steady(contacts: SteadyContacts, path: DampedPath, dt: float) -> bool:
    """Predict the impacts of a drift of dt s; return whether there are none."""
    T, rules, system = contacts.trajectories, contacts.rules, contacts.system
    n, later, near = len(T.x), contacts.buffers.later, contacts.buffers.near
    scale, skin, _ = _margins(T.x, T.radius, system.acceleration, rules.field, dt)
    farthest = write_search_radii(T.v[:n], contacts.mass, T.radius[:n], rules.anchored, dt, T.body, T.drift)
    is_wide, widened = farthest > WIDEST - 1.0, scale
    if not is_wide:
        widened = scale * (1.0 + farthest)
        for i in range(n):
            T.body[i].search_radius = farthest * T.radius[i]
    m, size = 0, sizes(T.box)
    for i in range(n):
        later.first[i] = m
        for j in range(i + 1, n):
            dx, dy, dz = between(T.x, i, j)
            radii = T.radius[i] + T.radius[j]
            if is_wide:
                radii = (T.radius[i] + T.body[i].search_radius) + (T.radius[j] + T.body[j].search_radius)
            if are_near(dx, dy, dz, radii, size, widened, skin):
                near[m, 0], near[m, 1], later.bodies[m] = i, j, j
                m += 1
        later.last[i] = m
    bends = rules.bends and (path.damping > 0.0 or path.kick == 0.5 * dt)
    begin(T, dt, path.kick, path.damping, bends, system.pressed)
    straighten(contacts.pairs, contacts.place, system.contacts, T)
    island_load_speeds(near[:m], T, scale, skin, system.acceleration, rules.field, dt)
    predict(0, n, later, T)
    first = np.inf
    for i in range(n):
        first = min(first, T.body[i].impact_time)
    return first == np.inf


@unowned
def find_steady(contacts: SteadyContacts, x: FloatArray, radius: FloatArray, dt: float) -> bool:
    """Set up the contacts after the drift of a step of dt s, and correct overlaps; see `ContactPipeline.find`."""
    system, rules, buffers, m = contacts.system, contacts.rules, contacts.buffers, len(contacts.pairs)
    scale, skin, rounding = _margins(x, radius, system.acceleration, rules.field, dt)
    if _is_behind(contacts, x) or not _are_same(contacts, x, radius, scale, skin):
        return False
    settings = system.settings[0]
    settings.islands_known = False
    copy_words(contacts.words[0], buffers.held_words)
    recorded = contacts.words[2]
    for k in range(len(recorded)):
        recorded[k] = 0
    shapes = x, radius, system.box, system.surface, system.offset
    begin_contacts(0, m, system.pairs, shapes, system.contacts, system.states, rounding, contacts.normals)
    if not write_load_speeds(system, rules.field, dt, (buffers.parent, buffers.largest, buffers.flags)):
        return False
    pressed = system.velocity, system.acceleration, system.loads, dt
    write_rest_speeds(0, m, system.pairs, system.contacts, pressed, system.load_speed, system.states)
    if rules.pushes:
        b, v, pushed, pushed_in = len(system.active), system.velocity, system.pushed, system.pushed_in
        find_push_fractions(0, m, system.pairs, contacts.counts, system.states)
        gather_positions(0, b, system.active, (x, v, radius, system.inverse_mass), pushed, pushed_in)
        run_job(rules.board, POSITIONS, rules.addresses, rules.kind, system, rules.most_sweeps)
        scatter_positions(0, b, system.active, pushed, pushed_in, x, v)
    return not _is_behind(contacts, x)


@unowned
def resolve_steady(
    contacts: SteadyContacts, x: FloatArray, radius: FloatArray, first_kick: float, kick: float, dt: float
) -> tuple[bool, int]:
    """Resolve the contacts after the last kick, with all times in s; see `ContactPipeline.resolve`.

    Return whether the step is complete without Python, and the number of iterations.
    """
    system, rules, m = contacts.system, contacts.rules, len(contacts.pairs)
    shapes = x, radius, system.box, system.surface, system.offset
    update_geometry(0, m, system.pairs, shapes, system.contacts, system.states)
    if rules.pushes:
        audit_corrections(0, m, system.pairs, system.acceleration, system.inverse_mass, system.states)
    settings = system.settings[0]
    settings.bias_rate, settings.impacts_only = 0.0, True
    sweeps = _lead(system, rules, contacts.trajectories.inverse_inertia, IMPACTS)
    if not (settings.any_rests or sweeps == rules.most_sweeps):
        return False, sweeps
    carry_each(0, m, contacts.buffers.held, kick / first_kick, system.contacts)
    sweeps = max(sweeps, _hold(contacts, system, (dt, kick, 0.0)))
    if sweeps >= rules.most_sweeps:
        closing, negligible = contacts.buffers.flags, CONVERGED * settings.fastest
        closing[0] = False
        resolved = system.contacts, system.states, system.load_speed
        check_closing(0, m, system.pairs, resolved, system.velocity, (negligible, dt), closing)
        if closing[0]:
            return False, sweeps
    for c in range(m):
        if system.states[c].approach_speed > system.states[c].rest_speed:
            return False, sweeps
    counts, ends = contacts.buffers.counts, (system.inverse_mass, contacts.trajectories.radius)
    count_block(0, 1, system.pairs, system.contacts, system.states, *ends, counts)
    return counts[0].contacts > 0.0 and counts[0].deepest <= rules.deepest, sweeps


@inline
def _hold(contacts: SteadyContacts, system: ConstraintSystem, times: tuple[float, float, float]) -> int:
    settings = system.settings[0]
    settings.dt, settings.booked, settings.drift = times
    settings.bias_rate = 0.0
    return _lead(system, contacts.rules, contacts.trajectories.inverse_inertia, RESTING)


@unowned
def _lead(system: ConstraintSystem, rules: SteadyRules, inverse_inertia: FloatArray, job: int) -> int:
    """Run a job on the velocities of the active bodies; return the number of iterations."""
    b = len(system.active)
    gather(0, b, system.active, system.velocity, system.spin, system.inverse_mass, inverse_inertia, system.bodies)
    iterations = run_job(rules.board, job, rules.addresses, rules.kind, system, rules.most_sweeps)
    scatter(0, b, system.active, system.bodies, system.velocity, system.spin)
    return iterations


@unowned
def _margins(
    x: FloatArray, radius: FloatArray, acceleration: FloatArray, field: FloatArray, dt: float
) -> tuple[float, float, float]:
    """Return scale, skin and rounding in m of a step of dt s; see `NearPairs.margins`."""
    square, coordinate, smallest = 0.0, 0.0, np.inf
    for i in range(len(x)):
        square = max(square, excess_square(acceleration, field, i))
        smallest = min(smallest, radius[i])
        for k in range(3):
            coordinate = max(coordinate, abs(x[i, k]))
    rounding = MOST_ROUNDED * np.spacing(coordinate)
    return 1.0 + TOUCHING, rounding + min(np.sqrt(square) * dt * dt, LARGEST_SKIN * smallest), rounding


@inline
def _is_behind(contacts: SteadyContacts, x: FloatArray) -> bool:
    """Return whether a centre is behind a plane."""
    system, flags = contacts.system, contacts.buffers.flags
    flags[0] = False
    mark_behind(0, len(x), x, system.surface, system.offset, flags)
    return bool(flags[0])


@inline
def _are_same(contacts: SteadyContacts, x: FloatArray, radius: FloatArray, scale: float, skin: float) -> bool:
    """Return whether the near pairs are the same as in the previous step."""
    system, pairs, n, m = contacts.system, contacts.pairs, len(x), len(contacts.pairs)
    c, size, inverse_mass = 0, sizes(system.box), system.inverse_mass
    for i in range(n):
        for j in range(i + 1, n + len(system.offset)):
            if j < n:
                dx, dy, dz = between(x, i, j)
                near = are_near(dx, dy, dz, radius[i] + radius[j], size, scale, skin)
            else:
                px, py, pz = vector(x, i)
                near = height_above(system.surface, system.offset, j - n, px, py, pz) <= radius[i] * scale + skin
            if near and inverse_mass[i] + inverse_mass[j] > 0.0:
                if c == m or pairs[c, 0] != i or pairs[c, 1] != j:
                    return False
                c += 1
    return c == m
