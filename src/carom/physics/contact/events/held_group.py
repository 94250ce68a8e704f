"""Contacts that are held for the remaining drift, because their impacts do not end.

A light ball between a heavy ball and a floor rattles: to stop the heavy ball, it needs about as many impacts as the
ratio of the masses. With e < 1, there may be infinitely many impacts in a finite time. In this limit, the contacts
neither close nor rebound. A body that has had as many impacts as a drift allows is exhausted, and its contacts are set
to this limit at once. From then on, each impact involves a group: the pair, all bodies that touch an exhausted body of
the pair, all bodies that touch an exhausted body among these, and so on. For each contact of the group,

    v_n + max(0, gap) / (time left) ≥ 0,    λ ≥ 0,    one of them 0,

so that in this drift gaps do not become negative and overlaps do not grow. Among all velocities that satisfy these
conditions, `nearest_velocities` finds the nearest ones to the previous velocities, measured by kinetic energy.

Bodies that separate and meet again could also be held infinitely often. Each time, the gap up to which their contacts
are held doubles, until it covers the whole drift.

Where no contact of the group dissipates (e = 1), the impulses are twice the impulses that end the closing at the
present time. These impulses reverse the closing component of √m v instead of removing it, so the energy is conserved. A
light ball between a heavy ball and a wall then makes the heavy ball turn back, as its remaining impacts would. The
heavy ball turns too early, by twice the time that the heavy ball needs to cover the remaining gap. As soon as an impact
has acted on several contacts, the bodies continue with single impacts. A body that is exhausted again and again, such
as a ball between two walls that nearly touch it, stays in its place, closes no contact, and rebounds at the end of the
drift.

Rejected: impulses with e = 0 one by one, which are as many as the impacts; leaving an exhausted body out of the drift,
so that others pass through it.
"""

from __future__ import annotations

import math

import numpy as np

from carom.arrays import RecordArray
from carom.physics.contact.events.nearest_velocities import MOST_BODIES, MOST_CONTACTS, Group, find_impulses
from carom.physics.contact.events.trajectories import (
    MOST_HOLDS,
    Neighbours,
    Trajectories,
    advance,
    centre,
    contact_geometry,
    elapsed,
    mean_velocity_of_wall,
    place_at_wall,
    release,
    slowing,
    straighten_path,
    touches_in_drift,
    velocity,
    velocity_of_partner,
)
from carom.physics.contact.facets import consists_of_facets, first_facet, next_facet
from carom.physics.contact.guided_walls import push_guided
from carom.physics.contact.impact_log import ROUNDING
from carom.physics.contact.law import dissipates, material_index
from carom.physics.contact.records import ImpactRecord
from carom.physics.contact.rolling import set_angular_impulse
from carom.physics.contact.solids import tangent_plane
from carom.physics.contact.translating_walls import velocity_in_drift, walls_translate
from carom.physics.jit.decorators import inline, inner
from carom.physics.sheared_box import add_work, is_sheared, nearest_in_drift
from carom.physics.vector import Vector, along, between, vector

# largest number of releases of an exhausted elastic body in a drift; a chain of impacts between masses needs 1 or 2
MOST_RELEASES = 3
SPEED_ROUNDING = 10.0 * ROUNDING  # closing speed, relative to the fastest body, that needs no impulse


