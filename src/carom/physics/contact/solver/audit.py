"""The energy audit of resting contacts, and a bound on the energy that their impulses may add.

An impulse J removes -J·(v + v')/2, where v and v' are the velocities before and after it. After the first kick, a
second term is added. The work of the forces in the drift depends on velocities that include J, but half of this work
was already booked with the first kick, at velocities without J. The difference, J·Δv with Δv = (a_j - a_i) h, is booked
with the impulse:

    lost_n = -λ_n ((v_n + v_n')/2 - Δv_n),    lost_t = -λ_t·((u + u')/2 - Δu)        Δv = 0 after the last kick

For a body at rest, the entries of the two kicks then cancel.

Impulses that are still too large after the iterations are scaled down (`scale_back`). Impulses λ change the velocities
at the contacts from v to v' = v + A λ. The solution minimises

    f(λ) = λ·(v + c) + ½ λ·A λ,

which is 0 for λ = 0, and negative for impulses that remove energy. Iterations lower f, but they start from the impulses
of the previous kick, which may be far too large. Along θ λ, the minimum is at θ = -λ·(v + c) / λ·(v' - v). If θ < 1,
the impulses of the island are multiplied by θ. Then f ≤ 0, and contacts gain no energy over a whole step, since the
second kick starts from the impulses of the first kick. An island is a connected component of the collision graph
without fixed bodies and planes.

θ < 1 is rare, so the audit computes both sums in θ along the way (`measures`), and is repeated only if impulses were
scaled. In a falling heap of 1000 spheres, one audit in twenty is repeated; a separate pass for the sums took 5 % of
each step.
"""

from __future__ import annotations

from carom.physics.contact.constraints import ConstraintSystem, body_count, contacts_of, ends_of
from carom.physics.contact.islands import join_islands
from carom.physics.contact.law import exerts_torque
from carom.physics.contact.records import ContactRecord, ContactStateRecord
from carom.physics.contact.rolling import angular_impulse, relative_spin, set_angular_impulse, spin_before
from carom.physics.contact.solver.body_state import (
    change_by_field,
    half_turn_of,
    prefetch_ends,
    relative_velocity,
    slip,
)
from carom.physics.diagnostics.ledger import copy_terms
from carom.physics.jit.decorators import inline, inner
from carom.physics.vector import Vector


@inner
def audit(first: int, end: int, system: ConstraintSystem) -> None:
    """Book the energies of the impulses in some pieces, for each contact and in total."""
    for piece in range(first, end):
        _audit(piece, system)


@inline
def _audit(piece: int, system: ConstraintSystem) -> None:
    lo, hi = contacts_of(piece, piece + 1, system)
    pairs, a, bodies, count = system.pairs, system.acceleration, system.bodies, body_count(system)
    settings = system.settings[0]
    spins, measures = settings.spins, settings.measures
    booked = settings.booked if settings.drift > 0.0 else 0.0
    restitution, friction, stabilisation = 0.0, 0.0, 0.0
    for c in range(lo, hi):
        prefetch_ends(bodies, pairs, c)
        contact, state, measured = system.contacts[c], system.states[c], system.measured[c]
        if measures:
            measured.slope = measured.curvature = 0.0
            copy_terms(state, measured)
        Jn = contact.normal_impulse
        if Jn == 0.0:
            continue
        i, j = ends_of(pairs, c)
        body_i, body_j = bodies[i], bodies[j]
        vn, ux, uy, uz = relative_velocity(contact, body_i, body_j)
        kn, (kx, ky, kz) = change_by_field(contact, a, i, j, booked)
        if state.biased:  # without the bias, v_n' would be 0; the difference is the work of the bias
            lost = -Jn * (0.5 * state.normal_before - kn)
            state.stabilisation_gain += 0.5 * Jn * vn
            stabilisation += 0.5 * Jn * vn
        else:
            lost = -Jn * (0.5 * (state.normal_before + vn) - kn)
        state.restitution_loss += lost
        restitution += lost
        if measures:
            measured.slope, measured.curvature = normal_energies(contact, state, vn)
        if not spins:
            continue
        vx, vy, vz = ux, uy, uz
        ux, uy, uz = slip(contact, body_i, body_j, vx, vy, vz)
        # the slip in ``state`` is u - Δu
        lost = -0.5 * (
            contact.friction_x * (state.slip_x + ux - kx)
            + contact.friction_y * (state.slip_y + uy - ky)
            + contact.friction_z * (state.slip_z + uz - kz)
        )
        state.friction_loss += lost
        friction += lost
        if measures:
            kicked = state.slip_x + kx, state.slip_y + ky, state.slip_z + kz
            slope, curvature = friction_energies(contact, kicked, (ux, uy, uz))
            qx, qy, qz = half_turn_of(contact, body_i, body_j, j < count, vx, vy, vz, settings.drift)
            slope -= contact.friction_x * qx + contact.friction_y * qy + contact.friction_z * qz
            measured.slope += slope
            measured.curvature += curvature
        if exerts_torque(system.materials[0]):  # forces do no work on spins, so the second term is missing
            lx, ly, lz = angular_impulse(contact)
            before_x, before_y, before_z = spin_before(contact)
            wx, wy, wz = relative_spin(body_i, body_j)
            slope = lx * before_x + ly * before_y + lz * before_z
            curvature = lx * (wx - before_x) + ly * (wy - before_y) + lz * (wz - before_z)
            lost = -(slope + 0.5 * curvature)
            state.friction_loss += lost
            friction += lost
            if measures:
                measured.slope += slope
                measured.curvature += curvature
    results = system.piece_results[piece]
    results.restitution_loss, results.friction_loss, results.stabilisation_gain = restitution, friction, stabilisation


