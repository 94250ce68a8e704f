"""The steps after an iteration: a line search, and conjugate gradients where iterations converge too slowly.

**Line search.** An iteration passes a load from contact to contact, but passes only a small fraction of the load
through a light body between heavy ones. Therefore the change s of all impulses in an iteration is repeated α times. α
minimises the energy that the solution minimises, and is limited so that no impulse is attractive (λ_n ≥ 0):

    α = -s·(v + c) / s·(A s),   v = (v_n, u) at the contacts, A s the change of v by the impulses s

Both products are sums over bodies, whose velocities and spins change by p and t when the impulses change by s:

    s·v = Σ m p·v + I t·ω,    s·A s = Σ m p² + I t²

A ball squeezed between two balls of 10⁹ times its mass then sinks by less than 10⁻¹¹ of its radius. Without the line
search, it sinks by 0.1 radii even at a mass ratio of 10² (docs/physics.md, section 9).

**Conjugate gradients.** After the iterations it is usually known which contacts carry a load, and which loaded contacts
stick. For these contacts the conditions of `solve` become equations,

    v_n + c = 0,    u = 0        or  A s = -(v + c),  A = G M⁻¹ Gᵀ,

where s is the change of the impulses. Conjugate gradients (Hestenes & Stiefel 1952) solve them, preconditioned by the
diagonal of A. Contacts with attractive impulses are then released, and further Gauss-Seidel iterations determine again
which contacts carry a load (projected Gauss-Seidel with subspace minimisation; Silcowitz, Niebe & Erleben 2010b).

A stack of n spheres takes about n of these iterations, but about n² iterations of `solve`. The gain is as large for a
load on much lighter spheres.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import RecordArray
from carom.physics.aligned import CACHE_LINE
from carom.physics.contact.constraints import (
    BODIES_PER_BLOCK,
    BODY_STATE,
    ENOUGH,
    ConstraintSystem,
    body_count,
    contacts_of,
    ends_of,
)
from carom.physics.contact.geometry import smaller_arm
from carom.physics.contact.law import material_index, sticks
from carom.physics.contact.moving_walls import slope_on_wall
from carom.physics.contact.records import BlockSumsRecord, BodyStateRecord, PieceResultsRecord, SearchRecord
from carom.physics.contact.rolling import set_change_of_angular_impulse
from carom.physics.contact.solver.block import CHANGE, VELOCITY
from carom.physics.contact.solver.body_state import (
    accumulate_impulse,
    bias_of,
    change_of_velocity,
    half_turn_of,
    relative_velocity,
    slip,
)
from carom.physics.jit.decorators import inline, inner, kernel
from carom.physics.jit.instructions import Code, from_front, instruction
from carom.physics.jit.vectors import BIT, DOUBLE, WIDTH, Lanes, line_of, mask_of, spread
from carom.physics.sheared_box import slope_of_image

MOTION = 6  # fields of each line before masses and inertias: v and ω, or p and t

# The closing speed that the search may leave to a contact. It is chosen so that the columns of test_convergence.py stay
# upright. With a tenth of `REST_TOLERANCE`, cloud-collapse takes twice as long, and its errors change by less than a
# tenth.
INTOLERABLE = 10.0  # factor on the tolerated closing speed above which the search starts
REST_TOLERANCE = 0.3  # tolerated closing speed, as a fraction of the rest speed
APPROACH_TOLERANCE = 0.03  # tolerated closing speed, as a fraction of the impact's closing speed
RADIUS_TOLERANCE = 3e-5  # tolerated closing speed, in smaller radii per step
# Rejected: 10⁻³ in meshed islands. A falling heap of 1000 (benchmarks/heap.py) is then computed 1.1 times as fast, with
# the same overlaps, but at rest its steps take 1.7 times as long.
# Ratio of masses from which the slip of a sticking contact counts, too. A light ball that rolls between a floor and a
# ball of 10⁶ times its mass moved at 3 m/s instead of 0.5 m/s. Rejected: any ratio. The steps of heaps, drum and hopper
# then take 2.4 to 3 times as long, those of piston 6 times, to end slips that no later step remembers.
UNEVEN = 100.0
DEEP = 5e-3  # overlap, in smaller radii, of a resting contact that has been sinking for many steps
DEEP_TOLERANCE = 1e-2  # tolerated closing speed of a deep contact, relative to the rest speed


@inner
def line_search(first: int, end: int, system: ConstraintSystem) -> None:
    """Sum m p·v + I t·ω, and m p² + I t², over each given block of bodies."""
    for block in range(first, end):
        _sum_up(block, system)


@inline
def _sum_up(block: int, system: ConstraintSystem) -> None:
    active, slope, curvature = system.active, 0.0, 0.0
    for k in range(block * BODIES_PER_BLOCK, min(len(active), (block + 1) * BODIES_PER_BLOCK)):
        body = system.bodies[from_front(active[k])]
        px, py, pz, m = body.dvx, body.dvy, body.dvz, body.mass
        slope += (px * body.vx + py * body.vy + pz * body.vz) * m
        curvature += (px * px + py * py + pz * pz) * m
        tx, ty, tz, inertia = body.dwx, body.dwy, body.dwz, body.inertia
        slope += (tx * body.wx + ty * body.wy + tz * body.wz) * inertia
        curvature += (tx * tx + ty * ty + tz * tz) * inertia
    sums = system.sums[block]
    sums.slope, sums.curvature = slope, curvature


@inner
def step_length(piece_results: RecordArray[PieceResultsRecord], sums: RecordArray[BlockSumsRecord]) -> float:
    """Return α; 0 if repeating the change would not help."""
    slope, curvature, step_limit = 0.0, 0.0, np.inf
    for k in range(len(piece_results)):
        slope += piece_results[k].slope
        step_limit = min(step_limit, piece_results[k].step_limit)
    for k in range(len(sums)):
        slope += sums[k].slope
        curvature += sums[k].curvature
    if slope >= 0.0 or curvature <= 0.0:
        return 0.0
    return min(-slope / curvature, step_limit)


@inner
def extrapolate(first: int, end: int, system: ConstraintSystem) -> None:
    """Change the velocities in some blocks of bodies by α p and α t, and clear p and t."""
    alpha, active = system.settings[0].alpha, system.active
    for k in range(first * BODIES_PER_BLOCK, min(len(active), end * BODIES_PER_BLOCK)):
        repeat_change(system.bodies, from_front(active[k]), alpha)


assert (BODY_STATE.names or ())[MOTION] == "inverse_mass"


@inline
def _repeat_each(bodies: RecordArray[BodyStateRecord], body: int, alpha: float) -> None:
    b = bodies[body]
    b.vx, b.vy, b.vz = b.vx + b.dvx * alpha, b.vy + b.dvy * alpha, b.vz + b.dvz * alpha
    b.wx, b.wy, b.wz = b.wx + b.dwx * alpha, b.wy + b.dwy * alpha, b.wz + b.dwz * alpha
    b.dvx = b.dvy = b.dvz = b.dwx = b.dwy = b.dwz = 0.0


@instruction(_repeat_each, body="intp", alpha="float64")
def repeat_change(code: Code, bodies: Any, body: Any, alpha: Any) -> None:
    """Add α p to v and α t to ω of a body, and clear p and t (``dvx`` to ``dwz``).

    A vector holds one line of the record. Changing the six fields one by one took twice as long, and made a step of
    `cloud-collapse` 1.4 % longer.
    """
    builder, record = code.builder, code.element("bodies", body)
    lines = [line_of(builder, record, line) for line in (VELOCITY, CHANGE)]
    velocity, change = (Lanes(builder, builder.load(line, align=CACHE_LINE)) for line in lines)
    moves = mask_of(builder, [BIT(field < MOTION) for field in range(WIDTH)])
    moved = velocity + change * spread(builder, alpha)
    builder.store(moved.where(moves, velocity).value, lines[0], align=CACHE_LINE)
    builder.store(spread(builder, DOUBLE(0.0)).where(moves, change).value, lines[1], align=CACHE_LINE)


@inner
def measure_violation(first: int, end: int, system: ConstraintSystem) -> None:
    """Compute by how much (m/s) each piece's worst contact exceeds its tolerance; 0 within the tolerance."""
    for piece in range(first, end):
        system.piece_results[piece].residual = _violation(piece, system)