@inner
def hold_group(
    i: int, j: int, neighbours: Neighbours, T: Trajectories, log: RecordArray[ImpactRecord], row: int, group: Group
) -> tuple[int, int]:
    """Hold the contacts of a meeting pair and of its group; one of the bodies of the pair is exhausted.

    At least `MOST_CONTACTS` rows of the log, from ``row`` on, are free. The bodies of the pair, and all bodies whose
    velocities change, are written to ``group.changed``. Return their number, and the first free row.
    """
    bodies, contacts = _gather(i, j, neighbours, T, group)
    elastic, waits, guided = _is_elastic(contacts, group, T), False, False
    for end in range(2 if j < len(T.x) else 1):
        body = T.body[j if end else i]
        waits = waits or (body.exhausted and body.releases == MOST_RELEASES)
    for k in range(bodies):
        guided = guided or group.body[k] >= len(T.x)
    waits = waits and elastic and T.drift[0].clock < T.drift[0].dt  # the rebound waits until the end of the drift
    if waits and guided:  # the wall would move on without the rebound
        waits = elastic = False
    if elastic:
        for c in range(contacts):
            ends = group.ends[c, 0], group.ends[c, 1]
            normal = group.normal[c, 0], group.normal[c, 1], group.normal[c, 2]
            group.allowed[c] = _further_closing(ends, normal, T) / slowing(T)
    fastest, largest = 0.0, 0.0
    for k in range(bodies):
        fastest = max(fastest, abs(group.v[k, 0]) + abs(group.v[k, 1]) + abs(group.v[k, 2]))
        largest = max(largest, T.inverse_mass[group.body[k]])
    unit = math.ldexp(1.0, math.frexp(largest)[1])  # 1/kg; roots have the same bits in units that are powers of two
    for k in range(bodies):
        group.root[k] = np.sqrt(T.inverse_mass[group.body[k]] / unit)
    find_impulses(bodies, contacts, SPEED_ROUNDING * fastest, group)
    active = 0
    for c in range(contacts):
        active += group.impulse[c] > 0.0
        group.impulse[c] *= (2.0 if elastic else 1.0) / unit
    if elastic:
        for k in range(bodies):
            _rebound(k, waits, group, T)
    count = 0
    for k in range(bodies):
        b = group.body[k]
        if b >= len(T.x):  # a guided wall: its entry is the change of velocity until the contacts are logged
            T.v[b, 0], T.v[b, 1], T.v[b, 2] = vector(group.v, k)
            continue
        moved = b in (i, j)
        for d in range(3):
            moved = moved or T.v[b, d] != group.v[k, d]
            T.v[b, d] = group.v[k, d]
        if moved:
            group.changed[count] = b
            count += 1
            T.body[b].negligible_speed = max(T.body[b].negligible_speed, SPEED_ROUNDING * fastest)
    for end in range(2 if j < len(T.x) else 1):
        body = T.body[j if end else i]
        if body.exhausted:
            body.holds += 1
            body.standoff *= 2.0
            if elastic and not waits and (active > 1 or body.holds == MOST_HOLDS):
                release(j if end else i, T)
    row = _log(contacts, elastic, T, group, log, row)
    for k in range(bodies):
        b = group.body[k]
        if b >= len(T.x):
            nx, ny, nz, _ = tangent_plane(T.surface, T.offset, b - len(T.x), 0.0, 0.0, 0.0)
            vx, vy, vz = vector(T.v, b)
            push_guided(T.surface, b - len(T.x), T.drift[0].clock, vx * nx + vy * ny + vz * nz)
            T.v[b, 0], T.v[b, 1], T.v[b, 2] = 0.0, 0.0, 0.0
    return count, row


@inline
def _is_elastic(contacts: int, group: Group, T: Trajectories) -> bool:
    """Return whether no contact of a group dissipates energy."""
    for c in range(contacts):
        if dissipates(T.materials[material_index(group.ends[c, 0], group.ends[c, 1], len(T.x), T.places)]):
            return False
    return True


@inner
def _further_closing(ends: tuple[int, int], normal: Vector, T: Trajectories) -> float:
    """Return the change (m/s) of a contact's normal velocity so far in the drift, by the kick, walls and shear."""
    (i, j), (nx, ny, nz), s = ends, normal, T.drift[0].clock - T.drift[0].kick
    ax, ay, az = between(T.a, i, j)
    further = s * (ax * nx + ay * ny + az * nz)
    if walls_translate(T.surface) and j >= len(T.x):
        wx, wy, wz = velocity_in_drift(T.surface, j - len(T.x), elapsed(T))
        further += wx * nx + wy * ny + wz * nz
    if is_sheared(T.box):
        wx, wy, wz = velocity_of_partner(i, j, T)
        further += wx * nx + wy * ny + wz * nz
    return float(further)


@inner
def _gather_solid(b: int, p: int, bodies: int, contacts: int, T: Trajectories, group: Group) -> tuple[int, int]:
    """Add a body's contact with a nearby solid to a group; return the group's numbers of bodies and contacts."""
    n = len(T.x)
    if contacts < MOST_CONTACTS and contact_geometry(b, n + p, T)[3] - T.radius[b] <= T.body[b].standoff:
        if _place(n + p, bodies, group) < 0 and bodies < MOST_BODIES:
            bodies = _join(n + p, bodies, T, group)
        contacts = _add(b, n + p, bodies, contacts, T, group)
    return bodies, contacts


