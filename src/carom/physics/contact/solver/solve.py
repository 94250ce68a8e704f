"""The iterations that find the impulses of contacts that last; `lasting` has the equations.

An iteration hands a load on from contact to contact, and where a light body lies between heavy ones it hands on very
little. So after each iteration the change s that it made of all impulses is made once more, α times, as far as that
brings the contacts nearer to what is asked (an exact line search, with A s the velocities at the contacts that impulses
s cause) and no contact begins to pull (λ_n ≥ 0):

    α = -s·(v + c) / s·(A s),   v the velocities at the contacts, v_n and u

Summed over bodies, with p and t the changes of their velocities and spins by s, that is

    s·v = Σ m p·v + I t·ω,    s·A s = Σ m p² + I t²

A ball squeezed between two that are 10⁹ times heavier is then held to 10⁻¹¹ of its radius. Iterations alone let it sink
by 0.1 radii at 10², and 100 of them at 10³. A stack of 20 that begins without impulses sags with 10⁻⁶ of the energy.
"""

from __future__ import annotations

import numpy as np

from carom.physics.contact.constraints import BODIES_PER_BLOCK, Constraints
from carom.physics.contact.law import material_index, within_friction_cone
from carom.physics.contact.solver.body_state import accumulate_push, accumulate_turn, apply_impulse, push, turn
from carom.physics.contact.solver.velocity import bias_along_arc, relative_velocity, slip
from carom.physics.parallel.jit import inner
from carom.physics.parallel.prefetch import AHEAD, prefetch_record

HELD = 1e-8  # the last iteration changes no velocity by more than this part of the largest that the contacts undo
LOADED = 1e-5  # how much the velocity counts that an impulse gives to the lightest body: rounding is 1e-16 of it


@inner
def prepare(lo: int, hi: int, piece: int, load: Constraints) -> None:
    """Write what does not change during the iterations, and v_n and u before them; leave impacts alone."""
    pairs, bodies = load.pairs, load.bodies
    settings = load.settings[0]
    spins = settings.spins
    dt, drift, kick, bias_rate = settings.dt, settings.drift, settings.kick, settings.bias_rate
    largest = 0.0  # m/s, the largest velocity that a contact undoes
    last = len(pairs) - 1
    for c in range(lo, hi):
        ahead = min(last, c + AHEAD)
        prefetch_record(bodies, pairs[ahead, 0], 0)
        prefetch_record(bodies, pairs[ahead, 1], 0)
        contact, state, body_i, body_j = load.contacts[c], load.states[c], bodies[pairs[c, 0]], bodies[pairs[c, 1]]
        Kn = body_i.inverse_mass + body_j.inverse_mass
        contact.normal_mass = 1.0 / Kn
        vn, tx, ty, tz = relative_velocity(contact, body_i, body_j)
        state.normal_before = vn
        if spins:
            ri, rj = contact.arm_i, contact.arm_j
            contact.tangent_mass = 1.0 / (Kn + ri * ri * body_i.inverse_inertia + rj * rj * body_j.inverse_inertia)
            state.slip_x, state.slip_y, state.slip_z = slip(contact, body_i, body_j, tx, ty, tz)
        gap, rest_speed = -state.overlap, state.rest_speed
        if drift > 0.0:
            bias = max(0.0, gap) / drift
            # at rest is what closes by no more than this kick has caused, and by what half a step's fall adds to that
            fastest = rest_speed * ((kick + 0.5 * drift) / dt)
        else:
            bias = gap / dt if gap > 0.0 else bias_rate * gap
            fastest = rest_speed if gap > 0.0 and state.apart else np.inf  # what touched has been resolved
        contact.velocity_bias, state.biased = bias, bias < 0.0
        load.held[c] = not -vn > fastest
        if load.held[c]:
            largest = max(largest, -vn, LOADED * contact.normal_impulse * Kn)
        else:
            contact.normal_impulse = contact.friction_x = contact.friction_y = contact.friction_z = 0.0
        contact.delta_normal = contact.delta_x = contact.delta_y = contact.delta_z = 0.0
    load.found[piece].residual = largest


@inner
def warm_start(lo: int, hi: int, load: Constraints) -> None:
    """Apply the impulses as they are."""
    pairs, bodies, spins = load.pairs, load.bodies, load.settings[0].spins
    last = len(pairs) - 1
    for c in range(lo, hi):
        ahead = min(last, c + AHEAD)
        prefetch_record(bodies, pairs[ahead, 0], 0)
        prefetch_record(bodies, pairs[ahead, 1], 0)
        contact, body_i, body_j = load.contacts[c], bodies[pairs[c, 0]], bodies[pairs[c, 1]]
        tx, ty, tz = contact.friction_x, contact.friction_y, contact.friction_z
        apply_impulse(contact, body_i, body_j, spins, contact.normal_impulse, tx, ty, tz)


