"""The contact stages of the kernel for few bodies, for steps with the same contacts as the previous step.

`ContactPipeline` calls some forty kernels a step. With few bodies, the calls take a hundred times as long as the
kernels themselves. The functions here call the same kernels in the same order without Python in between, so the bits
are the same. These functions are variants of those in `carom.physics.open_gaps`, for contacts that rest, slide or roll,
and for contacts without impulses, which no force presses together.

The functions return False if Python must process the step: if it has other pairs than the previous step, an impact, a
body behind a plane, a deep overlap, a contact that still closes, a force that begins or ceases to press contacts
together, or a number that is not finite.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.physics.contact.constraints import CONTACTS_PER_BLOCK, ConstraintSystem
from carom.physics.contact.events.drift import WIDEST
from carom.physics.contact.events.event_loop import predict
from carom.physics.contact.events.steady_data import SteadyContacts, SteadyRules
from carom.physics.contact.events.trajectories import begin, straighten, write_search_radii
from carom.physics.contact.geometry import are_near, height_above, update_geometry
from carom.physics.contact.islands import excess_square, island_load_speeds, write_load_speeds
from carom.physics.contact.loads import add_loads, clear_loads, write_rest_speeds
from carom.physics.contact.near_pairs import LARGEST_SKIN
from carom.physics.contact.near_pairs import ROUNDING as MOST_ROUNDED
from carom.physics.contact.plane_guard import mark_behind
from carom.physics.contact.reactions import add_support, write_torques
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
from carom.physics.contact.statistics import count_block
from carom.physics.integrators.kick_drift import DampedPath, DampedStep
from carom.physics.jit.decorators import inline, inner
from carom.physics.open_gaps import (
    KeptState,
    MovedState,
    Room,
    Totals,
    can_drift,
    conclude,
    copy_records,
    find,
    hold,
    resolve,
    rotate,
    with_contacts,
    write_support,
)
from carom.physics.rotation import rotate_one
from carom.physics.vector import between, is_periodic, sizes, vector

MOST_CONTACTS = CONTACTS_PER_BLOCK  # more contacts would be counted in several blocks


@with_contacts(write_support)
def _write_support(contacts: SteadyContacts, totals: Totals) -> None:
    supported = contacts.supported
    if len(supported) > 0:
        supported[:] = 0.0
        if totals[0].last_kick > 0.0:
            touching = contacts.pairs, contacts.place, contacts.system.contacts, contacts.system.inverse_mass
            add_support(*touching, totals[0].last_kick, supported)


@with_contacts(copy_records)
def _copy_records(contacts: SteadyContacts, back: bool) -> None:
    for k in range(len(contacts.words)):
        if back:
            _copy_words(contacts.buffers.saved[k], contacts.words[k])
        else:
            _copy_words(contacts.words[k], contacts.buffers.saved[k])


@inner
def _copy_words(words: IntArray, to: IntArray) -> None:
    """Copy words; NumPy's assignment would check for overlapping memory."""
    for k in range(len(words)):
        to[k] = words[k]


@with_contacts(hold)
def _hold_contacts(contacts: SteadyContacts, totals: Totals, damped: DampedStep) -> bool:
    T = totals[0]
    T.held_restitution = T.held_friction = T.held_stabilisation = 0.0
    if T.last_kick == 0.0:
        _release(contacts)
        return True
    if not min(damped.held_kick, damped.last_kick) > 0.0:
        return False
    hold_steady(contacts, damped.held_kick, T.last_kick, T.last_dt, damped.length, damped.booked)
    for piece in range(len(contacts.system.piece_results)):
        found = contacts.system.piece_results[piece]
        T.held_restitution += found.restitution_loss
        T.held_friction += found.friction_loss
        T.held_stabilisation += found.stabilisation_gain
    return True


@inner
def _copy_spins(contacts: SteadyContacts) -> None:
    """Copy the spins of the drift, by which `rotate` turns the bodies."""
    spins, drifting = contacts.spins, contacts.buffers.drifting_spins
    for i in range(len(spins)):
        for k in range(3):
            drifting[i, k] = spins[i, k]


@inner
def _release(contacts: SteadyContacts) -> None:
    """Begin a step with contacts that carry no impulses."""
    system = contacts.system
    if contacts.rules.lasts:
        for i in range(len(system.pressed)):
            system.pressed[i] = False
        clear_loads(system.active, system.loads)


