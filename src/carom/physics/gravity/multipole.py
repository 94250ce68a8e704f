"""The moments of boxes of bodies, about their centres of mass.

    M = Σ m_i      X = Σ m_i x_i / M      Q = 3 Σ m_i y_i y_iᵀ      b = max |y_i|      y_i = x_i - X

They are summed over the bodies of each box, not over its halves: that costs a twelfth of the whole, and
only so b is exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.atomics import atomic_add
from carom.physics.parallel.jit import long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BOXES_AT_A_TIME = 64  # some 10 µs
FEW = 4  # bodies at most that are taken one by one: hardly slower than their moments, and exact


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
    centre: FloatArray,
    moment: FloatArray,
) -> None:
    """Write the moments of all boxes.

    Parameters
    ----------
    lo, hi
        Threads, of which each takes the next `BOXES_AT_A_TIME` boxes until there are no more.
    turn
        (1,), how often some were taken.
    boxes, first, last
        How many, and the bodies of each.
    x, m
        (3, n) m and (n,) kg, sorted.
    theta
        rad, the opening angle.
    centre
        (boxes, 4): X, and the squared distance (b/θ)² beyond which M and Q stand for the bodies.
    moment
        (boxes, 8): M, the upper triangle of Q by rows, and tr Q / 6.
    """
    while True:
        begin = BOXES_AT_A_TIME * atomic_add(turn, 0, 1)
        if begin >= boxes:
            return
        for box in range(begin, min(begin + BOXES_AT_A_TIME, boxes)):
            i0, i1 = first[box], last[box]
            x0, y0, z0 = x[0, i0], x[1, i0], x[2, i0]
            M = X = Y = Z = 0.0
            for i in range(i0, i1):
                M += m[i]
                X += m[i] * (x[0, i] - x0)
                Y += m[i] * (x[1, i] - y0)
                Z += m[i] * (x[2, i] - z0)
            X, Y, Z = x0 + X / M, y0 + Y / M, z0 + Z / M
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
            centre[box, 0], centre[box, 1], centre[box, 2] = X, Y, Z
            centre[box, 3] = b2 / (theta * theta) if i1 - i0 > FEW else np.inf
            moment[box, 0] = M
            moment[box, 1], moment[box, 2], moment[box, 3] = 3.0 * xx, 3.0 * xy, 3.0 * xz
            moment[box, 4], moment[box, 5], moment[box, 6] = 3.0 * yy, 3.0 * yz, 3.0 * zz
            moment[box, 7] = 0.5 * (xx + yy + zz)
