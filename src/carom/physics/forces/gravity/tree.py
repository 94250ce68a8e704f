"""Gravity by a tree: distant boxes of bodies attract as a whole.

`boxes` sorts the bodies into boxes. The moments of a box about its centre of mass are summed over its bodies, not over
its halves. These sums take a twelfth of the whole time, and make b exact:

    M = Σ m_i      X = Σ m_i x_i / M      Q = 3 Σ m_i y_i y_iᵀ      b = max |y_i|      y_i = x_i - X

Each group of bodies walks through the tree once. A box replaces its bodies if its angular radius b/d, as seen from the
nearest point of the group's box, is below θ. Otherwise the walk opens it; the bodies of a leaf are summed one by one.
With d = X - x, R² = d² + ε²:

    a = G [ (M/R³ + (5/2 dᵀQd/R² - tr Q/2)/R⁵) d - Q d/R⁵ ]
    φ = -G [ M/R + (1/2 dᵀQd/R² - tr Q/6)/R³ ]

Here a = -∇φ, for any softening ε. Without quadrupoles, Q = 0. The opening angle θ determines the error of the forces
(measured in docs/physics.md), and the error of the total momentum, because the two forces of a pair are not opposite.

The bodies of a group are in the SIMD lanes, and boxes and bodies are added one after another, so the bits depend
neither on the SIMD width nor on the threads. Each thread takes the next piece of work until none is left, so all
threads end at about the same time. Pieces assigned in advance would take different times, because bodies in dense
regions take far longer than others.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, Records, dtype_of
from carom.physics.aligned import aligned_empty
from carom.physics.forces.gravity.boxes import GROUP, RANGE, Boxes
from carom.physics.forces.gravity.direct import PARALLEL_FROM, potential_energy
from carom.physics.forces.gravity.pair import attraction, own_potential
from carom.physics.jit.decorators import inner, long_kernel
from carom.physics.jit.instructions import atomic_add, prefetch_to_read
from carom.physics.jit.team import SOLO, Team
from carom.scene.schema import Gravity

BOXES_PER_TASK = 64  # number of boxes for about 10 µs of work
EXACT_UP_TO = 4  # boxes with so few bodies are summed body by body, which is exact and about as fast as their moments


class CentreRecord(Protocol):
    """The centre of a box, and the distance beyond which its moments replace its bodies."""

    x: float  # m, X
    y: float
    z: float
    far_squared: float  # m², (b/θ)²: beyond this distance M and Q replace the bodies


CENTRE = dtype_of(CentreRecord)


class MomentsRecord(Protocol):
    """The moments of a box, in one cache line."""

    mass: float  # kg, M
    xx: float  # kg m², components of Q
    xy: float
    xz: float
    yy: float
    yz: float
    zz: float
    trace_sixth: float  # kg m², tr Q / 6


MOMENTS = dtype_of(MomentsRecord)
X, Y, Z, AX, AY, AZ, PHI = range(7)  # rows of the lanes: positions of a group's bodies, then sums
LANES_PER_REGISTER = 8  # float64 in the widest registers; loops over whole registers leave no remainder


class BoxTree(NamedTuple):
    """Boxes with their moments, and the bodies in the order of the boxes."""

    boxes: int  # number of boxes; the arrays may be longer
    first: IntArray  # first body of each box
    last: IntArray  # end of the range of each box's bodies
    skip: IntArray  # the next box outside each box
    centres: RecordArray[CentreRecord]
    moments: RecordArray[MomentsRecord]
    x: FloatArray  # (3, n) m
    m: FloatArray  # (n,) kg
    body: IntArray  # (n,) index of each body in the scene
    groups: IntArray  # (g + 1,) first body of each group, and n


class TreeLaw(NamedTuple):
    """How boxes and bodies attract."""

    G: float  # m³/(kg s²)
    eps2: float  # m², softening squared
    quadrupoles: bool


class TreeBuffers(NamedTuple):
    """Workspace of each thread."""

    lanes: FloatArray  # (threads, 7, GROUP) a group's bodies and their sums
    far: IntArray  # (threads, ·) boxes that attract as a whole
    near: Records  # (threads, ·) RANGE of bodies that attract one by one


@long_kernel
def expand(lo: int, hi: int, taken_so_far: IntArray, tree: BoxTree, theta: float) -> None:
    """Write the moments of all boxes for an opening angle (rad).

    Each of the threads [lo, hi) takes the next `BOXES_PER_TASK` boxes until none are left; ``taken_so_far``, (1,),
    counts these pieces.
    """
    boxes, first, last, x, m = tree.boxes, tree.first, tree.last, tree.x, tree.m
    centres, moments = tree.centres, tree.moments
    while True:
        begin = BOXES_PER_TASK * atomic_add(taken_so_far, 0, 1)
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
            if M > 0.0:  # without mass, all bodies are test particles, and any centre will do
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


@long_kernel
def attract_groups(
    lo: int,
    hi: int,
    taken_so_far: IntArray,
    tree: BoxTree,
    law: TreeLaw,
    buffers: TreeBuffers,
    acceleration: FloatArray,
    potential: FloatArray | None,
) -> None:
    """Write acceleration and potential of all groups.

    Each of the threads [lo, hi) takes the next group until none is left; ``taken_so_far``, (1,), counts the groups.
    """
    lanes, far, near = buffers.lanes[lo], buffers.far[lo], buffers.near[lo]
    body, m, G = tree.body, tree.m, law.G
    eps2 = law.eps2
    own = own_potential(eps2)
    while True:
        group = atomic_add(taken_so_far, 0, 1)
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


@inner
def _walk(
    i0: int, bodies: int, width: int, tree: BoxTree, lanes: FloatArray, far: IntArray, near: Records
) -> tuple[int, int]:
    """Copy a group's bodies into the lanes, and list the boxes and ranges that attract them; return their numbers."""
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
            # prefetching saves 2 to 5 % of the time, and more if other processes use the cache
            prefetch_to_read(tree.moments, box)
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


