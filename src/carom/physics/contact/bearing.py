"""What lasting contacts bear of each body's acceleration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.lasting import Hold
from carom.physics.parallel.jit import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NOTHING_BORNE = np.empty(0)  # m/s², where no contact lasts


def borne(hold: Hold, inverse_mass: FloatArray) -> FloatArray:
    """Return Σ λ_n / (m h) of each body and plane, (n + p,) m/s², h the kick that the impulses were for.

    Forces that oppose each other add up: what is squeezed between two bodies is borne all the more.
    """
    if hold.kick == 0.0 or len(hold.pairs) == 0:
        return NOTHING_BORNE
    return _sum_normal_impulses(hold.pairs, hold.impulse, inverse_mass, hold.kick)


@kernel
def _sum_normal_impulses(pairs: IntArray, impulse: FloatArray, inverse_mass: FloatArray, kick: float) -> FloatArray:
    sums = np.zeros(len(inverse_mass))
    for c in range(len(pairs)):
        for end in range(2):
            sums[pairs[c, end]] += impulse[c, 0] * inverse_mass[pairs[c, end]] / kick
    return sums
