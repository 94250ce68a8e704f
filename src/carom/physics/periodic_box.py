"""The periodic box: distances go to the nearest image."""

from __future__ import annotations

import numpy as np

from carom.physics.parallel.jit import inline


@inline
def minimum_image(d: float, L: float) -> float:
    """Return one coordinate of a separation, d m, to the nearest image in a box of size L m: d - L ⌊d/L + ½⌋."""
    nearest: float = d - L * np.floor(d / L + 0.5)
    return nearest