@inner
def solve(lo: int, hi: int, piece: int, load: Constraints, turning: tuple[()] | tuple[int]) -> None:
    """Take contact after contact to where it neither closes nor pulls, at the velocities as they are.

    Parameters
    ----------
    turning
        Of one element where impulses turn bodies, empty elsewhere: the kernel is compiled for each.
    """
    pairs, bodies = load.pairs, load.bodies
    settings = load.settings[0]
    spins, alpha, drift = len(turning) > 0, settings.alpha, settings.drift
    count = len(bodies) - (len(load.materials) - 1)
    change, step_limit, slope = 0.0, np.inf, 0.0
    last = len(pairs) - 1
    for c in range(lo, hi):
        ahead = min(last, c + AHEAD)
        i, j = pairs[ahead, 0], pairs[ahead, 1]
        prefetch_record(bodies, i, 0)
        prefetch_record(bodies, i, 1)
        prefetch_record(bodies, j, 0)
        prefetch_record(bodies, j, 1)
        if not load.held[c]:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        contact, body_i, body_j = load.contacts[c], bodies[i], bodies[j]
        vn, ux, uy, uz = relative_velocity(contact, body_i, body_j)
        bias = contact.velocity_bias
        if drift > 0.0 and j < count:
            bias = bias_along_arc(bias, contact.arm_i + contact.arm_j, ux, uy, uz, drift)
        old = contact.normal_impulse + alpha * contact.delta_normal
        normal = max(0.0, old - (vn + bias) * contact.normal_mass)  # the total is clamped, not what is added
        more = normal - old
        contact.normal_impulse, contact.delta_normal = normal, more
        largest = abs(more)
        slope += more * bias
        if more < 0.0:
            step_limit = min(step_limit, -normal / more)
        Jx, Jy, Jz = more * contact.nx, more * contact.ny, more * contact.nz
        if spins:
            ux, uy, uz = slip(contact, body_i, body_j, ux, uy, uz)
            mt = contact.tangent_mass
            ox = contact.friction_x + alpha * contact.delta_x
            oy = contact.friction_y + alpha * contact.delta_y
            oz = contact.friction_z + alpha * contact.delta_z
            tx, ty, tz = ox - ux * mt, oy - uy * mt, oz - uz * mt
            material = load.materials[material_index(j, count)]
            tx, ty, tz = within_friction_cone(tx, ty, tz, normal, material.static_friction, material.kinetic_friction)
            dx, dy, dz = tx - ox, ty - oy, tz - oz
            contact.friction_x, contact.friction_y, contact.friction_z = tx, ty, tz
            contact.delta_x, contact.delta_y, contact.delta_z = dx, dy, dz
            largest = max(largest, abs(dx), abs(dy), abs(dz))
            Jx, Jy, Jz = Jx + dx, Jy + dy, Jz + dz
            turn(contact, body_i, body_j, dx, dy, dz)
            accumulate_turn(contact, body_i, body_j, dx, dy, dz)
        change = max(change, largest * (body_i.inverse_mass + body_j.inverse_mass))
        push(body_i, body_j, Jx, Jy, Jz)
        accumulate_push(body_i, body_j, Jx, Jy, Jz)
    found = load.found[piece]
    found.residual, found.step_limit, found.slope = change, step_limit, slope


@inner
def line_search(block: int, load: Constraints) -> None:
    """Sum m p·v + I t·ω, and m p² + I t², over a block of bodies."""
    spins, active = load.settings[0].spins, load.active
    slope, curvature = 0.0, 0.0
    for k in range(block * BODIES_PER_BLOCK, min(len(active), (block + 1) * BODIES_PER_BLOCK)):
        body = load.bodies[active[k]]
        if body.inverse_mass > 0.0:
            px, py, pz, m = body.dvx, body.dvy, body.dvz, 1.0 / body.inverse_mass
            slope += (px * body.vx + py * body.vy + pz * body.vz) * m
            curvature += (px * px + py * py + pz * pz) * m
        if spins and body.inverse_inertia > 0.0:
            tx, ty, tz, inertia = body.dwx, body.dwy, body.dwz, 1.0 / body.inverse_inertia
            slope += (tx * body.wx + ty * body.wy + tz * body.wz) * inertia
            curvature += (tx * tx + ty * ty + tz * tz) * inertia
    sums = load.sums[block]
    sums.slope, sums.curvature = slope, curvature


@inner
def extrapolate(block: int, load: Constraints) -> None:
    """Change the velocities of a block of bodies by α p and α t, and begin to sum those anew."""
    spins, alpha, active = load.settings[0].spins, load.settings[0].alpha, load.active
    for k in range(block * BODIES_PER_BLOCK, min(len(active), (block + 1) * BODIES_PER_BLOCK)):
        body = load.bodies[active[k]]
        body.vx += alpha * body.dvx
        body.vy += alpha * body.dvy
        body.vz += alpha * body.dvz
        body.dvx = body.dvy = body.dvz = 0.0
        if spins:
            body.wx += alpha * body.dwx
            body.wy += alpha * body.dwy
            body.wz += alpha * body.dwz
            body.dwx = body.dwy = body.dwz = 0.0
