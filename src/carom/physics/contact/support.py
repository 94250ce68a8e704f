"""What lasting contacts bear of each body's acceleration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.solver.warm_start import ImpulseCache
from carom.physics.parallel.jit import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

NOTHING_BORNE = np.empty(0)  # m/s², where no contact lasts


def borne(cache: ImpulseCache, inverse_mass: FloatArray) -> FloatArray:
    """Return Σ λ_n / (m h) of each body and plane, (n + p,) m/s², h the kick that the impulses were for.

    Forces that oppose each other add up: what is squeezed between two bodies is borne all the more.
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
