"""What lasting contacts carry over from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ContactCheckpoint:
    """The contacts of a step, as far as the next one begins with them, and the impulses of its last kick.

    Nothing writes to its arrays.
    """

    pairs: IntArray  # (m, 2), sorted; what was only near counts
    rest_speed: FloatArray  # (m,) m/s, up to which a contact is at rest
    dt: float  # s, the step that the speeds are for
    held_pairs: IntArray  # (k, 2), sorted; mostly those above
    impulse: FloatArray  # (k, 4) N s: λ_n, λ_t
    kick: float  # s, how long that kick was

    @property
    def highest(self) -> int:
        """The highest number of a body or plane in it, -1 where there is none."""
        return max((int(pairs.max()) for pairs in (self.pairs, self.held_pairs) if len(pairs)), default=-1)
