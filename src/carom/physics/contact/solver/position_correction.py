"""Position correction: overlapping bodies at rest are pushed apart, without a velocity along the normal.

A pair is pushed by δ along n. Each body moves in proportion to its inverse mass, so the centre of mass stays. That
alone would change the angular momentum by μ δ n × v_t (μ the reduced mass, v_t the tangential relative velocity of the
centres). Scaling v_t by d/(d + δ) conserves it:

    (d + δ) n × (v_t d/(d + δ)) = d n × v_t

This is `contact.stabilisation = "split"`. With `"baumgarte"` the pipeline asks `impacts` and `prepare` for a velocity
bias instead, `BAUMGARTE` of the overlap per step.

Only contacts at rest are pushed. An impact separates by its rebound, and pushing it would take tangential energy from a
gas at every collision.

The ledger books the change of the energy: the scaling exactly, at the velocities of the half kick, and the potential as
the work against gravity at the new positions. This work has an error of (δ/d)² of the pair's potential.

Rejected: the mean of the forces at the start and the end of the step, which is of the next order. In the collapse of
500 boulders both have errors of 10⁻⁶ of the energy scale.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.constraints import ConstraintSystem, contacts_of, ends_of
from carom.physics.contact.geometry import normal_and_distance
from carom.physics.contact.law import LAW, material_index
from carom.physics.parallel.index import from_front
from carom.physics.parallel.jit import inline, kernel, long_kernel, unowned
from carom.physics.parallel.prefetch import AHEAD, prefetch
from carom.physics.periodic_box import nearest_image
from carom.physics.vector import add, between, vector

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

BAUMGARTE = 0.2  # part of the overlap that the bias removes in a step
# Of the rest speed; contacts that separate faster are not pushed. 1 also pushes slow rebounds (10 times the energy in
# the worst step); 0 leaves overlaps in a pile (a quarter of a radius while it forms).
MAX_SEPARATION = 0.1
NEVER = -2  # in place of the iteration in which a body was last pushed
ENOUGH = 1e-9  # of the sum of radii; smaller overlaps need no further iteration
ENOUGH_AS_NEEDED = 1e-5  # the same with sweeps as needed and quick ones; the next step has one iteration for them


@kernel
def count_contacts(pairs: IntArray, counts: IntArray) -> None:
    """Count the contacts of each body and plane.

    By one thread: of 40 000 contacts it takes 40 µs, and two threads with atomic additions 250.
    """
    counts[:] = 0
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        counts[i] += 1
        counts[j] += 1


@long_kernel
def find_push_fractions(lo: int, hi: int, pairs: IntArray, counts: IntArray, states: Records, pushed: IntArray) -> None:
    """Find the part of each overlap that an iteration removes: 1 / (contacts of the end that has fewer).

    Also note that no body was ``pushed`` yet.

    Removing whole overlaps pushes each body into the next. A compressed pile then never comes to rest, and in a falling
    stack of 500 balls every other contact keeps an overlap of 0.24 r in place of 0.06 r.
    """
    for c in range(from_front(lo), hi):
        i, j = ends_of(pairs, c)
        states[c].push_fraction = 1.0 / min(counts[i], counts[j])
        pushed[i] = pushed[j] = NEVER


@unowned
def correct_positions(first: int, end: int, system: ConstraintSystem) -> None:
    """Push the resting contacts of some pieces apart once; note whether an overlap needs another iteration.

    Here a contact is at rest if it separates no faster than a tenth of the rest speed, or approaches without a rebound.
    Later iterations visit only contacts of which the last one pushed an end; the others still do not overlap.
    """
    for piece in range(first, end):
        system.found[piece].residual = _correct(piece, system)


@inline
def _correct(piece: int, system: ConstraintSystem) -> float:
    """Push the resting contacts of a piece apart; return 1 if an overlap needs another iteration, otherwise 0."""
    lo, hi = contacts_of(piece, piece + 1, system)
    pairs, x, v = system.pairs, system.position, system.velocity
    inverse_mass, places = system.inverse_mass, system.places
    n, last, again = len(x), len(pairs) - 1, 0.0
    iteration, pushed = system.settings[0].iteration, system.island
    enough = ENOUGH_AS_NEEDED if system.settings[0].as_needed else ENOUGH
    for c in range(lo, hi):
        i, j = ends_of(pairs, c)
        if iteration > 0 and max(pushed[i], pushed[j]) < iteration - 1:
            continue
        next_i, next_j = ends_of(pairs, from_front(min(last, c + AHEAD)))
        prefetch(x, next_i, 0)
        prefetch(x, min(n - 1, next_j), 0)
        nx, ny, nz, d, reach = _geometry(i, j, system)
        overlap = reach - d
        if overlap <= 0.0:
            continue
        state = system.states[c]
        vx, vy, vz = between(v, i, j)
        vn = vx * nx + vy * ny + vz * nz
        material = system.materials[material_index(i, j, n, places)]
        rebounds = LAW.restitution(material, -vn, state.rest_speed) > 0.0
        if vn > MAX_SEPARATION * state.rest_speed or rebounds:
            continue
        if overlap > enough * reach:
            again = 1.0
        delta = state.push_fraction * overlap
        mi = inverse_mass[i] / (inverse_mass[i] + inverse_mass[j])  # parts of the push
        mj = inverse_mass[j] / (inverse_mass[i] + inverse_mass[j])
        if mi > 0.0:
            pushed[i] = iteration
            add(x, i, -mi * delta, nx, ny, nz)
        if mj > 0.0:
            pushed[j] = iteration
            add(x, j, mj * delta, nx, ny, nz)
        state.push_x += delta * nx
        state.push_y += delta * ny
        state.push_z += delta * nz
        if j < n:  # a plane absorbs any angular momentum
            tx, ty, tz = vx - vn * nx, vy - vn * ny, vz - vn * nz
            _scale_tangential_velocity(c, d / (d + delta) - 1.0, mi, mj, tx, ty, tz, system)
    return again


@inline
def _geometry(i: int, j: int, system: ConstraintSystem) -> tuple[float, float, float, float, float]:
    """Return the normal, the distance of the centres or from the plane, and the distance at which they touch, in m."""
    x, box, radius, n = system.position, system.box, system.radius, len(system.position)
    if j >= n:
        sx, sy, sz = vector(system.surface, j - n)
        px, py, pz = vector(x, i)
        return -sx, -sy, -sz, sx * px + sy * py + sz * pz - system.offset[j - n], radius[i]
    dx, dy, dz = between(x, i, j)
    if box[0] > 0.0:
        dx, dy, dz = nearest_image(dx, dy, dz, box[0], box[1], box[2])
    nx, ny, nz, d = normal_and_distance(dx, dy, dz)
    return nx, ny, nz, d, radius[i] + radius[j]


@inline
def _scale_tangential_velocity(
    c: int, scale: float, mi: float, mj: float, tx: float, ty: float, tz: float, system: ConstraintSystem
) -> None:
    """Change v_t of two bodies by a part of it, and book the energy.

    Parameters
    ----------
    scale
        d/(d + δ) - 1, the part.
    mi, mj
        Part of each body.
    tx, ty, tz
        m/s, v_t.
    """
    (i, j), v = ends_of(system.pairs, c), system.velocity
    reduced = 1.0 / (system.inverse_mass[i] + system.inverse_mass[j])
    system.states[c].stabilisation_gain += 0.5 * reduced * (tx * tx + ty * ty + tz * tz) * scale * (2.0 + scale)
    if mi > 0.0:
        add(v, i, -mi * scale, tx, ty, tz)
    if mj > 0.0:
        add(v, j, mj * scale, tx, ty, tz)
    if len(system.recorded) > 0:
        given = system.recorded[c]
        given.correction_x += reduced * scale * tx
        given.correction_y += reduced * scale * ty
        given.correction_z += reduced * scale * tz


@long_kernel
def audit_corrections(
    lo: int, hi: int, pairs: IntArray, acceleration: FloatArray, inverse_mass: FloatArray, states: Records
) -> None:
    """Book the change of the potential energy by the pushes, -μ (a_j - a_i)·Σ δ n, in J."""
    a = acceleration
    for c in range(from_front(lo), hi):
        (i, j), state = ends_of(pairs, c), states[c]
        reduced = 1.0 / (inverse_mass[i] + inverse_mass[j])
        ax, ay, az = a[j, 0] - a[i, 0], a[j, 1] - a[i, 1], a[j, 2] - a[i, 2]
        work = ax * state.push_x + ay * state.push_y + az * state.push_z
        state.stabilisation_gain -= reduced * work
