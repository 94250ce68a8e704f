"""Walks over pairs of boxes, which decide whether boxes attract each other as a whole or body by body.

A walk begins with the pair of the whole tree and itself, and decides on each pair of boxes A, B:

1. If |X_A - X_B| > (r_A + r_B)/θ, the multipoles of B attract A as a local expansion, unless the boxes have so few
   pairs of bodies (`FEW_PAIRS`) that summing over the pairs is as fast.
2. Otherwise, if they have at most `MANY_PAIRS` pairs of bodies, or are both leaves, their bodies attract each other
   one by one.
3. Otherwise, the box with the larger radius is halved.

These decisions do not depend on which of the two boxes is A. The forces on A and B are therefore opposite, exactly for
single pairs of bodies and up to rounding for boxes, so momentum is conserved.

A walk descends from the whole tree to the bodies of one branch. Each box A on the way starts from its parent's local
expansion, moved to X_A. The walk then decides on the boxes B that the parent left undecided, and adds their
contributions. All sums for a body are therefore made by one thread, in the order of the walk.

Rejected: leaves of 32 bodies that are never halved (in a cluster they need twice the pairs, because large, sparse
leaves are near its dense centre); radii weighted by mass, (r_A + r_B) (M/M_total)^{1/8} (0.8 of the time in a ball, but
more in a cluster).
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from carom.arrays import FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.forces.gravity.boxes import RangeRecord
from carom.physics.forces.gravity.fast_multipole.taylor import (
    AX,
    AXIS,
    AY,
    AZ,
    FROM,
    LOCAL,
    LOWER,
    MOVE_LOCAL,
    PHI,
    POWER,
    SHARE,
    TO,
    X,
    Y,
    Z,
    attract,
    attract_bodies,
    evaluate,
)
from carom.physics.forces.gravity.pair import own_potential
from carom.physics.jit.decorators import inner, long_kernel
from carom.physics.jit.instructions import atomic_add
from carom.physics.jit.vectors import WIDTH as LANES

FEW_PAIRS = 128  # number of pairs of bodies that take as long as a pair of boxes
MANY_PAIRS = 1024  # largest number of pairs of bodies summed one by one; 512 and 2048 are as fast at equal error


class BoxRecord(Protocol):
    """A box, in one cache line."""

    x: float  # m, X
    y: float
    z: float
    radius: float  # m, r
    first: int  # first sorted body of the box
    last: int  # end of the range of the box's bodies
    half: int  # the box of the second half, 0 for a leaf; the box of the first half is the next box
    skip: int  # the next box outside this box


BOX = dtype_of(BoxRecord)


class EntryRecord(Protocol):
    """A box that the walk has yet to visit."""

    box: int
    begin: int  # range of the boxes that the parent left undecided
    end: int
    depth: int


ENTRY = dtype_of(EntryRecord)


class MultipoleBoxes(NamedTuple):
    """Boxes with their multipoles, and the bodies in the order of the boxes."""

    branches: RecordArray[RangeRecord]  # first box of each branch
    boxes: RecordArray[BoxRecord]
    poles: FloatArray  # (boxes + 1, ·) multipoles; the last row is for a box without mass
    x: FloatArray  # (3, n) m
    m: FloatArray  # (n,) kg
    body: IntArray  # (n,) index of each body in the scene


class MultipoleLaw(NamedTuple):
    """How boxes and bodies attract, and which boxes attract as a whole."""

    G: float  # m³/(kg s²)
    eps2: float  # m², softening squared
    theta2: float  # opening angle squared
    unit: float  # 1/m; multiplies lengths in multipoles and local expansions


class MultipoleSums(NamedTuple):
    """Results of the walks."""

    acceleration: FloatArray  # (n, 3) m/s²
    potential: FloatArray  # (n,) J/kg
    needed: IntArray  # (threads,) set to 1 if ``left`` is too small for a thread; the sums are then incomplete


class WalkBuffers(NamedTuple):
    """Workspace of all threads; within a walk, the workspace of one thread, without the first dimension."""

    far: IntArray  # (threads, ·) boxes that attract as a whole
    near: IntArray  # boxes that attract body by body
    opened: IntArray  # boxes that are being opened
    left: IntArray  # boxes left undecided for both halves of a box
    entries: RecordArray[Any]  # `ENTRY`, boxes yet to be visited
    local: FloatArray  # (threads, depth, LOCAL + 3) local expansions with their centres
    expansion: FloatArray  # (threads, LOCAL * LANES) a local expansion in lanes
    powers: FloatArray  # (threads, LOCAL) v^n / n!
    lanes: FloatArray  # (threads, 7, LANES) positions and sums of bodies in lanes


@long_kernel
def walk(
    lo: int,
    hi: int,
    taken_so_far: IntArray,
    count: int,
    tree: MultipoleBoxes,
    law: MultipoleLaw,
    buffers: WalkBuffers,
    sums: MultipoleSums,
) -> None:
    """Write acceleration and potential of the bodies in all ``count`` branches.

    Each of the threads [lo, hi) takes the next branch until none is left; ``taken_so_far``, (1,), counts the branches.
    """
    far, left = buffers.far[lo], buffers.left[lo]
    entries: RecordArray[EntryRecord] = buffers.entries[lo]
    own = WalkBuffers(
        far,
        buffers.near[lo],
        buffers.opened[lo],
        left,
        entries,
        buffers.local[lo],
        buffers.expansion[lo],
        buffers.powers[lo],
        buffers.lanes[lo],
    )
    boxes, body, acceleration, potential = tree.boxes, tree.body, sums.acceleration, sums.potential
    nothing = len(tree.poles) - 1  # a box without mass
    while True:
        taken = atomic_add(taken_so_far, 0, 1)
        if taken >= count:
            return
        branch = tree.branches[taken].begin
        for i in range(boxes[branch].first, boxes[branch].last):
            j = body[i]
            acceleration[j, 0] = acceleration[j, 1] = acceleration[j, 2] = potential[j] = 0.0
        left[0] = 0
        entries[0].box, entries[0].begin, entries[0].end, entries[0].depth = 0, 0, 1, 0
        top = 1
        while top > 0:
            top -= 1
            a, begin, end, depth = entries[top].box, entries[top].begin, entries[top].end, entries[top].depth
            fars, nears, last = _decide(a, begin, end, law.theta2, boxes, own)
            if last < 0:
                sums.needed[lo] = 1
                return
            _inherit(depth, boxes, a, law.unit, own)
            if fars > 0:
                while fars % LANES != 0:  # fill the remaining lanes
                    far[fars] = nothing
                    fars += 1
                _add_far(fars, depth, a, tree, law, own)
            half = boxes[a].half
            if a < branch:  # box a is above the branch; such a large box always leaves its own halves undecided
                entry = entries[0]
                entry.box = half if branch >= half else a + 1
                entry.begin, entry.end, entry.depth = end, last, depth + 1
                top = 1
                continue
            is_over = last == end
            if is_over or nears > 0:
                _add_near(nears, is_over, depth, a, tree, law, own, sums)
            if not is_over:
                for child in (half, a + 1):
                    entry = entries[top]
                    entry.box, entry.begin, entry.end, entry.depth = child, end, last, depth + 1
                    top += 1


@inner
def _decide(
    a: int, begin: int, end: int, theta2: float, boxes: RecordArray[BoxRecord], own: WalkBuffers
) -> tuple[int, int, int]:
    """Decide on the boxes left undecided for box a, from begin to end.

    Return the numbers of boxes that attract as a whole and body by body, and the end of the range of boxes left to the
    halves of box a. This range begins at ``end``; the returned end is -1 if there is no space for the range.
    """
    opened, far, near, left = own.opened, own.far, own.near, own.left
    A = boxes[a]
    bodies = A.last - A.first
    padded = (bodies + LANES - 1) // LANES * LANES
    fars = nears = 0
    last = end
    for c in range(begin, end):
        opened[0] = left[c]
        k = 1
        while k > 0:
            k -= 1
            b = opened[k]
            B = boxes[b]
            others = B.last - B.first
            pairs = max(bodies * ((others + LANES - 1) // LANES * LANES), padded * others)
            if last + 2 > len(left):
                return 0, 0, -1
            if a == b:
                if pairs <= MANY_PAIRS or A.half == 0:
                    near[nears] = b
                    nears += 1
                else:
                    left[last], left[last + 1] = a + 1, A.half
                    last += 2
                continue
            dx, dy, dz, r = A.x - B.x, A.y - B.y, A.z - B.z, A.radius + B.radius
            is_far = (dx * dx + dy * dy + dz * dz) * theta2 > r * r
            if is_far and pairs > FEW_PAIRS:
                far[fars] = b
                fars += 1
            elif is_far or pairs <= MANY_PAIRS or (A.half == 0 and B.half == 0):
                near[nears] = b
                nears += 1
            elif B.half != 0 and (A.half == 0 or B.radius > A.radius or (B.radius == A.radius and b > a)):
                opened[k], opened[k + 1] = B.half, b + 1
                k += 2
            else:
                left[last] = b
                last += 1
    return fars, nears, last


@inner
def _inherit(depth: int, boxes: RecordArray[BoxRecord], a: int, unit: float, own: WalkBuffers) -> None:
    """Start the local expansion of box a with its parent's expansion, moved to the centre of a."""
    local, powers = own.local, own.powers
    x, y, z = boxes[a].x, boxes[a].y, boxes[a].z
    for c in range(LOCAL):
        local[depth, c] = 0.0
    if depth > 0:
        parent = depth - 1
        dx, dy, dz = x - local[parent, LOCAL], y - local[parent, LOCAL + 1], z - local[parent, LOCAL + 2]
        powers[0] = 1.0
        for c in range(1, LOCAL):
            d = dx if AXIS[c] == 0 else (dy if AXIS[c] == 1 else dz)
            powers[c] = powers[LOWER[c]] * (unit * d) * SHARE[c]
        for q in range(len(MOVE_LOCAL)):
            term = powers[MOVE_LOCAL[q, POWER]] * local[parent, MOVE_LOCAL[q, FROM]]
            local[depth, MOVE_LOCAL[q, TO]] += term
    local[depth, LOCAL], local[depth, LOCAL + 1], local[depth, LOCAL + 2] = x, y, z


