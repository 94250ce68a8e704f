"""Single precision, in which everything that is only drawn is recorded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def single(values: FloatArray) -> NDArray[np.float32]:
    """Round to float32; what is too large for it becomes infinite, as where kernels cast positions."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)
