"""Load speeds: the largest speed with which a contact at rest may close in a step, whatever its direction.

A contact at rest closes no faster than the acceleration of gravity can make it in one step. The bodies of an island
share its load, so the largest acceleration in the whole island determines the load speed: in the middle of a pile,
nothing accelerates, but the load is greatest. An island is a connected component of the collision graph without fixed
ends; other islands have no influence. The uniform field accelerates all bodies alike, so it is subtracted, unless some
body or plane is fixed and does not fall. Without gravity, the load speed is 0, and every contact is an impact. The rest
speed of a contact, its restitution threshold, is at most its load speed (`loads`).

Islands are found by union-find: each island is a tree whose root is its lowest body (Galler & Fischer 1964).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.physics.contact.constraints import (
    ENOUGH_AS_NEEDED,
    MIN_PER_TASK,
    ConstraintSystem,
    ends_of,
)
from carom.physics.contact.geometry import are_near
from carom.physics.contact.solids import tangent_plane
from carom.physics.jit.decorators import inline, inner, kernel, long_kernel
from carom.physics.jit.instructions import atomic_load, atomic_max, atomic_replace, from_front
from carom.physics.jit.team import Team
from carom.physics.vector import between, sizes, vector
from carom.scene.rest_speed import PER_STEP

if TYPE_CHECKING:
    from carom.physics.contact.events.trajectories import Trajectories

MESHED = 1.5  # contacts per body above which an island is meshed; a column or arch has about one, a heap two to three
MOST_EXACT = 1024  # number of contacts up to which an island converges in every step

UNEQUAL, PRESSES = range(2)  # flags: accelerations of bodies differ; a contact has a load speed


class Islands:
    """Finds the island and the load speed of each contact; keeps its tables from step to step.

    Threads join islands at the same time. The root is the lowest body in any case, so the result does not depend on the
    order of the threads.

    Parameters
    ----------
    ends
        Number of bodies and planes.
    team
        Threads that share the work.
    """

    def __init__(self, ends: int, team: Team) -> None:
        self._team = team
        self._parent = np.empty(ends, dtype=np.int64)  # these arrays are used only for bodies with contacts
        self._largest = np.empty(ends)  # m²/s⁴, |a|² of each body; at an island's root, the largest in the island

    def write_load_speeds(
        self,
        pairs: IntArray,
        active: IntArray,
        acceleration: FloatArray,
        inverse_mass: FloatArray,
        field: FloatArray,
        dt: float,
        speeds: FloatArray,
    ) -> bool:
        """Write the load speed of each contact, `PER_STEP` |a|max dt of its island.

        If two bodies that rest on each other are at rest when a step starts, their closing speed at its end is at most
        the load speed.

        Parameters
        ----------
        pairs
            (m, 2) contacts.
        active
            (b,) bodies and planes that have a contact.
        acceleration
            (n + p, 3) m/s², including the uniform field.
        inverse_mass
            (n + p,) 1/kg; fixed ends do not transmit load.
        field
            (3,) m/s², the uniform field if it accelerates all bodies alike; otherwise zeros.
        speeds
            (m,) m/s, is written.

        Returns
        -------
        presses
            Whether any speed is not 0.
        """
        team, parent, largest = self._team, self._parent, self._largest
        flags = np.zeros(2, dtype=np.bool_)
        tables = parent, largest, flags
        team.divide(len(active), MIN_PER_TASK, _stand_alone, active, acceleration, inverse_mass, field, tables)
        if flags[UNEQUAL]:
            team.divide(len(pairs), MIN_PER_TASK, _join, pairs, inverse_mass, parent)
            team.divide(len(active), MIN_PER_TASK, _spread_largest, active, parent, largest.view(np.int64))
        joined = bool(flags[UNEQUAL])
        team.divide(len(pairs), MIN_PER_TASK, _write_speeds, pairs, inverse_mass, tables, joined, dt, speeds)
        return bool(flags[PRESSES])


@kernel
def mark_meshed(
    pairs: IntArray, active: IntArray, inverse_mass: FloatArray, parent: IntArray, counts: IntArray, enough: FloatArray
) -> None:
    """Write `ENOUGH_AS_NEEDED` for the contacts of large islands with many contacts per body.

    A load has many paths through such islands, so sweeps converge fast, and contact forces have no unique solution.

    Parameters
    ----------
    pairs, active, inverse_mass
        As in `ConstraintSystem`.
    parent, counts
        (n + p,) and (n + p, 2), workspaces: the tree of each island, and the bodies and contacts at its root.
    enough
        (m,), already has the values of the other contacts; see `ConstraintSystem`.
    """
    for k in range(len(active)):
        parent[active[k]] = active[k]
        counts[active[k], 0] = counts[active[k], 1] = 0
    join_islands(pairs, inverse_mass, parent)
    for k in range(len(active)):
        if inverse_mass[active[k]] > 0.0:
            counts[root_of(parent, active[k]), 0] += 1
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        counts[root_of(parent, i if inverse_mass[i] > 0.0 else j), 1] += 1
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        root = root_of(parent, i if inverse_mass[i] > 0.0 else j)
        if counts[root, 1] > MOST_EXACT and counts[root, 1] >= MESHED * counts[root, 0]:
            enough[c] = ENOUGH_AS_NEEDED


IslandTables = tuple[IntArray, FloatArray, BoolArray]
"""Parents (n + p,), see `root_of`; the largest |a|² (m²/s⁴) of the island of a root (n + p,); `UNEQUAL`, `PRESSES`."""


@inner
def write_load_speeds(system: ConstraintSystem, field: FloatArray, dt: float, tables: IslandTables) -> bool:
    """Write the load speed of each contact; see `Islands`."""
    pairs, active, inverse_mass = system.pairs, system.active, system.inverse_mass
    parent, largest, flags = tables
    flags[UNEQUAL] = flags[PRESSES] = False
    _stand_alone(0, len(active), active, system.acceleration, inverse_mass, field, tables)
    joined = flags[UNEQUAL]
    if joined:
        _join(0, len(pairs), pairs, inverse_mass, parent)
        _spread_largest(0, len(active), active, parent, largest.view(np.int64))
    _write_speeds(0, len(pairs), pairs, inverse_mass, tables, joined, dt, system.load_speed)
    return bool(flags[PRESSES])


@long_kernel
def _stand_alone(
    lo: int,
    hi: int,
    active: IntArray,
    acceleration: FloatArray,
    inverse_mass: FloatArray,
    field: FloatArray,
    tables: IslandTables,
) -> None:
    """Make each body an island; note in ``flags`` whether accelerations differ.

    If accelerations are equal, islands need not be joined.
    """
    parent, largest, flags = tables
    first = -1.0
    for k in range(len(active)):
        if inverse_mass[active[k]] > 0.0:
            first = excess_square(acceleration, field, active[k])
            break
    for k in range(lo, hi):
        i = active[k]
        parent[i], largest[i] = i, 0.0
        if inverse_mass[i] > 0.0:
            largest[i] = excess_square(acceleration, field, i)
            if largest[i] != first:
                flags[UNEQUAL] = True


@long_kernel
def _join(lo: int, hi: int, pairs: IntArray, inverse_mass: FloatArray, parent: IntArray) -> None:
    """Join the islands at the ends of each contact."""
    for c in range(lo, hi):
        i, j = ends_of(pairs, c)
        if inverse_mass[i] > 0.0 and inverse_mass[j] > 0.0:
            join_shared(parent, i, j)


@long_kernel
def _spread_largest(lo: int, hi: int, active: IntArray, parent: IntArray, largest: IntArray) -> None:
    """Write the largest |a|² of each island to its root; bit patterns of non-negative numbers sort like the numbers."""
    for k in range(lo, hi):
        i = active[k]
        island = root_of(parent, i)
        if largest[i] > atomic_load(largest, island):
            atomic_max(largest, island, largest[i])


@long_kernel
def _write_speeds(
    lo: int,
    hi: int,
    pairs: IntArray,
    inverse_mass: FloatArray,
    tables: IslandTables,
    joined: bool,
    dt: float,
    speeds: FloatArray,
) -> None:
    """Write the load speed of each contact; all contacts get the same speed if islands were not ``joined``."""
    parent, largest, flags = tables
    presses, speed = False, 0.0
    for c in range(lo, hi):
        if joined or c == lo:
            mover = pairs[c, 0] if inverse_mass[pairs[c, 0]] > 0.0 else pairs[c, 1]
            speed = PER_STEP * np.sqrt(largest[root_of(parent, mover)]) * dt
        speeds[c] = speed
        presses = presses or speed > 0.0
    if presses:
        flags[PRESSES] = True


@kernel
def excess_square(acceleration: FloatArray, field: FloatArray, i: int) -> float:
    """Return |a - field|² of a body, in m²/s⁴."""
    a2 = 0.0
    for k in range(3):
        a = acceleration[i, k] - field[k]
        a2 += a * a
    return a2


@kernel
def island_load_speeds(
    pairs: IntArray,
    T: Trajectories,
    scale: float,
    skin: float,
    acceleration: FloatArray,
    field: FloatArray,
    dt: float,
) -> None:
    """Write the load speed of each body, `PER_STEP` |a|max dt of its island, (n + p,) m/s.

    Pairs no farther apart than ``(r_i + r_j) scale + skin`` are joined, and so are all bodies near a guided wall. The
    load speed of fixed ends is 0. The queue of events, which is empty before a drift, serves as workspace.
    """
    x, radius, inverse_mass, speeds, parent, n = T.x, T.radius, T.inverse_mass, T.load_speed, T.queue, len(T.x)
    T.drift[0].loading = dt
    for i in range(n):
        parent[i] = i
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        if inverse_mass[i] == 0.0 or inverse_mass[j] == 0.0:
            continue
        dx, dy, dz = between(x, i, j)
        if are_near(dx, dy, dz, radius[i] + radius[j], sizes(T.box), scale, skin):
            join(parent, i, j)
    for i in range(n):
        speeds[i] = PER_STEP * np.sqrt(excess_square(acceleration, field, i)) * dt if inverse_mass[i] > 0.0 else 0.0
    for p in range(len(T.offset)):
        if inverse_mass[n + p] > 0.0:
            _join_through_wall(p, PER_STEP * np.sqrt(excess_square(acceleration, field, n + p)) * dt, scale, skin, T)
    for i in range(n):
        island = root_of(parent, i)
        speeds[island] = max(speeds[island], speeds[i])
    for i in range(n):
        speeds[i] = speeds[root_of(parent, i)]


@inline
def _join_through_wall(p: int, speed: float, scale: float, skin: float, T: Trajectories) -> None:
    """Join the bodies near a guided wall, and give them the wall's load speed (m/s); see `island_load_speeds`."""
    first = -1
    for i in range(len(T.x)):
        x, y, z = vector(T.x, i)
        nx, ny, nz, offset = tangent_plane(T.surface, T.offset, p, x, y, z)
        if nx * x + ny * y + nz * z - offset <= T.radius[i] * scale + skin:
            first = i if first < 0 else first
            join(T.queue, first, i)
            T.load_speed[i] = max(T.load_speed[i], speed)