@inline
def _violation(piece: int, system: ConstraintSystem) -> float:
    lo, hi = contacts_of(piece, piece + 1, system)
    settings = system.settings[0]
    drift, tolerance, negligible = settings.drift, settings.tolerance, settings.negligible
    count = body_count(system)
    excess = 0.0
    for c in range(lo, hi):
        if not system.held[c] or (settings.ignores_meshed and system.enough[c] > ENOUGH):
            continue
        i, j = ends_of(system.pairs, c)
        contact, state = system.contacts[c], system.states[c]
        vn, ux, uy, uz = relative_velocity(contact, system.bodies[i], system.bodies[j])
        bias = bias_of(contact, j < count, ux, uy, uz, drift)
        missed = -(vn + bias)
        if contact.normal_impulse > 0.0:
            missed = abs(missed)
        small = smaller_arm(contact)
        # before a drift, approach_speed is still the value of the previous step, which checkpoints do not store
        approach = 0.0 if drift > 0.0 else state.approach_speed
        allowed = tolerated(system.load_speed[c], approach, state.overlap / small, small / settings.dt)
        most = tolerance * allowed + negligible
        if settings.is_lenient and system.enough[c] > ENOUGH:
            most = max(most, system.load_speed[c])
        excess = max(excess, missed - most)
        if settings.spins and _is_uneven(system.bodies[i].inverse_mass, system.bodies[j].inverse_mass):
            tx, ty, tz = contact.friction_x, contact.friction_y, contact.friction_z
            material = system.materials[material_index(i, j, count, system.places)]
            if sticks(material, contact.normal_impulse, tx, ty, tz):
                body_i, body_j = system.bodies[i], system.bodies[j]
                qx, qy, qz = half_turn_of(contact, body_i, body_j, j < count, ux, uy, uz, drift)
                ux, uy, uz = slip(contact, body_i, body_j, ux, uy, uz)
                sx, sy, sz = ux - qx, uy - qy, uz - qz
                excess = max(excess, np.sqrt(sx * sx + sy * sy + sz * sz) - most)
    return excess


