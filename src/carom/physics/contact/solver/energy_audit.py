"""The energy audit of resting contacts: the change of the energy by their impulses.

An impulse J takes out -J·(v + v')/2, where v and v' are the velocities before and after it. After the first kick there
is a second term. The forces do their work in the drift on velocities that include J, but half of that work has already
been booked with the first kick, without J. The difference, J·Δv with Δv = (a_j - a_i) h, is booked with the impulse:

    lost_n = -λ_n ((v_n + v_n')/2 - Δv_n),    lost_t = -λ_t·((u + u')/2 - Δu)        Δv = 0 after the last kick

The entries of the two kicks then cancel for a body that lies still.

If the iterations did not converge, the audit also measures what the energy bound asks for (`energy_bound`).
"""

from __future__ import annotations

from carom.physics.contact.constraints import ConstraintSystem, contacts_of, ends_of
from carom.physics.contact.law import exerts_torque
from carom.physics.contact.rolling import angular_impulse, relative_spin, spin_before
from carom.physics.contact.solver.body_state import prefetch_ends
from carom.physics.contact.solver.energy_bound import friction_energies, normal_energies
from carom.physics.contact.solver.velocity import relative_velocity, slip
from carom.physics.diagnostics.ledger import copy_terms
from carom.physics.jit.decorators import inline, unowned


@unowned
def audit(first: int, end: int, system: ConstraintSystem) -> None:
    """Book the energies of the impulses of some pieces, by contact and in sum."""
    for piece in range(first, end):
        _audit(piece, system)


@inline
def _audit(piece: int, system: ConstraintSystem) -> None:
    lo, hi = contacts_of(piece, piece + 1, system)
    pairs, a, bodies = system.pairs, system.acceleration, system.bodies
    settings = system.settings[0]
    spins, measures = settings.spins, settings.measures
    share = settings.share if settings.drift > 0.0 else 0.0
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
        nx, ny, nz = contact.nx, contact.ny, contact.nz
        vn, ux, uy, uz = relative_velocity(contact, body_i, body_j)
        kx, ky, kz = (a[j, 0] - a[i, 0]) * share, (a[j, 1] - a[i, 1]) * share, (a[j, 2] - a[i, 2]) * share
        kn = kx * nx + ky * ny + kz * nz
        if state.biased:  # without the bias v_n' would be 0; the bias put in the rest
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
        ux, uy, uz = slip(contact, body_i, body_j, ux, uy, uz)
        lost = -(
            contact.friction_x * (0.5 * (state.slip_x + ux) - (kx - kn * nx))
            + contact.friction_y * (0.5 * (state.slip_y + uy) - (ky - kn * ny))
            + contact.friction_z * (0.5 * (state.slip_z + uz) - (kz - kn * nz))
        )
        state.friction_loss += lost
        friction += lost
        if measures:
            slope, curvature = friction_energies(contact, state, ux, uy, uz)
            measured.slope += slope
            measured.curvature += curvature
        if exerts_torque(system.materials[0]):  # forces do no work on spins, so there is no second term
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
    found = system.found[piece]
    found.restitution_loss, found.friction_loss, found.stabilisation_gain = restitution, friction, stabilisation