@inner
def _gather(i: int, j: int, neighbours: Neighbours, T: Trajectories, group: Group) -> tuple[int, int]:
    """Collect the group of a meeting pair; return the numbers of its bodies and contacts."""
    n, drift = len(T.x), T.drift[0]
    bodies = _join(j, _join(i, 0, T, group), T, group)
    contacts = _add(i, j, bodies, 0, T, group)
    k = 0
    while k < bodies:
        b = group.body[k]
        k += 1
        if b >= n or not T.body[b].exhausted:
            continue
        body = T.body[b]
        for p in range(len(T.offset)):
            if not consists_of_facets(T.surface, p):
                if not (b == i and n + p == j):
                    bodies, contacts = _gather_solid(b, p, bodies, contacts, T, group)
                continue
            x, y, z = place_at_wall(b, p, T)
            reach = T.radius[b] + body.standoff
            facet, walk = next_facet(T.surface, p, first_facet(T.surface, p), (x, y, z), reach)
            while facet >= 0:
                if not (b == i and n + facet == j) and touches_in_drift(b, facet, T):
                    bodies, contacts = _gather_solid(b, facet, bodies, contacts, T, group)
                facet, walk = next_facet(T.surface, p, walk, (x, y, z), reach)
        for source in range(2):
            among = T.strays if source == 1 else (T.everyone if body.strays else neighbours)
            if source == 1 and (drift.strays == 0 or body.strays):
                continue
            for m in range(among.first[b], among.last[b]):
                other = among.bodies[m]
                if other == b or (min(b, other) == i and max(b, other) == j):
                    continue
                place = _place(other, bodies, group)
                if 0 <= place < k and T.body[other].exhausted:
                    continue  # this contact is already in the group
                if contacts == MOST_CONTACTS or not _is_near(b, other, T):
                    continue
                if place < 0 and T.inverse_mass[other] > 0.0:
                    if bodies == MOST_BODIES:
                        continue
                    bodies = _join(other, bodies, T, group)
                contacts = _add(min(b, other), max(b, other), bodies, contacts, T, group)
    return bodies, contacts


@inner
def _is_near(i: int, j: int, T: Trajectories) -> bool:
    """Return whether the gap between two bodies is so small that their contact is held."""
    clock = T.drift[0].clock
    xi, yi, zi = along(T.x, T.v, i, clock - T.body[i].now)
    xj, yj, zj = along(T.x, T.v, j, clock - T.body[j].now)
    dx, dy, dz = xj - xi, yj - yi, zj - zi
    dx, dy, dz = nearest_in_drift(dx, dy, dz, T.box, clock)
    R = T.radius[i] + T.radius[j]
    R += T.body[i].standoff if T.body[i].exhausted else 0.0
    R += T.body[j].standoff if T.body[j].exhausted else 0.0
    return bool(dx * dx + dy * dy + dz * dz <= R * R)


@inline
def _place(i: int, bodies: int, group: Group) -> int:
    """Return the place of a body in the group; -1 if the body is outside the group."""
    for k in range(bodies):
        if group.body[k] == i:
            return k
    return -1


@inner
def _join(i: int, bodies: int, T: Trajectories, group: Group) -> int:
    """Add a body that moves, or a guided wall, to the group at the present time; return the number of bodies."""
    if T.inverse_mass[i] == 0.0:
        return bodies
    if i < len(T.x):
        advance(i, T)
    group.body[bodies] = i
    group.v[bodies, 0], group.v[bodies, 1], group.v[bodies, 2] = vector(T.v, i)
    return bodies + 1


@inner
def _add(i: int, j: int, bodies: int, contacts: int, T: Trajectories, group: Group) -> int:
    """Add a contact; return the number of contacts."""
    if j < len(T.x):
        advance(i, T)
        advance(j, T)
    nx, ny, nz, ri, rj = contact_geometry(i, j, T)
    touching = T.radius[i] + (T.radius[j] if j < len(T.x) else 0.0)  # the radius of a plane is infinite
    gap, remaining = ri + rj - touching, T.drift[0].dt - T.drift[0].clock
    group.ends[contacts, 0], group.ends[contacts, 1] = i, j
    group.place[contacts, 0], group.place[contacts, 1] = _place(i, bodies, group), _place(j, bodies, group)
    group.normal[contacts, 0], group.normal[contacts, 1], group.normal[contacts, 2] = nx, ny, nz
    vx, vy, vz = between(T.v, i, j)
    group.before[contacts] = vx * nx + vy * ny + vz * nz
    group.allowed[contacts] = gap / remaining if gap > 0.0 and remaining > 0.0 else 0.0
    if walls_translate(T.surface) and j >= len(T.x):
        wx, wy, wz = mean_velocity_of_wall(j, T)
        group.allowed[contacts] += wx * nx + wy * ny + wz * nz
    if is_sheared(T.box):
        wx, wy, wz = velocity_of_partner(i, j, T)
        group.allowed[contacts] += wx * nx + wy * ny + wz * nz
    return contacts + 1