@inner
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


@with_contacts(can_drift)
def _can_drift(
    contacts: SteadyContacts,
    totals: Totals,
    damped: DampedStep,
    moved: MovedState,
    kept: KeptState,
    field: float,
    drift: float,
    room: Room,
) -> tuple[bool, Room]:
    crosses = is_periodic(kept.box) and _crosses(moved.velocity, kept.box, drift)
    if damped.path.strength != 1.0 or crosses or not _are_finite(moved.position, moved.velocity):
        return False, room
    return drift_steady(contacts, damped.path, drift, totals[0].last_kick > 0.0), room


@inline
def _are_finite(position: FloatArray, velocity: FloatArray) -> bool:
    rest = 0.0
    for i in range(len(position)):
        for k in range(3):
            x, v = position[i, k], velocity[i, k]
            rest += (x - x) + (v - v)  # adds 0, or NaN if an input is not finite
    return rest == 0.0


@inline
def _crosses(velocity: FloatArray, box: FloatArray, dt: float) -> bool:
    """Return whether a body crosses a whole box in dt s; the general step refuses many crossings."""
    for i in range(len(velocity)):
        for k in range(3):
            if abs(velocity[i, k]) * dt >= box[k]:
                return True
    return False


@inner
def drift_steady(contacts: SteadyContacts, path: DampedPath, dt: float, holds: bool) -> bool:
    """Predict the impacts of a drift of dt s; return whether there are none. ``holds``: whether contacts are held."""
    T, rules, system = contacts.trajectories, contacts.rules, contacts.system
    n, later, near = len(T.x), contacts.buffers.later, contacts.buffers.near
    scale, skin, _ = _margins(T.x, T.radius, system.acceleration, rules, dt)
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
    if holds:
        straighten(contacts.pairs, contacts.place, system.contacts, T)
    if rules.loads:
        island_load_speeds(near[:m], T, scale, skin, system.acceleration, rules.field, dt)
    predict(0, n, later, T)
    first = np.inf
    for i in range(n):
        first = min(first, T.body[i].impact_time)
    return first == np.inf


@with_contacts(find)
def _find(contacts: SteadyContacts, totals: Totals, damped: DampedStep) -> bool:
    T, holds = contacts.trajectories, totals[0].last_kick > 0.0
    return _are_finite(T.x, T.v) and find_steady(contacts, T.x, T.radius[: len(T.x)], damped, holds)


@inner
def find_steady(contacts: SteadyContacts, x: FloatArray, radius: FloatArray, damped: DampedStep, holds: bool) -> bool:
    """Set up the contacts after the drift of a step, and correct overlaps; see `ContactPipeline.find`."""
    system, rules, buffers, m = contacts.system, contacts.rules, contacts.buffers, len(contacts.pairs)
    dt = damped.length
    scale, skin, rounding = _margins(x, radius, system.acceleration, rules, dt)
    if _is_behind(contacts, x) or not _are_same(contacts, x, radius, scale, skin):
        return False
    settings = system.settings[0]
    settings.islands_known, settings.impacts_only = False, holds or rounding > 0.0
    _copy_words(contacts.words[0], buffers.held_words)
    recorded = contacts.words[2]
    for k in range(len(recorded)):
        recorded[k] = 0
    shapes = x, radius, system.box, system.surface, system.offset
    begin_contacts(0, m, system.pairs, shapes, system.contacts, system.states, rounding, contacts.normals)
    if rules.loads:
        presses = write_load_speeds(system, rules.field, dt, (buffers.parent, buffers.largest, buffers.flags))
        if rules.lasts and presses != holds:
            return False
        pressed = system.velocity, system.acceleration, system.loads, dt
        write_rest_speeds(0, m, system.pairs, system.contacts, pressed, system.load_speed, system.states)
    if rules.pushes:
        b, v, pushed, pushed_in = len(system.active), system.velocity, system.pushed, system.pushed_in
        settings.next_kick = damped.last_kick
        find_push_fractions(0, m, system.pairs, contacts.counts, system.states)
        gather_positions(0, b, system.active, (x, v, radius, system.inverse_mass), pushed, pushed_in)
        run_job(rules.board, POSITIONS, rules.addresses, rules.kind, system, rules.most_sweeps)
        scatter_positions(0, b, system.active, pushed, pushed_in, x, v)
    return not _is_behind(contacts, x)


