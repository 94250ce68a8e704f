"""Contacts that last: impulses that hold bodies at rest on each other, remembered from step to step.

A resting contact carries a force, and a force belongs where the other forces are: into both kicks of a step. After each
kick of length h the impulses λ of all contacts are found together such that

    v_n + c ≥ 0,   λ_n ≥ 0,   λ_n (v_n + c) = 0                                    (Signorini)
    |λ_t| ≤ μ_s λ_n where the contact sticks, λ_t = -μ_k λ_n u/|u| where it slides      (Coulomb)

by sweeps over the contacts (projected Gauss-Seidel; Moreau 1988, Jean 1999, and as "sequential impulses" Catto 2006).
The *totals* are clamped, not the increments: what one sweep pushed too far a later one takes back. They begin with the
totals of the kick before, scaled by the ratio of the lengths, so that a pile at rest needs one sweep.

A sweep hands a load on from contact to contact, and where a light body lies between heavy ones it hands on very
little: between two sweeps stands a `line_search`. What the impulses do to the energy stands in `booking`.

After the last kick c = 0: nothing closes. After the first kick bodies may close by c dt, so that they touch when the
drift is over: |d n + v dt| ≥ r_i + r_j, with v_t the tangential velocity of the centres,

    c dt = gap + R - √(R² - v_t² dt²),   R = r_i + r_j

Without the root two spheres that roll about each other would drift apart along the tangent, and the contact would be
lost and made again in every other step. Together this is RATTLE (Andersen 1983) for contacts.

Impacts are not handled here. They are resolved before, one by one, with their restitution; a step without a contact at
rest does not come here at all.

Rejected: the seed's stages with restitution 0 (a pile of 1000 keeps jittering at the rest speed), impulses at the end
of the step only (a body falls a dt²/2 into the ground in every step and has to be pushed back).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Ends
from carom.physics.contact.booking import book
from carom.physics.contact.sweep import sweep
from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(slots=True)
class Hold:
    """The impulses that a set of contacts carried in the last kick."""

    pairs: IntArray  # (m, 2), sorted
    impulse: FloatArray  # (m, 4) N s: λ_n, λ_t
    kick: float  # s, how long that kick was

    @classmethod
    def empty(cls) -> Hold:
        """Return what a run begins with."""
        return cls(np.empty((0, 2), dtype=np.int64), np.empty((0, 4)), 0.0)

    def carried_to(self, pairs: IntArray, normals: FloatArray, kick: float) -> FloatArray:
        """Return what contacts that were there before carried, (m, 4), for a kick of another length; 0 for new ones."""
        impulse = np.zeros((len(pairs), 4))
        if self.kick > 0.0 and kick > 0.0:
            _carry(self.pairs, self.impulse, kick / self.kick, pairs, normals, impulse)
        return impulse


def hold(
    order: IntArray,
    pairs: IntArray,
    normals: FloatArray,
    arms: FloatArray,
    closing: FloatArray,
    dt: float,
    fastest: FloatArray,
    ends: Ends,
    spins: bool,
    law: FloatArray,
    kick: float,
    impulse: FloatArray,
    most_sweeps: int,
    ledger: FloatArray,
    angular_impulse: FloatArray,
) -> int:
    """Find the impulses of a kick, apply them and return the number of sweeps.

    Parameters
    ----------
    order, pairs, normals, arms, law, ledger, angular_impulse
        As for `resolve_contacts`.
    closing
        (m,) m/s; the speed at which a contact may close: gap/dt, or minus the speed that a bias wants.
    dt
        s, length of the drift to come, 0 after the last kick.
    fastest
        (m,) m/s; what closes faster is an impact yet to come, and left alone.
    kick
        s, length of the first kick if the drift is still to come, 0 after the last kick.
    impulse
        (m, 4) N s, λ_n and λ_t: the first guess, and then the result.
    """
    spinning = ends.angular_velocity if spins else ends.angular_velocity[:0]
    before = np.empty((len(pairs), 4))
    sweeps: int = sweep(
        order,
        pairs,
        normals,
        arms,
        closing,
        dt,
        fastest,
        ends.velocity,
        spinning,
        ends.inverse_mass,
        ends.inverse_inertia,
        law,
        impulse,
        most_sweeps,
        before,
        np.empty((len(pairs), 3)),
        np.zeros((len(pairs), 4)),
        np.empty_like(ends.velocity),
        np.empty_like(spinning),
    )
    book(
        pairs,
        normals,
        arms,
        closing,
        before,
        ends.velocity,
        ends.acceleration,
        spinning,
        kick,
        impulse,
        ledger,
        angular_impulse,
    )
    return sweeps


@kernel
def _carry(
    old_pairs: IntArray,
    old: FloatArray,
    ratio: float,
    pairs: IntArray,
    normals: FloatArray,
    impulse: FloatArray,
) -> None:
    """Find each pair among the old ones, both sorted; turn its tangential impulse into the new tangential plane."""
    k = 0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        while k < len(old_pairs) and (old_pairs[k, 0] < i or (old_pairs[k, 0] == i and old_pairs[k, 1] < j)):
            k += 1
        if k < len(old_pairs) and old_pairs[k, 0] == i and old_pairs[k, 1] == j:
            along = 0.0
            for axis in range(3):
                along += old[k, 1 + axis] * normals[c, axis]
            impulse[c, 0] = ratio * old[k, 0]
            for axis in range(3):
                impulse[c, 1 + axis] = ratio * (old[k, 1 + axis] - along * normals[c, axis])