@inline
def _is_uneven(one: float, other: float) -> bool:
    """Return whether two inverse masses (1/kg) of moving bodies differ so much that sweeps alone find no friction."""
    return bool(0.0 < min(one, other) < max(one, other) / UNEVEN)


@kernel
def tolerated(load_speed: float, approach: float, depth: float, radius_per_step: float) -> float:
    """Return the closing speed (m/s) that the search may leave to a contact.

    Parameters
    ----------
    load_speed, approach
        Load speed and closing speed of the contact, m/s.
    depth
        Overlap relative to the smaller radius.
    radius_per_step
        Smaller radius divided by dt, m/s.
    """
    if approach <= load_speed and depth > DEEP:
        return DEEP_TOLERANCE * load_speed
    return min(max(REST_TOLERANCE * load_speed, APPROACH_TOLERANCE * approach), RADIUS_TOLERANCE * radius_per_step)


@inner
def conjugate_step(first: int, end: int, system: ConstraintSystem) -> None:
    """Move by α along the direction; compute the residual r = -(v + c), and the sum of r z with z = r / diag(A)."""
    settings = system.settings[0]
    alpha = settings.alpha
    for piece in range(first, end):
        lo, hi = contacts_of(piece, piece + 1, system)
        results = system.piece_results[piece]
        if settings.iteration == 0:
            results.is_exact = begin_search(lo, hi, system)
        norm, exact_norm, most, least = 0.0, 0.0, 0.0, 0.0
        if _is_left(results, system):
            hi = lo
        for c in range(lo, hi):
            search, contact = system.search[c], system.contacts[c]
            if not _is_searched(c, search, system):
                continue
            if settings.iteration > 0:
                search.step_normal += alpha * search.direction_normal
                search.step_x += alpha * search.direction_x
                search.step_y += alpha * search.direction_y
                search.step_z += alpha * search.direction_z
                i, j = ends_of(system.pairs, c)
                pn, px, py, pz = change_of_velocity(contact, system.bodies[i], system.bodies[j])
                if search.free_normal:
                    search.residual_normal -= alpha * pn
                if search.free_tangent:
                    search.residual_x -= alpha * px
                    search.residual_y -= alpha * py
                    search.residual_z -= alpha * pz
            impulse = contact.normal_impulse + search.step_normal
            most, least = max(most, impulse), min(least, impulse)
            rx, ry, rz = search.residual_x, search.residual_y, search.residual_z
            of_normal = search.residual_normal * search.residual_normal * contact.normal_mass
            of_tangent = (rx * rx + ry * ry + rz * rz) * contact.tangent_mass
            norm += of_normal
            norm += of_tangent
            if system.enough[c] <= ENOUGH:
                exact_norm += of_normal
                exact_norm += of_tangent
        results.residual_norm, results.exact_norm = norm, exact_norm
        results.largest_push, results.largest_pull = most, -least


