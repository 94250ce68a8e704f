"""One walk through the boxes for each group of bodies, and the sums over what it finds.

A box of moments M, Q about X stands for its bodies if it is seen from the nearest point of the group's own box under
an angle b/d < θ; else the walk looks into it, and at a leaf takes the bodies one by one. With d = X - x, R² = d² + ε²:

    a = G [ (M/R³ + (5/2 dᵀQd/R² - tr Q/2)/R⁵) d - Q d/R⁵ ]
    φ = -G [ M/R + (1/2 dᵀQd/R² - tr Q/6)/R³ ]

a is -∇φ, and both hold for any softening ε. Without quadrupoles, Q = 0. The group's bodies lie in the SIMD lanes and
every box and body is taken in turn, so that the bits depend neither on the SIMD width nor on the threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.atomics import atomic_add
from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.prefetch import prefetch_to_read

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

WIDEST = 8  # lanes of float64 in the widest registers: a loop over whole registers leaves no remainder


@long_kernel
def pull(
    lo: int,
    hi: int,
    turn: IntArray,
    boxes: int,
    first: IntArray,
    last: IntArray,
    skip: IntArray,
    centre: FloatArray,
    moment: FloatArray,
    x: FloatArray,
    m: FloatArray,
    body: IntArray,
    edges: IntArray,
    G: float,
    eps2: float,
    quadrupoles: bool,
    lanes_of: FloatArray,
    far_of: IntArray,
    near_of: IntArray,
    acceleration: FloatArray,
    potential: FloatArray | None,
) -> None:
    """Write acceleration and potential of all groups.

    Each of the threads from lo to hi takes the next group until there are no more; ``turn``, (1,), is how many were
    taken.
    """
    own = eps2 / (eps2 * np.sqrt(eps2)) if eps2 > 0.0 else 0.0  # 1/ε: softened, a body would sit in its own potential
    T, far, near = lanes_of[lo], far_of[lo], near_of[lo]
    while True:
        group = atomic_add(turn, 0, 1)
        if group >= len(edges) - 1:
            return
        i0 = edges[group]
        lanes = edges[group + 1] - i0
        width = -(-lanes // WIDEST) * WIDEST
        x0 = x1 = x[0, i0]
        y0 = y1 = x[1, i0]
        z0 = z1 = x[2, i0]
        for lane in range(width):
            i = i0 + min(lane, lanes - 1)  # spare lanes repeat the last body and are thrown away
            x0, x1 = min(x0, x[0, i]), max(x1, x[0, i])
            y0, y1 = min(y0, x[1, i]), max(y1, x[1, i])
            z0, z1 = min(z0, x[2, i]), max(z1, x[2, i])
            T[0, lane], T[1, lane], T[2, lane] = x[0, i], x[1, i], x[2, i]
            T[3, lane] = T[4, lane] = T[5, lane] = T[6, lane] = 0.0
        box = fars = nears = 0
        while box < boxes:
            dx = max(x0 - centre[box, 0], 0.0, centre[box, 0] - x1)
            dy = max(y0 - centre[box, 1], 0.0, centre[box, 1] - y1)
            dz = max(z0 - centre[box, 2], 0.0, centre[box, 2] - z1)
            if dx * dx + dy * dy + dz * dz > centre[box, 3]:
                prefetch_to_read(moment, box, 0)  # 2 to 5 % of the whole; more beside others who need the cache
                far[fars] = box
                fars += 1
                box = skip[box]
            else:
                if skip[box] == box + 1:
                    if nears > 0 and near[nears - 1, 1] == first[box]:
                        near[nears - 1, 1] = last[box]
                    else:
                        near[nears, 0], near[nears, 1] = first[box], last[box]
                        nears += 1
                box += 1
        for c in range(fars):
            box = far[c]
            X, Y, Z, M = centre[box, 0], centre[box, 1], centre[box, 2], moment[box, 0]
            if not quadrupoles:
                for k in range(np.uint64(width)):
                    dx, dy, dz = X - T[0, k], Y - T[1, k], Z - T[2, k]
                    r2 = dx * dx + dy * dy + dz * dz + eps2
                    s = M / (r2 * np.sqrt(r2))
                    T[3, k] += s * dx
                    T[4, k] += s * dy
                    T[5, k] += s * dz
                    if potential is not None:
                        T[6, k] += s * r2
                continue
            xx, xy, xz = moment[box, 1], moment[box, 2], moment[box, 3]
            yy, yz, zz, t = moment[box, 4], moment[box, 5], moment[box, 6], moment[box, 7]
            for k in range(np.uint64(width)):
                dx, dy, dz = X - T[0, k], Y - T[1, k], Z - T[2, k]
                r2 = dx * dx + dy * dy + dz * dz + eps2
                u = 1.0 / r2
                w = np.sqrt(r2) * u
                w3 = w * u
                w5 = w3 * u
                qx = xx * dx + xy * dy + xz * dz
                qy = xy * dx + yy * dy + yz * dz
                qz = xz * dx + yz * dy + zz * dz
                h = (qx * dx + qy * dy + qz * dz) * u
                s = M * w3 + w5 * (2.5 * h - 3.0 * t)
                T[3, k] += s * dx - w5 * qx
                T[4, k] += s * dy - w5 * qy
                T[5, k] += s * dz - w5 * qz
                if potential is not None:
                    T[6, k] += M * w + w3 * (0.5 * h - t)
        for r in range(nears):
            for j in range(near[r, 0], near[r, 1]):
                xj, yj, zj, mj = x[0, j], x[1, j], x[2, j], m[j]
                for k in range(np.uint64(width)):
                    dx, dy, dz = xj - T[0, k], yj - T[1, k], zj - T[2, k]
                    r2 = dx * dx + dy * dy + dz * dz + eps2
                    s = mj / (r2 * np.sqrt(r2)) if r2 > 0.0 else 0.0
                    T[3, k] += s * dx
                    T[4, k] += s * dy
                    T[5, k] += s * dz
                    if potential is not None:
                        T[6, k] += s * r2
        for lane in range(lanes):
            i = body[i0 + lane]
            acceleration[i, 0] = G * T[3, lane]
            acceleration[i, 1] = G * T[4, lane]
            acceleration[i, 2] = G * T[5, lane]
            if potential is not None:
                potential[i] = -G * (T[6, lane] - own * m[i0 + lane])
