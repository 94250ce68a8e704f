"""The geometry of each contact: where two ends meet.

Both bodies share one contact point on the line of centres, d r_i/(r_i + r_j) from i and the rest of d from j. A plane
is touched with the whole radius and has no lever arm: it takes any angular momentum, so the arm need not add up to the
distance, and an impact that is found late turns the body as it would have at the surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.load import OVERLAP
from carom.physics.parallel.jit import long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@long_kernel
def meet(
    lo: int,
    hi: int,
    pairs: IntArray,
    x: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    surface: FloatArray,
    offset: FloatArray,
    hot: FloatArray,
    cold: FloatArray,
) -> None:
    """Write normals from i to j, lever arms and overlaps of the contacts [lo, hi)."""
    n = len(x)
    for c in range(lo, hi):
        i, j = pairs[c, 0], pairs[c, 1]
        if j >= n:
            height = -offset[j - n]
            for k in range(3):
                height += surface[j - n, k] * x[i, k]
                hot[c, k] = -surface[j - n, k]
            hot[c, 3], hot[c, 4] = radius[i], 0.0
            cold[c, OVERLAP] = radius[i] - height
            continue
        d2 = 0.0
        for k in range(3):
            d = x[j, k] - x[i, k]
            if box[k] > 0.0:
                d -= box[k] * np.floor(d / box[k] + 0.5)
            hot[c, k] = d
            d2 += d * d
        d = np.sqrt(d2)
        if d > 0.0:
            for k in range(3):
                hot[c, k] /= d
        else:  # coincident centres: any direction will do, as long as it is always the same
            hot[c, 0], hot[c, 1], hot[c, 2] = 1.0, 0.0, 0.0
        share = d / (radius[i] + radius[j])
        hot[c, 3], hot[c, 4] = share * radius[i], share * radius[j]
        cold[c, OVERLAP] = radius[i] + radius[j] - d
