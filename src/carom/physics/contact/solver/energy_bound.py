"""The energy bound of resting contacts: impulses that are still too large after the iterations are scaled down.

Impulses λ change the velocities at the contacts from v to v' = v + A λ. The solution minimises

    f(λ) = λ·(v + c) + ½ λ·A λ,

which is 0 for λ = 0 and negative for impulses that take out energy. Iterations lower f, but they start from the
impulses of the previous kick, which may be far too large. Along θ λ the minimum is at θ = -λ·(v + c) / λ·(v' - v). If
θ < 1, the impulses of the island are multiplied by it. Then f ≤ 0, and contacts gain no energy over a whole step, whose
second kick starts from the impulses of the first. An island is a connected component of the collision graph without
fixed bodies and planes.
"""

from __future__ import annotations

from carom.physics.contact.constraints import ConstraintSystem
from carom.physics.contact.solver.velocity import relative_velocity, slip
from carom.physics.contact.union_find import join, root_of
from carom.physics.parallel.jit import unowned


@unowned
def scale_back(piece: int, end: int, system: ConstraintSystem) -> None:
    """Scale the impulses of each island by θ where θ < 1."""
    pairs, bodies, active = system.pairs, system.bodies, system.active
    island, islands, spins = system.island, system.islands, len(system.spin) > 0
    for k in range(len(active)):
        island[active[k]] = active[k]
        whole = islands[active[k]]
        whole.slope = whole.curvature = 0.0
        whole.scale = 1.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        if bodies[i].inverse_mass > 0.0 and bodies[j].inverse_mass > 0.0:
            join(island, i, j)
    for c in range(len(pairs)):
        if not system.held[c]:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        contact, state, body_i, body_j = system.contacts[c], system.states[c], bodies[i], bodies[j]
        vn, ux, uy, uz = relative_velocity(contact, body_i, body_j)
        slope = contact.normal_impulse * (state.normal_before + contact.velocity_bias)
        curvature = contact.normal_impulse * (vn - state.normal_before)
        if spins:
            tx, ty, tz = contact.friction_x, contact.friction_y, contact.friction_z
            ux, uy, uz = slip(contact, body_i, body_j, ux, uy, uz)
            ux, uy, uz = ux - state.slip_x, uy - state.slip_y, uz - state.slip_z
            before = tx * state.slip_x + ty * state.slip_y + tz * state.slip_z
            slope += before
            curvature += tx * ux + ty * uy + tz * uz
        whole = islands[root_of(island, i if body_i.inverse_mass > 0.0 else j)]
        whole.slope += slope
        whole.curvature += curvature
    for k in range(len(active)):
        if island[active[k]] == active[k]:
            whole = islands[active[k]]
            if -whole.slope < whole.curvature:
                whole.scale = max(0.0, -whole.slope / whole.curvature)
    for c in range(len(pairs)):
        i, j, contact = pairs[c, 0], pairs[c, 1], system.contacts[c]
        scale = islands[root_of(island, i if bodies[i].inverse_mass > 0.0 else j)].scale
        if scale < 1.0:
            contact.normal_impulse *= scale
            contact.friction_x *= scale
            contact.friction_y *= scale
            contact.friction_z *= scale
    for k in range(len(active)):
        b = active[k]
        body, scale = bodies[b], islands[root_of(island, b)].scale
        if body.inverse_mass > 0.0 and scale < 1.0:
            v, omega = system.velocity, system.spin
            body.vx = v[b, 0] + scale * (body.vx - v[b, 0])
            body.vy = v[b, 1] + scale * (body.vy - v[b, 1])
            body.vz = v[b, 2] + scale * (body.vz - v[b, 2])
            if spins:
                body.wx = omega[b, 0] + scale * (body.wx - omega[b, 0])
                body.wy = omega[b, 1] + scale * (body.wy - omega[b, 1])
                body.wz = omega[b, 2] + scale * (body.wz - omega[b, 2])