@inner
def scale_back(first: int, end: int, system: ConstraintSystem) -> None:
    """Scale the impulses of each island with θ < 1, and undo the audit; record whether any island was scaled."""
    settings = system.settings[0]
    if not settings.islands_known:
        _find_islands(system)
        settings.islands_known = True
    _sum_up_islands(system)
    settings.scaled_back = _find_scales(system)
    if settings.scaled_back:
        _take_back_audit(system)
        _scale_impulses(system)
        _scale_velocities(system)


@inline
def normal_energies(contact: ContactRecord, state: ContactStateRecord, vn: float) -> tuple[float, float]:
    """Return λ_n (v_n + c) and λ_n (v_n' - v_n), in J."""
    Jn = contact.normal_impulse
    return Jn * (state.normal_before + contact.velocity_bias), Jn * (vn - state.normal_before)


@inline
def friction_energies(contact: ContactRecord, before: Vector, after: Vector) -> tuple[float, float]:
    """Return λ_t·u and λ_t·(u' - u) in J, given u and u' in m/s."""
    tx, ty, tz = contact.friction_x, contact.friction_y, contact.friction_z
    (ux, uy, uz), (vx, vy, vz) = before, after
    slope = tx * ux + ty * uy + tz * uz
    return slope, tx * (vx - ux) + ty * (vy - uy) + tz * (vz - uz)


@inline
def _find_islands(system: ConstraintSystem) -> None:
    """Write the island of each body: the lowest body to which contacts connect it."""
    active, island = system.active, system.island
    for k in range(len(active)):
        island[active[k]] = active[k]
    join_islands(system.pairs, system.inverse_mass, island)
    for k in range(len(active)):  # in ascending order: a parent has a lower index, so its root is already known
        island[active[k]] = island[island[active[k]]]


@inline
def _island_of(c: int, system: ConstraintSystem) -> int:
    """Return the island of a contact: the island of an end that is not fixed."""
    i, j = ends_of(system.pairs, c)
    island: int = system.island[i if system.bodies[i].inverse_mass > 0.0 else j]
    return island


@inline
def _sum_up_islands(system: ConstraintSystem) -> None:
    """Sum λ·(v + c) and λ·(v' - v) over the contacts of each island."""
    for k in range(len(system.active)):
        whole = system.islands[system.active[k]]
        whole.slope = whole.curvature = 0.0
        whole.scale = 1.0
    for c in range(len(system.pairs)):
        whole, measured = system.islands[_island_of(c, system)], system.measured[c]
        whole.slope += measured.slope
        whole.curvature += measured.curvature


@inline
def _find_scales(system: ConstraintSystem) -> bool:
    """Find θ of each island, at most 1; return whether any θ is less than 1."""
    any_less = False
    for k in range(len(system.active)):
        whole = system.islands[system.active[k]]
        if -whole.slope < whole.curvature:  # both are 0 for a body that is not the root of its island
            whole.scale = max(0.0, -whole.slope / whole.curvature)
            any_less = True
    return any_less


@inline
def _take_back_audit(system: ConstraintSystem) -> None:
    for c in range(len(system.pairs)):
        copy_terms(system.measured[c], system.states[c])


@inline
def _scale_impulses(system: ConstraintSystem) -> None:
    for c in range(len(system.pairs)):
        contact, scale = system.contacts[c], system.islands[_island_of(c, system)].scale
        if scale < 1.0:
            contact.normal_impulse *= scale
            contact.friction_x *= scale
            contact.friction_y *= scale
            contact.friction_z *= scale
            lx, ly, lz = angular_impulse(contact)
            set_angular_impulse(contact, scale * lx, scale * ly, scale * lz)


@inline
def _scale_velocities(system: ConstraintSystem) -> None:
    """Scale the changes of velocities by the islands' factors; the arrays hold the velocities before the impulses."""
    v, omega = system.velocity, system.spin
    for k in range(len(system.active)):
        b = system.active[k]
        body, scale = system.bodies[b], system.islands[system.island[b]].scale
        if body.inverse_mass > 0.0 and scale < 1.0:
            body.vx = v[b, 0] + scale * (body.vx - v[b, 0])
            body.vy = v[b, 1] + scale * (body.vy - v[b, 1])
            body.vz = v[b, 2] + scale * (body.vz - v[b, 2])
            if len(omega) > 0:
                body.wx = omega[b, 0] + scale * (body.wx - omega[b, 0])
                body.wy = omega[b, 1] + scale * (body.wy - omega[b, 1])
                body.wz = omega[b, 2] + scale * (body.wz - omega[b, 2])
