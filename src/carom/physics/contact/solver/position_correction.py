"""Position correction: overlapping bodies at rest are pushed apart, without a velocity along the normal.

A pair is pushed by δ along n. Each body moves in proportion to its inverse mass, so the centre of mass stays. That
alone would change the angular momentum by μ δ n × v_t (μ the reduced mass, v_t the tangential relative velocity of the
centres). Scaling v_t by d/(d + δ) conserves it:

    (d + δ) n × (v_t d/(d + δ)) = d n × v_t

This is `contact.stabilisation = "split"`. With `"baumgarte"` the pipeline asks `impacts` and `prepare` for a velocity
bias instead, `BAUMGARTE` of the overlap per step.

Only contacts at rest are pushed. An impact separates by its rebound, and pushing it would take tangential energy from a
gas at every collision.

The ledger books the change of the energy: the scaling exactly, at the velocities after the first kick, and the
potential as the work against gravity at the new positions. This work has an error of (δ/d)² of the pair's potential.

Rejected: the mean of the forces at the start and the end of the step, which is of the next order. In the collapse of
500 boulders both have errors of 10⁻⁶ of the energy scale.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.constraints import ConstraintSystem, body_count, contacts_of, ends_of
from carom.physics.contact.geometry import normal_and_distance
from carom.physics.contact.law import material_index, restitution
from carom.physics.contact.solver.block import whole_blocks
from carom.physics.contact.solver.body_state import prefetch_ends
from carom.physics.contact.solver.correct_block import correct_block
from carom.physics.contact.solver.overlap_push import (
    ENOUGH,
    ENOUGH_AS_NEEDED,
    gain_of,
    push_of,
    relative_change_of_vt,
    separates,
)
from carom.physics.contact.solver.velocity import velocity_along
from carom.physics.jit.decorators import inline, kernel, long_kernel, unowned
from carom.physics.jit.index import from_front
from carom.physics.jit.lanes import WIDTH
from carom.physics.vector import nearest_image, vector

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

BAUMGARTE = 0.2  # part of the overlap that the bias removes in a step


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
def find_push_fractions(lo: int, hi: int, pairs: IntArray, counts: IntArray, states: Records) -> None:
    """Find the part of each overlap that an iteration removes: 1 / (contacts of the end that has fewer).

    Removing whole overlaps pushes each body into the next. A compressed pile then never comes to rest, and in a falling
    stack of 500 balls every other contact keeps an overlap of 0.24 r in place of 0.06 r.
    """
    for c in range(from_front(lo), hi):
        i, j = ends_of(pairs, c)
        states[c].push_fraction = 1.0 / min(counts[i], counts[j])


@unowned
def correct_positions(first: int, end: int, system: ConstraintSystem) -> None:
    """Push the resting contacts of some pieces apart once; note whether an overlap needs another iteration.

    Here a contact is at rest if it separates no faster than a tenth of the rest speed, or approaches without a rebound.
    Later iterations visit only contacts of which the last one pushed an end. The others are as they were when they
    needed no push: they do not overlap, or are not at rest.
    """
    for piece in range(first, end):
        system.found[piece].residual = _correct(piece, system)


@inline
def _correct(piece: int, system: ConstraintSystem) -> float:
    """Push the resting contacts of a piece apart; return 1 if an overlap needs another iteration, otherwise 0.

    Contacts between bodies are corrected in blocks (`correct_block`), the others one by one.
    """
    lo, hi = contacts_of(piece, piece + 1, system)
    n, again = body_count(system), 0.0
    blocks = whole_blocks(piece, system) if system.box[0] == 0.0 else 0
    for block in range(blocks):
        first = lo + block * WIDTH
        again = correct_block(system, first, again)
        if len(system.surface) > 0:
            for c in range(first, first + WIDTH):
                if ends_of(system.pairs, c)[1] >= n:
                    again = max(again, _push_apart(c, system))
    for c in range(lo + blocks * WIDTH, hi):
        again = max(again, _push_apart(c, system))
    return again


@inline
def _push_apart(c: int, system: ConstraintSystem) -> float:
    """Push a contact apart if it is at rest; return 1 if its overlap needs another iteration, otherwise 0."""
    i, j = ends_of(system.pairs, c)
    iteration, pushed_in, n = system.settings[0].iteration, system.pushed_in, body_count(system)
    if iteration > 0 and max(pushed_in[i], pushed_in[j]) < iteration - 1:
        return 0.0
    prefetch_ends(system.pushed, system.pairs, c)
    state, a, b = system.states[c], system.pushed[i], system.pushed[j]
    nx, ny, nz, d, reach = _geometry(a, b, j - n, system)
    overlap = reach - d
    if overlap <= 0.0:
        return 0.0
    vn, tx, ty, tz = velocity_along(nx, ny, nz, a, b)
    material = system.materials[material_index(i, j, n, system.places)]
    if separates(vn, state.rest_speed, restitution(material, -vn, state.rest_speed)):
        return 0.0
    delta, mi, mj, reduced = push_of(state.push_fraction, overlap, a, b)
    if mi > 0.0:
        pushed_in[i] = iteration
        _move(a, -mi * delta, nx, ny, nz)
    if mj > 0.0:
        pushed_in[j] = iteration
        _move(b, mj * delta, nx, ny, nz)
    state.push_x += delta * nx
    state.push_y += delta * ny
    state.push_z += delta * nz
    if j < n:  # a plane absorbs any angular momentum
        sigma = relative_change_of_vt(d, delta)
        if mi > 0.0:
            _accelerate(a, -mi * sigma, tx, ty, tz)
        if mj > 0.0:
            _accelerate(b, mj * sigma, tx, ty, tz)
        _book(c, reduced, sigma, tx, ty, tz, system)
    return 1.0 if overlap > _enough(system) * reach else 0.0


@inline
def _book(c: int, reduced: float, sigma: float, tx: float, ty: float, tz: float, system: ConstraintSystem) -> None:
    """Book the energy, and if contacts are recorded the momentum, that scaling v_t moves."""
    system.states[c].stabilisation_gain += gain_of(reduced, tx, ty, tz, sigma)
    if len(system.recorded) > 0:
        given = system.recorded[c]
        given.correction_x += reduced * sigma * tx
        given.correction_y += reduced * sigma * ty
        given.correction_z += reduced * sigma * tz


@inline
def _enough(system: ConstraintSystem) -> float:
    """Return the overlap that needs no further iteration, over the sum of radii."""
    return ENOUGH_AS_NEEDED if system.settings[0].as_needed else ENOUGH


@inline
def _move(body: Any, s: float, nx: float, ny: float, nz: float) -> None:
    body.x, body.y, body.z = body.x + s * nx, body.y + s * ny, body.z + s * nz


@inline
def _accelerate(body: Any, s: float, tx: float, ty: float, tz: float) -> None:
    body.vx, body.vy, body.vz = body.vx + s * tx, body.vy + s * ty, body.vz + s * tz


@inline
def _geometry(a: Any, b: Any, plane: int, system: ConstraintSystem) -> tuple[float, float, float, float, float]:
    """Return the normal, the distance of the centres or from the plane, and the distance at which they touch, in m.

    ``plane`` is negative between two bodies.
    """
    box = system.box
    if plane >= 0:
        sx, sy, sz = vector(system.surface, plane)
        return -sx, -sy, -sz, sx * a.x + sy * a.y + sz * a.z - system.offset[plane], a.radius
    dx, dy, dz = b.x - a.x, b.y - a.y, b.z - a.z
    if box[0] > 0.0:
        dx, dy, dz = nearest_image(dx, dy, dz, box[0], box[1], box[2])
    nx, ny, nz, d = normal_and_distance(dx, dy, dz)
    return nx, ny, nz, d, a.radius + b.radius


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
