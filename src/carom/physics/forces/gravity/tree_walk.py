"""Tree walks, one for each group of bodies, and the sums over the boxes and bodies that they find.

A box with the moments M, Q about X replaces its bodies if its angular radius b/d, seen from the nearest point of the
group's own box, is below θ. Otherwise the walk opens it; the bodies of a leaf are taken one by one. With d = X - x,
R² = d² + ε²:

    a = G [ (M/R³ + (5/2 dᵀQd/R² - tr Q/2)/R⁵) d - Q d/R⁵ ]
    φ = -G [ M/R + (1/2 dᵀQd/R² - tr Q/6)/R³ ]

a is -∇φ, and both hold for any softening ε. Without quadrupoles, Q = 0. The bodies of a group lie in the SIMD lanes,
and boxes and bodies are taken in turn, so the bits depend on neither the SIMD width nor the threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.atomics import atomic_add
from carom.physics.parallel.jit import long_kernel
from carom.physics.parallel.prefetch import prefetch_to_read

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

X, Y, Z, AX, AY, AZ, PHI = range(7)  # rows of the lanes: positions of a group's bodies, and their sums
LANES_PER_REGISTER = 8  # of float64, in the widest registers; loops over whole registers leave no remainder


@long_kernel
def pull(
    lo: int,
    hi: int,
    turn: IntArray,
    boxes: int,
    first: IntArray,
    last: IntArray,
    skip: IntArray,
    centres: Records,
    moments: Records,
    x: FloatArray,
    m: FloatArray,
    body: IntArray,
    edges: IntArray,
    G: float,
    eps2: float,
    quadrupoles: bool,
    lanes_of: FloatArray,
    far_of: IntArray,
    near_of: Records,
    acceleration: FloatArray,
    potential: FloatArray | None,
) -> None:
    """Write acceleration and potential of all groups.

    Each of the threads [lo, hi) takes the next group until none are left; ``turn``, (1,), counts the groups taken.
    """
    own = eps2 / (eps2 * np.sqrt(eps2)) if eps2 > 0.0 else 0.0  # 1/ε, the potential of a body at its own position
    lanes, far, near = lanes_of[lo], far_of[lo], near_of[lo]
    while True:
        group = atomic_add(turn, 0, 1)
        if group >= len(edges) - 1:
            return
        i0 = edges[group]
        bodies = edges[group + 1] - i0
        width = -(-bodies // LANES_PER_REGISTER) * LANES_PER_REGISTER
        x0 = x1 = x[X, i0]
        y0 = y1 = x[Y, i0]
        z0 = z1 = x[Z, i0]
        for lane in range(width):
            i = i0 + min(lane, bodies - 1)  # spare lanes repeat the last body; their results are discarded
            x0, x1 = min(x0, x[X, i]), max(x1, x[X, i])
            y0, y1 = min(y0, x[Y, i]), max(y1, x[Y, i])
            z0, z1 = min(z0, x[Z, i]), max(z1, x[Z, i])
            lanes[X, lane], lanes[Y, lane], lanes[Z, lane] = x[X, i], x[Y, i], x[Z, i]
            lanes[AX, lane] = lanes[AY, lane] = lanes[AZ, lane] = lanes[PHI, lane] = 0.0
        box = fars = nears = 0
        while box < boxes:
            centre = centres[box]
            dx = max(x0 - centre.x, 0.0, centre.x - x1)
            dy = max(y0 - centre.y, 0.0, centre.y - y1)
            dz = max(z0 - centre.z, 0.0, centre.z - z1)
            if dx * dx + dy * dy + dz * dz > centre.far_squared:
                prefetch_to_read(moments, box)  # saves 2 to 5 % of the whole; more if other processes use the cache
                far[fars] = box
                fars += 1
                box = skip[box]
            else:
                if skip[box] == box + 1:
                    if nears > 0 and near[nears - 1].end == first[box]:
                        near[nears - 1].end = last[box]
                    else:
                        near[nears].begin, near[nears].end = first[box], last[box]
                        nears += 1
                box += 1
        for c in range(fars):
            box = far[c]
            centre, moment = centres[box], moments[box]
            cx, cy, cz, M = centre.x, centre.y, centre.z, moment.mass
            if not quadrupoles:
                for k in range(np.uint64(width)):
                    dx, dy, dz = cx - lanes[X, k], cy - lanes[Y, k], cz - lanes[Z, k]
                    r2 = dx * dx + dy * dy + dz * dz + eps2
                    s = M / (r2 * np.sqrt(r2))
                    lanes[AX, k] += s * dx
                    lanes[AY, k] += s * dy
                    lanes[AZ, k] += s * dz
                    if potential is not None:
                        lanes[PHI, k] += s * r2
                continue
            xx, xy, xz = moment.xx, moment.xy, moment.xz
            yy, yz, zz, t = moment.yy, moment.yz, moment.zz, moment.trace_sixth
            for k in range(np.uint64(width)):
                dx, dy, dz = cx - lanes[X, k], cy - lanes[Y, k], cz - lanes[Z, k]
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
                lanes[AX, k] += s * dx - w5 * qx
                lanes[AY, k] += s * dy - w5 * qy
                lanes[AZ, k] += s * dz - w5 * qz
                if potential is not None:
                    lanes[PHI, k] += M * w + w3 * (0.5 * h - t)
        for r in range(nears):
            for j in range(near[r].begin, near[r].end):
                xj, yj, zj, mj = x[X, j], x[Y, j], x[Z, j], m[j]
                for k in range(np.uint64(width)):
                    dx, dy, dz = xj - lanes[X, k], yj - lanes[Y, k], zj - lanes[Z, k]
                    r2 = dx * dx + dy * dy + dz * dz + eps2
                    s = mj / (r2 * np.sqrt(r2)) if r2 > 0.0 else 0.0
                    lanes[AX, k] += s * dx
                    lanes[AY, k] += s * dy
                    lanes[AZ, k] += s * dz
                    if potential is not None:
                        lanes[PHI, k] += s * r2
        for lane in range(bodies):
            i = body[i0 + lane]
            acceleration[i, 0] = G * lanes[AX, lane]
            acceleration[i, 1] = G * lanes[AY, lane]
            acceleration[i, 2] = G * lanes[AZ, lane]
            if potential is not None:
                potential[i] = -G * (lanes[PHI, lane] - own * m[i0 + lane])
