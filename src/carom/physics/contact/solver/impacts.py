"""The restitution pass: closing contacts are resolved colour by colour, until none closes any more.

`carom.physics.reference_api` has the equations, and `contact.law` the impulses. Each impulse changes the energy by

    ΔE_n = J_n (v_n + ½ J_n / m_r),    1/m_r = 1/m_i + 1/m_j
    ΔE_t = -J_t (|u_t| - ½ J_t K_t),   K_t = 1/m_i + 1/m_j + ρ_i²/I_i + ρ_j²/I_j

Each contact sums its losses by restitution and by friction, and its gain by the bias.

A late impact is detected at the end of a step, at a depth δ. Gravity has made the approach faster than at the surface,
and will make the rebound slower. The pair leaves the surface at e times the speed at which it closed there, if the
coefficient at the depth δ is

    e_δ² = e² + (1 - e²) · 2 a_n δ / v_n²,    a_n = (a_i - a_j)·n, if gravity presses the pair together

With e instead of e_δ, the energy of each rebound would be wrong by the change of the potential over δ, an error of
first order in the step.
"""

from __future__ import annotations

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.contact.constraints import ConstraintSystem, body_count, contacts_of, ends_of
from carom.physics.contact.geometry import smaller_arm
from carom.physics.contact.guided_walls import tangent_inverse_mass
from carom.physics.contact.impact_log import ROUNDING
from carom.physics.contact.law import (
    exerts_torque,
    friction_of_impact,
    inverse_tangent_mass,
    material_index,
    normal_loss,
    rebound,
    restitution_at_depth,
    restitution_of_impact,
)
from carom.physics.contact.records import BodyStateRecord, ContactRecord, ContactStateRecord, ImpulseRecord
from carom.physics.contact.rolling import (
    angular_impulse,
    angular_impulse_of_impact,
    apply_angular_impulse,
    relative_spin,
    set_angular_impulse,
)
from carom.physics.contact.solver.body_state import prefetch_ends, push, relative_velocity, slip, turn
from carom.physics.contact.solver.refine import INTOLERABLE, tolerated
from carom.physics.jit.decorators import inline, inner, long_kernel
from carom.physics.sheared_box import relative_to_image
from carom.physics.vector import between

CONVERGED = 1e-9  # iterations end at this largest velocity change, relative to the change in the first iteration


