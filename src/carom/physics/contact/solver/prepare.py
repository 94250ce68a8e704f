"""Preparation of contacts: their records at the start of a step, and values that stay constant while they are solved.

`begin_contacts` clears the records and computes the geometry. `prepare` computes effective masses and velocity biases,
and decides which contacts are held.

**Warm start.** The impulses of resting contacts carry over from kick to kick (`ImpulseCache`). A contact that existed
in the previous kick starts with its impulse of that kick, scaled by the ratio of the kicks' lengths and projected onto
its new tangential plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.aligned import columns
from carom.physics.contact.constraints import (
    CONTACT,
    ENOUGH,
    MIN_PER_TASK,
    ROLLING_CONTACT,
    ConstraintSystem,
    body_count,
    contacts_of,
    ends_of,
)
from carom.physics.contact.geometry import Shapes, smaller_arm, update_geometry
from carom.physics.contact.graph import comes_before, first_of
from carom.physics.contact.guided_walls import tangent_inverse_mass
from carom.physics.contact.law import (
    FRICTION_X,
    FRICTION_Y,
    FRICTION_Z,
    IMPULSES,
    NORMAL,
    exerts_torque,
    inverse_tangent_mass,
)
from carom.physics.contact.moving_walls import clear_surface_velocity
from carom.physics.contact.records import ContactRecord, ContactStateRecord
from carom.physics.contact.rolling import (
    angular_impulse,
    angular_impulses_of,
    apply_angular_impulse,
    relative_spin,
    set_angular_impulse,
    set_change_of_angular_impulse,
    set_spin_before,
)
from carom.physics.contact.solids import bias_along_wall
from carom.physics.contact.solver.body_state import (
    apply_impulse,
    change_by_field,
    prefetch_ends,
    relative_velocity,
    set_half_turn,
    slip,
)
from carom.physics.diagnostics.ledger import clear_terms
from carom.physics.jit.decorators import inline, inner, kernel, long_kernel
from carom.physics.jit.instructions import AHEAD, prefetch_record
from carom.physics.jit.team import Team
from carom.physics.vector import vector

TOUCHING = 1e-9  # gap of touching bodies, relative to the sum of radii; iterations and rounding leave such gaps
CACHED_CONTACTS = 64  # number of contacts whose records fit into the first-level cache

# Weight of the warm start's velocity change in the scale of convergence. The rounding of this change is 1e-16 of it.
LOADED = 1e-5

# Largest change of a contact's velocities that needs no further iteration. Smaller changes remain in the impulses, from
# which the next kick starts, so a pile at rest converges from step to step.
SMALL_OF_REST = 1e-4  # tolerance as a fraction of the rest speed
SMALL_OF_RADIUS = 3e-6  # tolerance as a fraction of the smaller radius per step


@long_kernel
def begin_contacts(
    lo: int,
    hi: int,
    pairs: IntArray,
    shapes: Shapes,
    contacts: RecordArray[ContactRecord],
    states: RecordArray[ContactStateRecord],
    rounding: float,
    normals: FloatArray,
) -> None:
    """Clear the records of the contacts [lo, hi), compute their geometry, and record whether they touch."""
    for first in range(lo, hi, CACHED_CONTACTS):
        end = min(hi, first + CACHED_CONTACTS)
        for c in range(first, end):
            _clear(contacts[c], states[c])
        update_geometry(first, end, pairs, shapes, contacts, states)
        for c in range(first, end):
            contact, state = contacts[c], states[c]
            normals[c, 0], normals[c, 1], normals[c, 2] = contact.nx, contact.ny, contact.nz
            overlap = state.overlap
            state.detected_overlap = max(0.0, overlap)
            distance = contact.arm_i + contact.arm_j + overlap
            state.apart = overlap < -(TOUCHING * distance + rounding)


@inline
def _clear(contact: ContactRecord, state: ContactStateRecord) -> None:
    """Clear the fields that `update_geometry` does not write."""
    contact.normal_mass = contact.tangent_mass = contact.velocity_bias = 0.0
    contact.normal_impulse = contact.friction_x = contact.friction_y = contact.friction_z = 0.0
    contact.delta_normal = contact.delta_x = contact.delta_y = contact.delta_z = 0.0
    set_angular_impulse(contact, 0.0, 0.0, 0.0)
    set_change_of_angular_impulse(contact, 0.0, 0.0, 0.0)
    set_spin_before(contact, 0.0, 0.0, 0.0)
    clear_surface_velocity(contact)
    state.rest_speed = state.approach_speed = 0.0
    state.normal_before = state.slip_x = state.slip_y = state.slip_z = 0.0
    clear_terms(state)
    state.push_x = state.push_y = state.push_z = state.push_fraction = 0.0
    state.biased = False


@inner
def prepare(first: int, end: int, system: ConstraintSystem) -> None:
    """Write the constants of the iterations, and the initial v_n and u; clear the impulses of contacts not held."""
    pairs, bodies = system.pairs, system.bodies
    settings = system.settings[0]
    spins = settings.spins
    dt, drift, booked, bias_rate = settings.dt, settings.drift, settings.booked, settings.bias_rate
    count = body_count(system)
    for piece in range(first, end):
        lo, hi = contacts_of(piece, piece + 1, system)
        largest = 0.0  # m/s, largest velocity that a contact removes
        for c in range(lo, hi):
            prefetch_ends(bodies, pairs, c)
            i, j = ends_of(pairs, c)
            contact, state, body_i, body_j = system.contacts[c], system.states[c], bodies[i], bodies[j]
            Kn = body_i.inverse_mass + body_j.inverse_mass
            contact.normal_mass = 1.0 / Kn
            vn, tx, ty, tz = relative_velocity(contact, body_i, body_j)
            state.normal_before = vn
            if spins:
                K = tangent_inverse_mass(Kn, body_i, body_j)
                Kt = inverse_tangent_mass(
                    K, contact.arm_i, contact.arm_j, body_i.inverse_inertia, body_j.inverse_inertia
                )
                contact.tangent_mass = 1.0 / Kt
                ux, uy, uz = slip(contact, body_i, body_j, tx, ty, tz)
                if drift > 0.0:
                    _, (kx, ky, kz) = change_by_field(contact, system.acceleration, i, j, booked)
                    ux, uy, uz = ux - kx, uy - ky, uz - kz
                state.slip_x, state.slip_y, state.slip_z = ux, uy, uz
                wx, wy, wz = relative_spin(body_i, body_j)
                set_spin_before(contact, wx, wy, wz)
            gap, rest_speed = -state.overlap, state.rest_speed
            if drift > 0.0:
                bias = max(0.0, gap) / drift
                if j >= count:
                    # slip of the body after the friction of the warm start, which is close to the final friction
                    fx, fy, fz = Kn * contact.friction_x, Kn * contact.friction_y, Kn * contact.friction_z
                    along = (-tx - fx, -ty - fy, -tz - fz)
                    normal, place = (contact.nx, contact.ny, contact.nz), vector(system.position, i)
                    bias, turned = bias_along_wall(
                        system.surface, j - count, bias, contact.arm_i, place, normal, along, drift
                    )
                    if spins:
                        moves = place, along, bias, min(0.0, gap), drift
                        set_half_turn(contact, system.surface, j - count, body_i, moves, turned)
                # a resting contact closes no faster than the accelerations in this kick and half of the drift allow
                fastest = rest_speed * ((booked + 0.5 * drift) / dt)
                is_open = gap > TOUCHING * (contact.arm_i + contact.arm_j - gap)
            else:
                bias = gap / dt if gap > 0.0 else bias_rate * gap
                is_open = gap > 0.0 and state.apart
                fastest = rest_speed if is_open else np.inf  # impacts of touching pairs have been resolved
            contact.velocity_bias, state.biased, state.slides = bias, drift == 0.0 and bias < 0.0, False
            # if nothing has pressed the bodies of an open contact, they can meet only in an impact
            meets = is_open and not (system.pressed[i] or system.pressed[j])
            system.held[c] = not (meets or -vn > fastest)
            negligible = min(SMALL_OF_REST * system.load_speed[c], SMALL_OF_RADIUS * smaller_arm(contact) / dt)
            system.small_change[c] = negligible if system.enough[c] > ENOUGH else 0.0
            if system.held[c]:
                opening = -(vn + bias) if drift > 0.0 else 0.0  # along a wall that curves towards the body, bias < 0
                largest = max(largest, -vn, opening, LOADED * contact.normal_impulse * Kn)
            else:
                contact.normal_impulse = contact.friction_x = contact.friction_y = contact.friction_z = 0.0
                set_angular_impulse(contact, 0.0, 0.0, 0.0)
            contact.delta_normal = contact.delta_x = contact.delta_y = contact.delta_z = 0.0
            set_change_of_angular_impulse(contact, 0.0, 0.0, 0.0)
        system.piece_results[piece].residual = largest


def impulses_of(contacts: RecordArray[ContactRecord]) -> FloatArray:
    """Return λ_n and λ_t, (m, 4) N s, as a view."""
    return columns(contacts, IMPULSES)


PlacedContacts = tuple[IntArray, IntArray, RecordArray[ContactRecord]]
"""Sorted pairs, (m, 2), the index of each pair's record, (m,), and the records, (m,)."""


