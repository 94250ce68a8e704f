"""What lasting contacts carry over from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.lasting import Hold


@dataclass(frozen=True, slots=True)
class ContactMemory:
    """The contacts of a step, as far as the next one begins with them; nothing writes to its arrays."""

    pairs: NDArray[np.int64]  # (m, 2), sorted; what was only near counts
    rest_speed: NDArray[np.float64]  # (m,) m/s, up to which a contact is at rest
    dt: float  # s, the step that the speeds are for
    hold: Hold
