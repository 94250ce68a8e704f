"""State of an integrator besides positions and velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class IntegratorCheckpoint:
    """State of Gauss–Radau integration; rows of the last two are the coordinates x, y, z of body after body."""

    last_dt: float  # s
    position_rest: FloatArray  # (n, 3) m, rounding errors of the positions so far
    velocity_rest: FloatArray  # (n, 3) m/s
    accepted: FloatArray  # (3 n, 8) m/s², coefficients of the last step's polynomial
    correction: FloatArray  # (3 n, 8) m/s², error of their prediction