@inline
def _is_searched(c: int, search: SearchRecord, system: ConstraintSystem) -> bool:
    """Return whether the search continues for a contact: it has free impulses, in an island that is still searched."""
    if not (search.free_normal or search.free_tangent):
        return False
    return not (system.settings[0].ignores_meshed and system.enough[c] > ENOUGH)


@inline
def _is_left(results: PieceResultsRecord, system: ConstraintSystem) -> bool:
    """Return whether the search has ended for all contacts of a piece, in all of its islands.

    In a drum with 10⁴ spheres, half of the iterations serve only ten contacts.
    """
    return bool(system.settings[0].ignores_meshed and not results.is_exact)


@inner
def begin_search(lo: int, hi: int, system: ConstraintSystem) -> bool:
    """Determine the free impulses: λ_n of contacts that carry a load or are closing, and λ_t of contacts that stick.

    Return whether the search continues for any of the contacts when it leaves meshed islands.
    """
    spins, drift = system.settings[0].spins, system.settings[0].drift
    count, places, is_exact = body_count(system), system.places, False
    for c in range(lo, hi):
        search, contact = system.search[c], system.contacts[c]
        search.step_normal = search.step_x = search.step_y = search.step_z = 0.0
        search.direction_normal = search.direction_x = search.direction_y = search.direction_z = 0.0
        search.residual_normal = search.residual_x = search.residual_y = search.residual_z = 0.0
        search.velocity_bias, search.free_normal, search.free_tangent = 0.0, False, False
        if not system.held[c]:
            continue
        i, j = ends_of(system.pairs, c)
        body_i, body_j = system.bodies[i], system.bodies[j]
        vn, ux, uy, uz = relative_velocity(contact, body_i, body_j)
        bias = bias_of(contact, j < count, ux, uy, uz, drift)
        search.velocity_bias = bias
        if contact.normal_impulse > 0.0 or vn + bias <= 0.0:
            search.free_normal, search.residual_normal = True, -(vn + bias)
        if spins:
            tx, ty, tz = contact.friction_x, contact.friction_y, contact.friction_z
            material = system.materials[material_index(i, j, count, places)]
            if sticks(material, contact.normal_impulse, tx, ty, tz):
                qx, qy, qz = half_turn_of(contact, body_i, body_j, j < count, ux, uy, uz, drift)
                ux, uy, uz = slip(contact, body_i, body_j, ux, uy, uz)
                search.free_tangent = True
                search.residual_x, search.residual_y, search.residual_z = qx - ux, qy - uy, qz - uz
        is_exact |= system.enough[c] <= ENOUGH and (search.free_normal or search.free_tangent)
    return is_exact


