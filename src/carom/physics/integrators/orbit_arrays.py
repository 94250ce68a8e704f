"""`Orbits`, the arrays of a Wisdom–Holman integration, and `RUN`, its progress."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray


class Orbits(NamedTuple):
    """Arrays of an integration; all but the first two are in the order of the Jacobi coordinates."""

    position: FloatArray  # (n, 3) m, the output, in the order of the scene
    velocity: FloatArray  # (n, 3) m/s, likewise
    order: IntArray  # (n,) index in the scene
    mu: FloatArray  # (n,) m³/s², G M_i
    pull: FloatArray  # (n,) m³/s², G m_i
    share: FloatArray  # (n,) m_i / M_i
    near: FloatArray  # (n,) m, the distance from which another body is close
    x: FloatArray  # (n, 3) m, Jacobi coordinates after the last kick; row 0 is the centre of mass
    v: FloatArray  # (n, 3) m/s
    x_spare: FloatArray  # (n, 3) m
    v_spare: FloatArray  # (n, 3) m/s
    place: FloatArray  # (n, 3) m, from the centre of mass
    speed: FloatArray  # (n, 3) m/s, likewise
    acceleration: FloatArray  # (n, 3) m/s²
    reach: FloatArray  # (n,) m, how far a body may move meanwhile
    lanes: FloatArray  # workspace of the Kepler orbits and of the pulls of many


RUN = np.dtype(
    [
        ("start", np.float64),  # s, the time at which the present series of equal steps began
        ("count", np.int64),  # steps since then
        ("dt", np.float64),  # s
        ("time", np.float64),  # s
        ("before", np.float64),  # s, the time before the last step
        ("steps", np.int64),  # of this call
        ("close", np.int64),  # 1 if the next step would meet a close encounter
    ]
)
