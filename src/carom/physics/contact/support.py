"""The part of each acceleration that lasting contacts bear."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.physics.contact.solver.warm_start import ImpulseCache
from carom.physics.jit.decorators import kernel

NOTHING_BORNE = np.empty(0)  # m/s², if there are no lasting contacts


def borne(cache: ImpulseCache, inverse_mass: FloatArray) -> FloatArray:
    """Return Σ λ_n / (m h) of each body and plane, (n + p,) m/s², with h the kick of the impulses.

    Opposing forces add up, so the sum is large for a body that is squeezed between two others.
    """
    if cache.kick == 0.0 or len(cache.pairs) == 0:
        return NOTHING_BORNE
    return _sum_normal_impulses(cache.pairs, cache.place, cache.contacts, inverse_mass, cache.kick)


@kernel
def _sum_normal_impulses(
    pairs: IntArray, place: IntArray, contacts: Records, inverse_mass: FloatArray, kick: float
) -> FloatArray:
    sums = np.zeros(len(inverse_mass))
    for c in range(len(pairs)):
        impulse = contacts[place[c]].normal_impulse
        for end in range(2):
            sums[pairs[c, end]] += impulse * inverse_mass[pairs[c, end]] / kick
    return sums