@dataclass(slots=True)
class ImpulseCache:
    """The impulses of all contacts in the last kick, from which the next kick starts."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) index of each contact's record
    contacts: RecordArray[ContactRecord]  # (m,) CONTACT
    kick: float  # s, length of the kick in which the impulses acted

    @classmethod
    def empty(cls) -> ImpulseCache:
        """Return the cache at the start of a run."""
        return cls(np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0, CONTACT), 0.0)

    @classmethod
    def of(cls, pairs: IntArray, impulse: FloatArray, kick: float) -> ImpulseCache:
        """Rebuild the cache from an earlier `impulse`."""
        rolls = impulse.shape[1] > len(IMPULSES)
        contacts = np.zeros(len(pairs), ROLLING_CONTACT if rolls else CONTACT)
        impulses_of(contacts)[:] = impulse[:, : len(IMPULSES)]
        angular_impulses_of(contacts)[:] = impulse[:, len(IMPULSES) :]
        return cls(pairs, np.arange(len(pairs)), contacts, kick)

    @property
    def impulse(self) -> FloatArray:
        """A copy of λ_n and λ_t in the order of the pairs, (m, 4) N s; (m, 7) with Λ if the law resists rolling."""
        impulses = np.empty((len(self.place), len(IMPULSES)))
        _gather_impulses(self.place, self.contacts, impulses)
        angular = angular_impulses_of(self.contacts)
        return np.concatenate((impulses, angular[self.place]), axis=1) if angular.shape[1] else impulses

    def impulse_of(self, contacts: RecordArray[ContactRecord]) -> FloatArray:
        """Return `impulse`, with angular impulses of 0 if ``contacts`` have angular impulses and the cache has none."""
        impulses = self.impulse
        missing = len(IMPULSES) + angular_impulses_of(contacts).shape[1] - impulses.shape[1]
        return np.pad(impulses, ((0, 0), (0, missing))) if missing else impulses

    def carry_to(
        self, pairs: IntArray, place: IntArray, kick: float, contacts: RecordArray[ContactRecord], team: Team
    ) -> None:
        """Write the impulses from which contacts start, scaled to the length of a kick; 0 for new contacts.

        Parameters
        ----------
        pairs, place
            (m, 2), sorted, and (m,), the index of each contact's record.
        kick
            s
        contacts
            (m,) `CONTACT`; may be the array of this cache if the contacts are the same.
        team
            Threads that share the work.
        """
        if not (self.kick > 0.0 and kick > 0.0 and len(self.pairs) > 0):
            impulses_of(contacts)[:] = 0.0
            angular_impulses_of(contacts)[:] = 0.0
        elif place is self.place:  # the contacts are the same, and so is their order
            team.divide(len(pairs), MIN_PER_TASK, carry_each, self.contacts, kick / self.kick, contacts)
        else:
            old, new = (self.pairs, self.place, self.contacts), (pairs, place, contacts)
            team.divide(len(pairs), MIN_PER_TASK, _carry, old, kick / self.kick, new)


@long_kernel
def mark_pressed(
    lo: int,
    hi: int,
    pairs: IntArray,
    place: IntArray,
    contacts: RecordArray[ContactRecord],
    inverse_mass: FloatArray,
    pressed: BoolArray,
) -> None:
    """Mark the free ends of the contacts [lo, hi) that have an impulse; threads may mark the same end."""
    for c in range(lo, hi):
        if contacts[place[c]].normal_impulse > 0.0:
            for end in range(2):
                if inverse_mass[pairs[c, end]] > 0.0:
                    pressed[pairs[c, end]] = True


@kernel
def _gather_impulses(place: IntArray, contacts: RecordArray[ContactRecord], impulses: FloatArray) -> None:
    for c in range(len(place)):
        contact = contacts[place[c]]
        impulses[c, NORMAL] = contact.normal_impulse
        impulses[c, FRICTION_X], impulses[c, FRICTION_Y] = contact.friction_x, contact.friction_y
        impulses[c, FRICTION_Z] = contact.friction_z


@long_kernel
def carry_each(
    lo: int, hi: int, old_contacts: RecordArray[ContactRecord], ratio: float, contacts: RecordArray[ContactRecord]
) -> None:
    """Transfer the impulses of the contacts [lo, hi) in the order of their records, in half the time of `_carry`."""
    for c in range(lo, hi):
        old = old_contacts[c]
        _set_impulse(contacts[c], ratio, old.normal_impulse, old.friction_x, old.friction_y, old.friction_z)
        lx, ly, lz = angular_impulse(old)
        set_angular_impulse(contacts[c], ratio * lx, ratio * ly, ratio * lz)


@long_kernel
def _carry(lo: int, hi: int, before: PlacedContacts, ratio: float, now: PlacedContacts) -> None:
    """Find each pair among the old pairs (both are sorted), and transfer its impulse."""
    old_pairs, old_place, old_contacts = before
    pairs, place, contacts = now
    k = first_of(pairs[lo, 0], old_pairs) if lo < hi else 0
    last, old_last = len(pairs) - 1, len(old_pairs) - 1
    for c in range(lo, hi):
        p, q = place[min(last, c + AHEAD)], old_place[min(old_last, k + AHEAD)]
        prefetch_record(contacts, p, 0)
        prefetch_record(contacts, p, 1)
        prefetch_record(old_contacts, q, 1)
        i, j = ends_of(pairs, c)
        while k < len(old_pairs) and comes_before(old_pairs[k, 0], old_pairs[k, 1], i, j):
            k += 1
        known = k < len(old_pairs) and old_pairs[k, 0] == i and old_pairs[k, 1] == j
        contact, old = contacts[place[c]], old_contacts[old_place[k] if known else 0]
        normal = old.normal_impulse if known else 0.0
        x, y, z = (old.friction_x, old.friction_y, old.friction_z) if known else (0.0, 0.0, 0.0)
        _set_impulse(contact, ratio, normal, x, y, z)
        lx, ly, lz = angular_impulse(old)
        scale = ratio if known else 0.0
        set_angular_impulse(contact, scale * lx, scale * ly, scale * lz)


@inline
def _set_impulse(contact: ContactRecord, ratio: float, normal: float, x: float, y: float, z: float) -> None:
    """Start from an earlier impulse (N s): scale it, and project its tangential component onto the tangential plane."""
    along = x * contact.nx + y * contact.ny + z * contact.nz
    contact.normal_impulse, contact.friction_x = ratio * normal, ratio * (x - along * contact.nx)
    contact.friction_y, contact.friction_z = ratio * (y - along * contact.ny), ratio * (z - along * contact.nz)


@inner
def warm_start(first: int, end: int, system: ConstraintSystem) -> None:
    """Apply the impulses with which the contacts in some pieces start."""
    lo, hi = contacts_of(first, end, system)
    pairs, bodies, spins = system.pairs, system.bodies, system.settings[0].spins
    for c in range(lo, hi):
        prefetch_ends(bodies, pairs, c)
        i, j = ends_of(pairs, c)
        contact, body_i, body_j = system.contacts[c], bodies[i], bodies[j]
        tx, ty, tz = contact.friction_x, contact.friction_y, contact.friction_z
        apply_impulse(contact, body_i, body_j, spins, contact.normal_impulse, tx, ty, tz)
        if exerts_torque(system.materials[0]):
            lx, ly, lz = angular_impulse(contact)
            apply_angular_impulse(body_i, body_j, lx, ly, lz)