@inner
def conjugate_direction(first: int, end: int, system: ConstraintSystem) -> None:
    """Update the direction, d = z + β d, and sum the changes p and t of the bodies' velocities along it."""
    for piece in range(first, end):
        if not _is_left(system.piece_results[piece], system):
            _add_direction(piece, system)


@inline
def _add_direction(piece: int, system: ConstraintSystem) -> None:
    lo, hi = contacts_of(piece, piece + 1, system)
    spins, beta = system.settings[0].spins, system.settings[0].beta
    for c in range(lo, hi):
        search, contact = system.search[c], system.contacts[c]
        if _is_searched(c, search, system):
            normal = contact.normal_mass * search.residual_normal + beta * search.direction_normal
            dx = contact.tangent_mass * search.residual_x + beta * search.direction_x
            dy = contact.tangent_mass * search.residual_y + beta * search.direction_y
            dz = contact.tangent_mass * search.residual_z + beta * search.direction_z
            search.direction_normal = normal
            search.direction_x, search.direction_y, search.direction_z = dx, dy, dz
            i, j = ends_of(system.pairs, c)
            body_i, body_j = system.bodies[i], system.bodies[j]
            accumulate_impulse(contact, body_i, body_j, spins, normal, dx, dy, dz)


@inner
def project(first: int, end: int, system: ConstraintSystem) -> None:
    """Release contacts with attractive impulses; store the remaining change of the impulses for a line search."""
    for piece in range(first, end):
        _project(piece, system)


@inline
def _project(piece: int, system: ConstraintSystem) -> None:
    lo, hi = contacts_of(piece, piece + 1, system)
    spins, drift, count, slope = system.settings[0].spins, system.settings[0].drift, body_count(system), 0.0
    for c in range(lo, hi):
        search, contact = system.search[c], system.contacts[c]
        if contact.normal_impulse + search.step_normal < 0.0:
            contact.delta_normal, contact.delta_x = -contact.normal_impulse, -contact.friction_x
            contact.delta_y, contact.delta_z = -contact.friction_y, -contact.friction_z
        else:
            contact.delta_normal, contact.delta_x = search.step_normal, search.step_x
            contact.delta_y, contact.delta_z = search.step_y, search.step_z
        set_change_of_angular_impulse(contact, 0.0, 0.0, 0.0)  # the search does not change angular impulses
        if system.held[c]:
            normal = contact.delta_normal
            slope += normal * search.velocity_bias
            i, j = ends_of(system.pairs, c)
            body_i, body_j = system.bodies[i], system.bodies[j]
            tx, ty, tz = contact.delta_x, contact.delta_y, contact.delta_z
            slope = slope_on_wall(contact, slope, tx, ty, tz)
            if spins:
                _, ux, uy, uz = relative_velocity(contact, body_i, body_j)
                qx, qy, qz = half_turn_of(contact, body_i, body_j, j < count, ux, uy, uz, drift)
                slope -= tx * qx + ty * qy + tz * qz
            nx, ny, nz = contact.nx, contact.ny, contact.nz
            slope = slope_of_image(contact, slope, normal * nx + tx, normal * ny + ty, normal * nz + tz)
            accumulate_impulse(contact, body_i, body_j, spins, normal, tx, ty, tz)
    results = system.piece_results[piece]
    results.step_limit, results.slope = 1.0, slope