@with_contacts(resolve)
def _resolve(contacts: SteadyContacts, totals: Totals, damped: DampedStep) -> bool:
    T, x = totals[0], contacts.trajectories.x
    _copy_spins(contacts)
    holds = T.last_kick > 0.0
    is_done, T.sweeps = resolve_steady(contacts, x, contacts.trajectories.radius[: len(x)], damped, holds)
    T.last_kick, T.last_dt = damped.last_kick if holds else 0.0, damped.length
    return is_done


@inner
def resolve_steady(
    contacts: SteadyContacts, x: FloatArray, radius: FloatArray, damped: DampedStep, holds: bool
) -> tuple[bool, int]:
    """Resolve the contacts after the last kick of a step; see `ContactPipeline.resolve`.

    Return whether the step is complete without Python, and the number of iterations.
    """
    system, rules, m, dt = contacts.system, contacts.rules, len(contacts.pairs), damped.length
    shapes = x, radius, system.box, system.surface, system.offset
    update_geometry(0, m, system.pairs, shapes, system.contacts, system.states)
    if rules.pushes:
        audit_corrections(0, m, system.pairs, system.acceleration, system.inverse_mass, system.states)
    settings = system.settings[0]
    settings.bias_rate = 0.0
    sweeps = _lead(system, rules, contacts.trajectories.inverse_inertia, IMPACTS)
    if holds:
        if not (settings.any_rests or sweeps == rules.most_sweeps):
            return False, sweeps
        carry_each(0, m, contacts.buffers.held, damped.last_kick / damped.held_kick, system.contacts)
        sweeps = max(sweeps, _hold(contacts, system, (dt, damped.last_kick, 0.0)))
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


@with_contacts(rotate)
def _rotate(contacts: SteadyContacts, orientation: FloatArray, spins: FloatArray, dt: float) -> None:
    for i in range(len(orientation)):
        rotate_one(i, orientation, contacts.buffers.drifting_spins, dt)


@with_contacts(conclude)
def _conclude(contacts: SteadyContacts, totals: Totals, dt: float, step: int, time: float) -> None:
    T, counts, torques = totals[0], contacts.buffers.counts[0], (contacts.torque, contacts.angular_acceleration)
    turning = contacts.buffers.spins, contacts.spins, contacts.inertia
    write_torques(0, len(contacts.torque), *turning, dt, *torques)
    T.restitution += T.held_restitution
    T.friction += T.held_friction
    T.stabilisation += T.held_stabilisation
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


@inline
def _hold(contacts: SteadyContacts, system: ConstraintSystem, times: tuple[float, float, float]) -> int:
    settings = system.settings[0]
    settings.dt, settings.booked, settings.drift = times
    settings.bias_rate = 0.0
    return _lead(system, contacts.rules, contacts.trajectories.inverse_inertia, RESTING)


@inner
def _lead(system: ConstraintSystem, rules: SteadyRules, inverse_inertia: FloatArray, job: int) -> int:
    """Run a job on the velocities of the active bodies; return the number of iterations."""
    b = len(system.active)
    gather(0, b, system.active, system.velocity, system.spin, system.inverse_mass, inverse_inertia, system.bodies)
    iterations = run_job(rules.board, job, rules.addresses, rules.kind, system, rules.most_sweeps)
    scatter(0, b, system.active, system.bodies, system.velocity, system.spin)
    return iterations


@inner
def _margins(
    x: FloatArray, radius: FloatArray, acceleration: FloatArray, rules: SteadyRules, dt: float
) -> tuple[float, float, float]:
    """Return scale, skin and rounding in m of a step of dt s; see `NearPairs.margins`."""
    if not rules.lasts:
        return 1.0, 0.0, 0.0
    square, coordinate, smallest = 0.0, 0.0, np.inf
    for i in range(len(x)):
        square = max(square, excess_square(acceleration, rules.field, i))
        smallest = min(smallest, radius[i])
        for k in range(3):
            coordinate = max(coordinate, abs(x[i, k]))
    fall = np.sqrt(square) * dt * dt
    if fall == 0.0:  # no force presses, so all contacts are impacts
        return 1.0, 0.0, 0.0
    rounding = MOST_ROUNDED * np.spacing(coordinate)
    return 1.0 + TOUCHING, rounding + min(fall, LARGEST_SKIN * smallest), rounding


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
