"""Preparation of resting contacts: effective masses, velocity biases, and which contacts are held."""

from __future__ import annotations

import numpy as np

from carom.physics.contact.constraints import ConstraintSystem, contacts_of, ends_of
from carom.physics.contact.geometry import smaller_arm
from carom.physics.contact.law import inverse_tangent_mass
from carom.physics.contact.rolling import (
    relative_spin,
    set_angular_impulse,
    set_change_of_angular_impulse,
    set_spin_before,
)
from carom.physics.contact.solver.begin_contacts import TOUCHING
from carom.physics.contact.solver.body_state import prefetch_ends
from carom.physics.contact.solver.velocity import relative_velocity, slip
from carom.physics.jit.decorators import inline, unowned

LOADED = 1e-5  # weight of the velocity that a warm-start impulse gives to the pair, in the scale of convergence;
# rounding is 1e-16 of that velocity

# A change of a contact's velocities that needs no further iteration. What is left of it stays in the impulses, from
# which the next kick starts, so a pile at rest converges from step to step.
PART_OF_REST = 1e-4  # of the rest speed
PART_OF_RADIUS = 3e-6  # of the smaller radius, per step


@unowned
def prepare(first: int, end: int, system: ConstraintSystem) -> None:
    """Write what stays constant during the iterations, and v_n and u before them; clear the impulses of impacts."""
    for piece in range(first, end):
        system.found[piece].residual = _prepare(piece, system)


@inline
def _prepare(piece: int, system: ConstraintSystem) -> float:
    """Prepare the contacts of a piece; return the largest velocity that one of them removes, in m/s."""
    lo, hi = contacts_of(piece, piece + 1, system)
    pairs, bodies = system.pairs, system.bodies
    settings = system.settings[0]
    spins = settings.spins
    dt, drift, share, bias_rate = settings.dt, settings.drift, settings.share, settings.bias_rate
    largest = 0.0
    for c in range(lo, hi):
        prefetch_ends(bodies, pairs, c)
        i, j = ends_of(pairs, c)
        contact, state, body_i, body_j = system.contacts[c], system.states[c], bodies[i], bodies[j]
        Kn = body_i.inverse_mass + body_j.inverse_mass
        contact.normal_mass = 1.0 / Kn
        vn, tx, ty, tz = relative_velocity(contact, body_i, body_j)
        state.normal_before = vn
        if spins:
            Kt = inverse_tangent_mass(Kn, contact.arm_i, contact.arm_j, body_i.inverse_inertia, body_j.inverse_inertia)
            contact.tangent_mass = 1.0 / Kt
            state.slip_x, state.slip_y, state.slip_z = slip(contact, body_i, body_j, tx, ty, tz)
            wx, wy, wz = relative_spin(body_i, body_j)
            set_spin_before(contact, wx, wy, wz)
        gap, rest_speed = -state.overlap, state.rest_speed
        if drift > 0.0:
            bias = max(0.0, gap) / drift
            # a resting contact closes no faster than this kick and half the drift's fall can cause
            fastest = rest_speed * ((share + 0.5 * drift) / dt)
            is_open = gap > TOUCHING * (contact.arm_i + contact.arm_j - gap)
        else:
            bias = gap / dt if gap > 0.0 else bias_rate * gap
            is_open = gap > 0.0 and state.apart
            fastest = rest_speed if is_open else np.inf  # impacts of touching pairs are resolved
        contact.velocity_bias, state.biased, state.slides = bias, bias < 0.0, False
        meets = is_open and not (system.pressed[i] or system.pressed[j])  # in an impact, if at all
        system.held[c] = not (meets or -vn > fastest)
        negligible = min(PART_OF_REST * rest_speed, PART_OF_RADIUS * smaller_arm(contact) / dt)
        system.small_change[c] = negligible if settings.as_needed else 0.0
        if system.held[c]:
            largest = max(largest, -vn, LOADED * contact.normal_impulse * Kn)
        else:
            contact.normal_impulse = contact.friction_x = contact.friction_y = contact.friction_z = 0.0
            set_angular_impulse(contact, 0.0, 0.0, 0.0)
        contact.delta_normal = contact.delta_x = contact.delta_y = contact.delta_z = 0.0
        set_change_of_angular_impulse(contact, 0.0, 0.0, 0.0)
    return largest