@inner
def _rebound(k: int, waits: bool, group: Group, T: Trajectories) -> None:
    """Double the velocity change of a body, so that it rebounds; if it ``waits``, at the end of the drift."""
    x, y, z = vector(T.v, group.body[k])
    x, y, z = group.v[k, 0] - x, group.v[k, 1] - y, group.v[k, 2] - z
    if not waits:
        group.v[k, 0], group.v[k, 1], group.v[k, 2] = group.v[k, 0] + x, group.v[k, 1] + y, group.v[k, 2] + z
        return
    body = T.body[group.body[k]]
    if not body.exhausted:
        straighten_path(group.body[k], T)
        body.exhausted = True
        body.later_x = body.later_y = body.later_z = 0.0
    body.releases = MOST_RELEASES
    body.later_x, body.later_y, body.later_z = body.later_x + x, body.later_y + y, body.later_z + z


@inner
def _log(contacts: int, elastic: bool, T: Trajectories, group: Group, log: RecordArray[ImpactRecord], row: int) -> int:
    """Log the contacts that had an impulse, with the mean of the speeds before and after it; return the next row.

    Summed over the group, -λ (v_n + v_n')/2 is the energy lost. In the limit of infinitely many impacts, all of
    this energy is lost by restitution, unless the contacts are elastic.
    """
    clock, f, first = T.drift[0].clock, slowing(T), row
    for c in range(contacts):
        Jn = f * group.impulse[c]
        if not Jn > 0.0:
            continue
        i, j = group.ends[c, 0], group.ends[c, 1]
        nx, ny, nz, ri, rj = contact_geometry(i, j, T)
        vx, vy, vz = between(T.v, i, j)
        change = _further_closing((i, j), (nx, ny, nz), T)
        if is_sheared(T.box):
            wx, wy, wz = velocity_of_partner(i, j, T)
            add_work(T.box, -Jn * (wx * nx + wy * ny + wz * nz))
        before, after = f * group.before[c] + change, f * (vx * nx + vy * ny + vz * nz) + change
        entry = log[row]
        row += 1
        entry.i, entry.j, entry.time, entry.clock = i, j, elapsed(T), clock
        entry.nx, entry.ny, entry.nz = nx, ny, nz
        entry.approach, entry.rest_speed = max(0.0, -before), max(T.load_speed[i], T.load_speed[j])
        entry.restitution_loss = 0.0 if elastic else -Jn * (0.5 * (before + after))
        entry.friction_loss = entry.stabilisation_gain = 0.0
        entry.normal_impulse, entry.arm_i, entry.arm_j = Jn, ri, rj
        entry.friction_x = entry.friction_y = entry.friction_z = 0.0
        set_angular_impulse(entry, 0.0, 0.0, 0.0)
        x, y, z = centre(i, T)
        entry.x, entry.y, entry.z = x + ri * nx, y + ri * ny, z + ri * nz
        if is_sheared(T.box):
            entry.x, entry.y, entry.z = nearest_in_drift(entry.x, entry.y, entry.z, T.box, clock)
        entry.vix, entry.viy, entry.viz = velocity(i, T)
        entry.vjx, entry.vjy, entry.vjz = velocity(j, T)
    if not elastic:
        _book_where_energy_is_lost(first, row, T, log)
    return row


@inner
def _book_where_energy_is_lost(first: int, last: int, T: Trajectories, log: RecordArray[ImpactRecord]) -> None:
    """Move losses of elastic contacts in the rows [first, last) to the other contacts, in proportion to impulses."""
    lost, impulse, n = 0.0, 0.0, len(T.x)
    for row in range(first, last):
        if dissipates(T.materials[material_index(log[row].i, log[row].j, n, T.places)]):
            impulse += log[row].normal_impulse
        else:
            lost += log[row].restitution_loss
    if lost == 0.0 or impulse == 0.0:
        return
    for row in range(first, last):
        if dissipates(T.materials[material_index(log[row].i, log[row].j, n, T.places)]):
            log[row].restitution_loss += lost * (log[row].normal_impulse / impulse)
        else:
            log[row].restitution_loss = 0.0
