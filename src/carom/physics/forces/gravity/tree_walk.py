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

from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.physics.forces.gravity.direct import own_potential
from carom.physics.jit.atomics import atomic_add
from carom.physics.jit.decorators import long_kernel, unowned
from carom.physics.jit.prefetch import prefetch_to_read

X, Y, Z, AX, AY, AZ, PHI = range(7)  # rows of the lanes: positions of a group's bodies, and their sums
LANES_PER_REGISTER = 8  # of float64, in the widest registers; loops over whole registers leave no remainder


class Tree(NamedTuple):
    """Boxes with their moments, and the bodies in their order."""

    boxes: int  # their number; the arrays may be longer
    first: IntArray  # first body of each box
    last: IntArray  # the one after its last body
    skip: IntArray  # the box after it and all boxes in it
    centres: Records  # CENTRE
    moments: Records  # MOMENTS
    x: FloatArray  # (3, n) m
    m: FloatArray  # (n,) kg
    body: IntArray  # (n,) number of each body in the scene
    groups: IntArray  # (g + 1,) first body of each group, and n


class PullLaw(NamedTuple):
    """How boxes and bodies pull."""

    G: float  # m³/(kg s²)
    eps2: float  # m², softening squared
    quadrupoles: bool


class Lists(NamedTuple):
    """Room for each of the threads."""

    lanes: FloatArray  # (threads, 7, GROUP) a group's bodies and their sums
    far: IntArray  # (threads, ·) boxes that pull as a whole
    near: Records  # (threads, ·) RANGE, bodies that pull one by one


@long_kernel
def pull(
    lo: int,
    hi: int,
    turn: IntArray,
    tree: Tree,
    law: PullLaw,
    lists: Lists,
    acceleration: FloatArray,
    potential: FloatArray | None,
) -> None:
    """Write acceleration and potential of all groups.

    Each of the threads [lo, hi) takes the next group until none are left; ``turn``, (1,), counts the groups taken.
    """
    lanes, far, near = lists.lanes[lo], lists.far[lo], lists.near[lo]
    body, m, G = tree.body, tree.m, law.G
    eps2 = law.eps2
    own = own_potential(eps2)
    while True:
        group = atomic_add(turn, 0, 1)
        if group >= len(tree.groups) - 1:
            return
        i0 = tree.groups[group]
        bodies = tree.groups[group + 1] - i0
        width = -(-bodies // LANES_PER_REGISTER) * LANES_PER_REGISTER
        fars, nears = _walk(i0, bodies, width, tree, lanes, far, near)
        if law.quadrupoles:
            _add_quadrupoles(fars, far, width, tree, eps2, lanes, potential)
        else:
            _add_monopoles(fars, far, width, tree, eps2, lanes, potential)
        _add_bodies(nears, near, width, tree, eps2, lanes, potential)
        for lane in range(bodies):
            i = body[i0 + lane]
            acceleration[i, 0] = G * lanes[AX, lane]
            acceleration[i, 1] = G * lanes[AY, lane]
            acceleration[i, 2] = G * lanes[AZ, lane]
            if potential is not None:
                potential[i] = -G * (lanes[PHI, lane] - own * m[i0 + lane])


@unowned
def _walk(
    i0: int, bodies: int, width: int, tree: Tree, lanes: FloatArray, far: IntArray, near: Records
) -> tuple[int, int]:
    """Lay a group's bodies into the lanes, and list what pulls them; return how many boxes and ranges of bodies."""
    x = tree.x
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
    while box < tree.boxes:
        centre = tree.centres[box]
        dx = max(x0 - centre.x, 0.0, centre.x - x1)
        dy = max(y0 - centre.y, 0.0, centre.y - y1)
        dz = max(z0 - centre.z, 0.0, centre.z - z1)
        if dx * dx + dy * dy + dz * dz > centre.far_squared:
            prefetch_to_read(tree.moments, box)  # saves 2 to 5 % of the whole; more if other processes use the cache
            far[fars] = box
            fars += 1
            box = tree.skip[box]
        else:
            if tree.skip[box] == box + 1:
                if nears > 0 and near[nears - 1].end == tree.first[box]:
                    near[nears - 1].end = tree.last[box]
                else:
                    near[nears].begin, near[nears].end = tree.first[box], tree.last[box]
                    nears += 1
            box += 1
    return fars, nears


@unowned
def _add_monopoles(
    fars: int, far: IntArray, width: int, tree: Tree, eps2: float, lanes: FloatArray, potential: FloatArray | None
) -> None:
    """Add the pull of the far boxes, without quadrupoles."""
    for c in range(fars):
        centre, M = tree.centres[far[c]], tree.moments[far[c]].mass
        cx, cy, cz = centre.x, centre.y, centre.z
        for k in range(np.uint64(width)):
            dx, dy, dz = cx - lanes[X, k], cy - lanes[Y, k], cz - lanes[Z, k]
            r2 = dx * dx + dy * dy + dz * dz + eps2
            s = M / (r2 * np.sqrt(r2))
            lanes[AX, k] += s * dx
            lanes[AY, k] += s * dy
            lanes[AZ, k] += s * dz
            if potential is not None:
                lanes[PHI, k] += s * r2


@unowned
def _add_quadrupoles(
    fars: int, far: IntArray, width: int, tree: Tree, eps2: float, lanes: FloatArray, potential: FloatArray | None
) -> None:
    """Add the pull of the far boxes, quadrupoles included."""
    for c in range(fars):
        centre, moment = tree.centres[far[c]], tree.moments[far[c]]
        cx, cy, cz, M = centre.x, centre.y, centre.z, moment.mass
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


@unowned
def _add_bodies(
    nears: int, near: Records, width: int, tree: Tree, eps2: float, lanes: FloatArray, potential: FloatArray | None
) -> None:
    """Add the pull of the bodies in the near ranges."""
    x, m = tree.x, tree.m
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