@inner
def resolve_impacts(first: int, end: int, system: ConstraintSystem) -> None:
    """Resolve the impacts in some pieces once; record the largest change of a velocity.

    The first iteration also records each closing speed, the fastest closing speed, and whether a contact is at rest. A
    later iteration raises the closing speed if an impulse from a neighbour has made the contact close faster.
    """
    pairs, a, bodies = system.pairs, system.acceleration, system.bodies
    settings = system.settings[0]
    spins, is_first, impacts_only = settings.spins, settings.iteration == 0, settings.impacts_only
    records = len(system.recorded) > 0
    bias_rate = settings.bias_rate
    count, places = body_count(system), system.places
    for piece in range(first, end):
        lo, hi = contacts_of(piece, piece + 1, system)
        largest_change, fastest, any_rests = 0.0, 0.0, False
        for c in range(lo, hi):
            prefetch_ends(bodies, pairs, c)
            i, j = ends_of(pairs, c)
            contact, state, body_i, body_j = system.contacts[c], system.states[c], bodies[i], bodies[j]
            nx, ny, nz = contact.nx, contact.ny, contact.nz
            vn, tx, ty, tz = relative_velocity(contact, body_i, body_j)
            rests = -vn <= state.rest_speed
            if is_first:
                state.approach_speed = max(0.0, -vn)
                fastest, any_rests = max(fastest, -vn), any_rests or rests
            if impacts_only and (rests or (state.overlap < 0.0 and state.apart)):
                continue  # `hold` resolves contacts at rest; an open gap may close in the next step
            material = system.materials[material_index(i, j, count, places)]
            Kn = body_i.inverse_mass + body_j.inverse_mass
            e = restitution_of_impact(material, -vn, state.rest_speed, Kn, contact.arm_i, contact.arm_j)
            overlap = state.detected_overlap
            if is_first and e > 0.0 and overlap > 0.0:
                ax, ay, az = between(a, j, i)
                an = ax * nx + ay * ny + az * nz
                if an > 0.0:
                    e = restitution_at_depth(e, vn, overlap, an)
            change = rebound(e, vn)
            biased = change + bias_rate * overlap
            if biased <= 0.0:
                continue
            largest_change = max(largest_change, biased)
            if not rests and -vn > state.approach_speed and -vn > ROUNDING * _sum_of_speeds(body_i, body_j):
                state.approach_speed = -vn
            Jn = biased / Kn
            Jn_unbiased = max(0.0, change) / Kn
            lost = normal_loss(Jn_unbiased, vn, Kn)
            state.restitution_loss += lost
            state.stabilisation_gain += lost - normal_loss(Jn, vn, Kn)
            Jx, Jy, Jz = Jn * nx, Jn * ny, Jn * nz
            if records:
                system.recorded[c].normal_impulse += Jn
            if spins:
                ux, uy, uz = slip(contact, body_i, body_j, tx, ty, tz)
                K = tangent_inverse_mass(Kn, body_i, body_j)
                Kt = inverse_tangent_mass(
                    K, contact.arm_i, contact.arm_j, body_i.inverse_inertia, body_j.inverse_inertia
                )
                tx, ty, tz, dissipated = friction_of_impact(material, Jn, ux, uy, uz, Kt)
                state.friction_loss += dissipated
                if tx != 0.0 or ty != 0.0 or tz != 0.0:
                    Jx, Jy, Jz = Jx + tx, Jy + ty, Jz + tz
                    turn(contact, body_i, body_j, tx, ty, tz)
                    if records:
                        _record_friction(system.recorded[c], tx, ty, tz)
                K = body_i.inverse_inertia + body_j.inverse_inertia
                if exerts_torque(material) and K > 0.0:
                    wx, wy, wz = relative_spin(body_i, body_j)
                    lx, ly, lz, dissipated = angular_impulse_of_impact(contact, material, Jn, wx, wy, wz, K)
                    state.friction_loss += dissipated
                    apply_angular_impulse(body_i, body_j, lx, ly, lz)
                    if records:
                        given = system.recorded[c]
                        sx, sy, sz = angular_impulse(given)
                        set_angular_impulse(given, sx + lx, sy + ly, sz + lz)
            push(body_i, body_j, Jx, Jy, Jz)
        results = system.piece_results[piece]
        results.residual = largest_change
        if is_first:
            results.fastest, results.any_rests = fastest, any_rests


@inline
def _sum_of_speeds(a: BodyStateRecord, b: BodyStateRecord) -> float:
    """Return an upper bound (m/s) of the speeds of two bodies."""
    bound: float = abs(a.vx) + abs(a.vy) + abs(a.vz) + abs(b.vx) + abs(b.vy) + abs(b.vz)
    return bound


@inline
def _record_friction(given: ImpulseRecord, tx: float, ty: float, tz: float) -> None:
    given.friction_x += tx
    given.friction_y += ty
    given.friction_z += tz


@long_kernel
def check_closing(
    lo: int,
    hi: int,
    pairs: IntArray,
    resolved: tuple[RecordArray[ContactRecord], RecordArray[ContactStateRecord], FloatArray],
    v: FloatArray,
    limits: tuple[float, float],
    closing: BoolArray,
) -> None:
    """Set ``closing`` if one of the contacts [lo, hi) closes faster than both its load speed and its tolerance.

    Open gaps are not counted: they may close in the next step.

    Parameters
    ----------
    resolved
        The contacts, their states and their load speeds in m/s.
    limits
        Closing speed (m/s) below which a contact does not count, and the step (s).
    """
    contacts, states, load_speed = resolved
    negligible, dt = limits
    for c in range(lo, hi):
        (i, j), contact, state = ends_of(pairs, c), contacts[c], states[c]
        if state.overlap < 0.0 and state.apart:
            continue
        vx, vy, vz = relative_to_image(contact, *between(v, i, j))
        vn = vx * contact.nx + vy * contact.ny + vz * contact.nz
        small = smaller_arm(contact)
        left = INTOLERABLE * tolerated(load_speed[c], state.approach_speed, state.overlap / small, small / dt)
        if -(vn + max(0.0, contact.velocity_bias)) > max(load_speed[c], negligible, left):
            closing[0] = True
            return
