"""What an integrator carries from step to step besides positions and velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class IntegratorCheckpoint:
    """The memory of Gauss–Radau integration; rows of the last two are the coordinates of body after body."""

    last_dt: float  # s
    position_rest: FloatArray  # (n, 3) m, what rounding has kept from the positions so far
    velocity_rest: FloatArray  # (n, 3) m/s
    accepted: FloatArray  # (3 n, 8) m/s², coefficients of the last step's polynomial
    correction: FloatArray  # (3 n, 8) m/s², by how much their prediction was wrong