@inner
def _add_far(fars: int, depth: int, a: int, tree: MultipoleBoxes, law: MultipoleLaw, own: WalkBuffers) -> None:
    """Add the gravity of far boxes to the local expansion of box a; their number ``fars`` is a multiple of `LANES`."""
    boxes, poles, unit, soft = tree.boxes, tree.poles, law.unit, law.eps2 * law.unit * law.unit
    far, expansion, local = own.far, own.expansion, own.local
    for c in range(LOCAL * LANES):
        expansion[c] = 0.0
    for k in range(0, fars, LANES):
        attract(poles, far, k, (boxes[a].x, boxes[a].y, boxes[a].z), unit, soft, expansion)
    for c in range(LOCAL):
        for k in range(LANES):
            local[depth, c] += expansion[LANES * c + k]


@inner
def _add_near(
    nears: int,
    is_over: bool,
    depth: int,
    a: int,
    tree: MultipoleBoxes,
    law: MultipoleLaw,
    own: WalkBuffers,
    sums: MultipoleSums,
) -> None:
    """Add the gravity of near boxes, body by body, to the bodies of box a, after the gravity of its local expansion."""
    boxes, x, m, body, G, eps2 = tree.boxes, tree.x, tree.m, tree.body, law.G, law.eps2
    near, local, lanes, acceleration, potential = own.near, own.local, own.lanes, sums.acceleration, sums.potential
    of_itself = own_potential(eps2)
    A = boxes[a]
    for i in range(A.first, A.last, LANES):
        width = min(LANES, A.last - i)
        for k in range(LANES):
            s = i + min(k, width - 1)  # spare lanes repeat the last body; their results are discarded
            j = body[s]
            lanes[X, k], lanes[Y, k], lanes[Z, k] = x[X, s], x[Y, s], x[Z, s]
            lanes[AX, k], lanes[AY, k], lanes[AZ, k] = acceleration[j, 0], acceleration[j, 1], acceleration[j, 2]
            lanes[PHI, k] = potential[j]
        if is_over:
            evaluate(local, depth, A.x, A.y, A.z, law.unit, lanes)
        k = 0
        while k < nears:  # adjacent boxes are summed at once
            j0, j1 = boxes[near[k]].first, boxes[near[k]].last
            k += 1
            while k < nears and boxes[near[k]].first == j1:
                j1 = boxes[near[k]].last
                k += 1
            attract_bodies(x, m, j0, j1, eps2, lanes)
        factor = G if is_over else 1.0
        for k in range(width):
            j = body[i + k]
            acceleration[j, 0], acceleration[j, 1] = factor * lanes[AX, k], factor * lanes[AY, k]
            acceleration[j, 2] = factor * lanes[AZ, k]
            potential[j] = -G * (lanes[PHI, k] - of_itself * m[i + k]) if is_over else lanes[PHI, k]
