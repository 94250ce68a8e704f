"""Contacts that last: impulses that hold bodies at rest on each other, remembered from step to step.

A resting contact carries a force, and a force belongs where the other forces are: into both kicks of a step. After each
kick of length h the impulses λ of all contacts are found together such that

    v_n + c ≥ 0,   λ_n ≥ 0,   λ_n (v_n + c) = 0                                    (Signorini)
    |λ_t| ≤ μ_s λ_n where the contact sticks, λ_t = -μ_k λ_n u/|u| where it slides      (Coulomb)

by iterations over the contacts (projected Gauss-Seidel; Moreau 1988, Jean 1999; Catto 2006 calls it sequential
impulses). The *totals* are clamped, not the increments: what one iteration pushed too far a later one takes back. They
begin with the totals of the kick before, scaled by the ratio of the lengths (warm starting), so that a pile at rest
needs one iteration.

An iteration hands a load on from contact to contact, and where a light body lies between heavy ones it hands on very
little: a line search stands between two of them (`sweep`). What the impulses do to the energy stands in `booking`.

After the last kick c = 0: nothing closes. After the first kick bodies may close by c dt, so that they touch when the
drift is over: |d n + v dt| ≥ r_i + r_j, with v_t the tangential velocity of the centres,

    c dt = gap + R - √(R² - v_t² dt²),   R = r_i + r_j

Without the root two spheres that roll about each other would drift apart along the tangent, and the contact would be
lost and made again in every other step. Together this is RATTLE (Andersen 1983) for contacts.

Impacts are not handled here. They are resolved before, one by one, with their restitution; a step without a contact at
rest does not come here at all.

Rejected: the reference engine's stages with restitution 0 (a pile of 1000 keeps jittering at the rest speed),
impulses at the end of the step only (a body falls a dt²/2 into the ground in every step and has to be pushed back).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.constraint_graph import first_of
from carom.physics.contact.constraints import CONTACT
from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.prefetch import AHEAD, prefetch_record
from carom.physics.parallel.thread_team import Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

MIN_CONTACTS_PER_TASK = 500
IMPULSES = ("normal_impulse", "friction_x", "friction_y", "friction_z")  # N s, λ_n and λ_t


def impulses_of(contacts: Records) -> FloatArray:
    """Return a copy of λ_n and λ_t, (m, 4) N s."""
    return np.stack([contacts[name] for name in IMPULSES], axis=-1)


@dataclass(slots=True)
class ImpulseCache:
    """The impulses that a set of contacts carried in the last kick, with which the next one begins."""

    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) where the record of each stands
    contacts: Records  # (m,) CONTACT
    kick: float  # s, how long that kick was

    @classmethod
    def empty(cls) -> ImpulseCache:
        """Return what a run begins with."""
        return cls(np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0, CONTACT), 0.0)

    @classmethod
    def of(cls, pairs: IntArray, impulse: FloatArray, kick: float) -> ImpulseCache:
        """Rebuild the cache from (m, 4) N s, an earlier `impulse`."""
        contacts = np.zeros(len(pairs), CONTACT)
        for k, name in enumerate(IMPULSES):
            contacts[name] = impulse[:, k]
        return cls(pairs, np.arange(len(pairs)), contacts, kick)

    @property
    def impulse(self) -> FloatArray:
        """(m, 4) N s, a copy of λ_n and λ_t in the order of the pairs."""
        return impulses_of(self.contacts)[self.place]

    def carry_to(self, pairs: IntArray, place: IntArray, kick: float, contacts: Records, team: Team) -> None:
        """Write what contacts that were there before carried, for a kick of another length; 0 for new ones.

        Parameters
        ----------
        pairs, place
            (m, 2), sorted, and (m,), where the record of each stands.
        kick
            s
        contacts
            (m,) `CONTACT`; may be the very array in which the impulses stood before, of the same contacts.
        team
            Who looks for them.
        """
        if self.kick > 0.0 and kick > 0.0 and len(self.pairs) > 0:
            before = (self.pairs, self.place, self.contacts, kick / self.kick)
            team.divide(len(pairs), MIN_CONTACTS_PER_TASK, _carry, *before, pairs, place, contacts)
        else:
            for name in IMPULSES:
                contacts[name] = 0.0


@long_kernel
def _carry(
    lo: int,
    hi: int,
    old_pairs: IntArray,
    old_place: IntArray,
    old_contacts: Records,
    ratio: float,
    pairs: IntArray,
    place: IntArray,
    contacts: Records,
) -> None:
    """Find each pair among the old ones, both sorted; turn its tangential impulse into the new tangential plane."""
    k = first_of(pairs[lo, 0], old_pairs) if lo < hi else 0
    last, old_last = len(pairs) - 1, len(old_pairs) - 1
    for c in range(lo, hi):
        p, q = place[min(last, c + AHEAD)], old_place[min(old_last, k + AHEAD)]
        prefetch_record(contacts, p, 0)
        prefetch_record(contacts, p, 1)
        prefetch_record(old_contacts, q, 1)
        i, j = pairs[c, 0], pairs[c, 1]
        while k < len(old_pairs) and (old_pairs[k, 0] < i or (old_pairs[k, 0] == i and old_pairs[k, 1] < j)):
            k += 1
        known = k < len(old_pairs) and old_pairs[k, 0] == i and old_pairs[k, 1] == j
        contact, old = contacts[place[c]], old_contacts[old_place[k] if known else 0]
        normal = old.normal_impulse if known else 0.0
        x, y, z = (old.friction_x, old.friction_y, old.friction_z) if known else (0.0, 0.0, 0.0)
        along = x * contact.nx + y * contact.ny + z * contact.nz
        contact.normal_impulse, contact.friction_x = ratio * normal, ratio * (x - along * contact.nx)
        contact.friction_y, contact.friction_z = ratio * (y - along * contact.ny), ratio * (z - along * contact.nz)
