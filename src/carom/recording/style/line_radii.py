"""Radii of lines and arrows, for scenes of any size.

Rerun 0.41 draws lines with radii in half precision: those above 65 504 units are not drawn at all, and those below
10⁻⁶ are rounded by more than 3 %. In such scenes lines get radii in points of the screen, which Rerun takes from
negative numbers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_LEAST, _LARGEST = 1e-6, 6e4  # m
_POINTS = 40.0  # of the screen, for the radius of a body


def line_radii(share: ArrayLike, body: float) -> NDArray[np.float32]:
    """Return radii for the viewer.

    Parameters
    ----------
    share
        (...) radii of lines in radii of a body.
    body
        m, the radius of the body.
    """
    shares = np.asarray(share, dtype=np.float64)
    radii = shares * body
    drawn = radii.min() >= _LEAST and radii.max() <= _LARGEST
    return (radii if drawn else -_POINTS * shares).astype(np.float32)
