"""The moments of boxes of bodies, about their centres of mass.

    M = Σ m_i      X = Σ m_i x_i / M      Q = 3 Σ m_i y_i y_iᵀ      b = max |y_i|      y_i = x_i - X

They are summed over the bodies of each box, not over its halves. This costs a twelfth of the whole evaluation and makes
b exact.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.physics.jit.atomics import atomic_add
from carom.physics.jit.decorators import long_kernel

BOXES_PER_TASK = 64  # about 10 µs
EXACT_UP_TO = 4  # bodies; so few are summed one by one, which is exact and hardly slower than their moments


CENTRE = np.dtype(
    [
        ("x", np.float64),  # m, X
        ("y", np.float64),
        ("z", np.float64),
        ("far_squared", np.float64),  # m², (b/θ)²: beyond this distance M and Q replace the bodies
    ]
)

MOMENTS = np.dtype(  # a cache line
    [("mass", np.float64)]  # kg, M
    + [(component, np.float64) for component in ("xx", "xy", "xz", "yy", "yz", "zz")]  # kg m², of Q
    + [("trace_sixth", np.float64)]  # kg m², tr Q / 6
)


@long_kernel
def expand(
    lo: int,
    hi: int,
    turn: IntArray,
    boxes: int,
    first: IntArray,
    last: IntArray,
    x: FloatArray,
    m: FloatArray,
    theta: float,
    centres: Records,
    moments: Records,
) -> None:
    """Write the moments of all boxes.

    Parameters
    ----------
    lo, hi
        Range of threads; each takes the next `BOXES_PER_TASK` boxes until none are left.
    turn
        (1,), how many times boxes were taken.
    boxes, first, last
        Number of boxes, and the range of bodies of each.
    x, m
        (3, n) m and (n,) kg, sorted.
    theta
        rad, the opening angle.
    centres, moments
        (boxes,) `CENTRE` and `MOMENTS`.
    """
    while True:
        begin = BOXES_PER_TASK * atomic_add(turn, 0, 1)
        if begin >= boxes:
            return
        for box in range(begin, min(begin + BOXES_PER_TASK, boxes)):
            i0, i1 = first[box], last[box]
            x0, y0, z0 = x[0, i0], x[1, i0], x[2, i0]
            M = X = Y = Z = 0.0
            for i in range(i0, i1):
                M += m[i]
                X += m[i] * (x[0, i] - x0)
                Y += m[i] * (x[1, i] - y0)
                Z += m[i] * (x[2, i] - z0)
            if M > 0.0:  # or all are test particles, and any centre will do
                X, Y, Z = X / M, Y / M, Z / M
            X, Y, Z = x0 + X, y0 + Y, z0 + Z
            xx = xy = xz = yy = yz = zz = b2 = 0.0
            for i in range(i0, i1):
                dx, dy, dz = x[0, i] - X, x[1, i] - Y, x[2, i] - Z
                mx, my, mz = m[i] * dx, m[i] * dy, m[i] * dz
                xx += mx * dx
                xy += mx * dy
                xz += mx * dz
                yy += my * dy
                yz += my * dz
                zz += mz * dz
                b2 = max(b2, dx * dx + dy * dy + dz * dz)
            centre, moment = centres[box], moments[box]
            centre.x, centre.y, centre.z = X, Y, Z
            centre.far_squared = b2 / (theta * theta) if i1 - i0 > EXACT_UP_TO else np.inf
            moment.mass = M
            moment.xx, moment.xy, moment.xz = 3.0 * xx, 3.0 * xy, 3.0 * xz
            moment.yy, moment.yz, moment.zz = 3.0 * yy, 3.0 * yz, 3.0 * zz
            moment.trace_sixth = 0.5 * (xx + yy + zz)