@inner
def root_of(parent: IntArray, i: int) -> int:
    """Return the lowest body in the set of a body, and halve the path to it."""
    while parent[i] != i:
        parent[i] = parent[from_front(parent[i])]
        i = from_front(parent[i])
    return i


@inner
def join(parent: IntArray, i: int, j: int) -> None:
    """Join the sets of two bodies; the lower root becomes the parent of the higher one."""
    if parent[i] == parent[j]:  # the usual case in a heap
        return
    i, j = root_of(parent, i), root_of(parent, j)
    parent[max(i, j)] = min(i, j)


@inner
def join_shared(parent: IntArray, i: int, j: int) -> None:
    """Join the sets of two bodies while other threads join sets; the order does not change the roots."""
    i, j = root_of(parent, i), root_of(parent, j)
    while i != j and not atomic_replace(parent, max(i, j), max(i, j), min(i, j)):
        i, j = root_of(parent, i), root_of(parent, j)  # another thread may have moved one of the roots


@inline
def join_islands(pairs: IntArray, inverse_mass: FloatArray, parent: IntArray) -> None:
    """Join the sets of the bodies at the ends of each pair, unless one is fixed."""
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        if inverse_mass[i] > 0.0 and inverse_mass[j] > 0.0:
            join(parent, i, j)


@kernel
def number_sets(first: IntArray, second: IntArray, label: IntArray) -> int:
    """Write the number of each body's set, where pairs connect bodies; return the number of sets.

    Sets are numbered in the order of their lowest bodies.
    """
    for i in range(len(label)):
        label[i] = i
    for c in range(len(first)):
        join(label, first[c], second[c])
    count = 0
    for i in range(len(label)):
        if label[i] == i:
            label[i] = count
            count += 1
        else:  # the parent has a lower index, so it already has its number
            label[i] = label[label[i]]
    return count