@inner
def _add_monopoles(
    fars: int, far: IntArray, width: int, tree: BoxTree, eps2: float, lanes: FloatArray, potential: FloatArray | None
) -> None:
    for c in range(fars):
        centre, M = tree.centres[far[c]], tree.moments[far[c]].mass
        cx, cy, cz = centre.x, centre.y, centre.z
        for k in range(np.uint64(width)):
            dx, dy, dz = cx - lanes[X, k], cy - lanes[Y, k], cz - lanes[Z, k]
            r2 = dx * dx + dy * dy + dz * dz + eps2
            s = attraction(M, r2)
            lanes[AX, k] += s * dx
            lanes[AY, k] += s * dy
            lanes[AZ, k] += s * dz
            if potential is not None:
                lanes[PHI, k] += s * r2


@inner
def _add_quadrupoles(
    fars: int, far: IntArray, width: int, tree: BoxTree, eps2: float, lanes: FloatArray, potential: FloatArray | None
) -> None:
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


@inner
def _add_bodies(
    nears: int, near: Records, width: int, tree: BoxTree, eps2: float, lanes: FloatArray, potential: FloatArray | None
) -> None:
    x, m = tree.x, tree.m
    for r in range(nears):
        for j in range(near[r].begin, near[r].end):
            xj, yj, zj, mj = x[X, j], x[Y, j], x[Z, j], m[j]
            for k in range(np.uint64(width)):
                dx, dy, dz = xj - lanes[X, k], yj - lanes[Y, k], zj - lanes[Z, k]
                r2 = dx * dx + dy * dy + dz * dz + eps2
                s = attraction(mj, r2)
                lanes[AX, k] += s * dx
                lanes[AY, k] += s * dy
                lanes[AZ, k] += s * dz
                if potential is not None:
                    lanes[PHI, k] += s * r2


class TreeGravity:
    """Tree gravity between n bodies, with its workspace."""

    def __init__(
        self,
        mass: FloatArray,
        constant: float,
        softening: float,
        opening_angle: float,
        quadrupoles: bool = True,
        team: Team = SOLO,
    ) -> None:
        n = len(mass)
        self._mass = mass
        self._constant = constant
        self._softening_squared = softening * softening
        self._opening_angle = opening_angle
        self._quadrupoles = quadrupoles
        self._team = team if n >= PARALLEL_FROM else SOLO
        self._boxes = Boxes(mass, self._team)
        self._centres = np.empty(self._boxes.most, CENTRE)
        self._moments = aligned_empty(self._boxes.most, MOMENTS)
        self._potential = np.zeros(n)
        self._taken = np.zeros(1, np.int64)  # number of pieces of work taken so far
        size, most = self._team.size, self._boxes.most
        self._buffers = TreeBuffers(
            np.empty((size, 7, GROUP)), np.empty((size, most), np.int64), np.empty((size, n), RANGE)
        )

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the accelerations; see `GravityMethod`. The energy takes about a tenth more time."""
        boxes, team = self._boxes, self._team
        boxes.sort(position)
        tree = BoxTree(
            boxes.count,
            *(boxes.first, boxes.last, boxes.skip, self._centres, self._moments),
            *(boxes.position, boxes.mass, boxes.body, boxes.groups),
        )
        law = TreeLaw(self._constant, self._softening_squared, self._quadrupoles)
        results = acceleration, self._potential if potential else None
        self._taken[0] = 0
        team.divide(team.size, 1, expand, self._taken, tree, self._opening_angle)
        self._taken[0] = 0
        team.divide(team.size, 1, attract_groups, self._taken, tree, law, self._buffers, *results)
        return potential_energy(self._mass, self._potential) if potential else None


def make(gravity: Gravity, mass: FloatArray, team: Team) -> TreeGravity:
    """Return the tree for a scene's gravity section."""
    accuracy = gravity.opening_angle, gravity.quadrupoles
    return TreeGravity(mass, gravity.constant, gravity.softening, *accuracy, team)
