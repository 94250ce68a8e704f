"""Gravity by fast multipoles: boxes of bodies attract boxes of bodies, with opposite forces.

`boxes` sorts the bodies into boxes. This module computes their multipoles about their centres of mass, from the leaves
up, and `box_walk` decides which boxes attract each other as a whole:

    M = Σ m_i      X = Σ m_i x_i / M      r ≥ max |x_i - X|      M_m: see `taylor`

The multipoles of a leaf are summed over its bodies, the multipoles of other boxes over their halves. For a box of up to
`BRANCH` bodies, the radius r is exact; for a larger box, r is a bound that follows from its halves.

The opening angle determines the error (measured in docs/physics.md). Momentum is conserved to rounding at any opening
angle. The bits are the same on any processor and number of threads. For an error of 10⁻⁴ in a ball, the method takes
half as long as the tree (`tree`, in which boxes attract bodies). For errors above 3 × 10⁻³, the tree is faster.
"""

from __future__ import annotations

import math

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.aligned import Buffer
from carom.physics.forces.gravity.boxes import RANGE, Boxes, RangeRecord
from carom.physics.forces.gravity.direct import PARALLEL_FROM, potential_energy
from carom.physics.forces.gravity.fast_multipole.box_walk import (
    BOX,
    ENTRY,
    BoxRecord,
    MultipoleBoxes,
    MultipoleLaw,
    MultipoleSums,
    WalkBuffers,
    walk,
)
from carom.physics.forces.gravity.fast_multipole.taylor import (
    AXIS,
    CENTRE,
    FROM,
    LOCAL,
    LOWER,
    MASS,
    MOVE_POLES,
    POLES,
    POWER,
    SHARE,
    TO,
)
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.instructions import atomic_add
from carom.physics.jit.team import SOLO, Team
from carom.physics.jit.vectors import WIDTH as LANES
from carom.scene.schema import Gravity

# largest number of bodies in a branch, the work of one thread; the walks down to the branches repeat 2 % of the work
BRANCH = 2048
DEEPEST = 6400  # largest depth of boxes: each side can be halved 2100 times from the largest float to the smallest
UNIT_BITS = 300  # largest |k| of the unit 2^k of lengths, so that no power of a length overflows


@long_kernel
def describe(
    count: int,
    first: IntArray,
    last: IntArray,
    skip: IntArray,
    boxes: RecordArray[BoxRecord],
    branches: RecordArray[RangeRecord],
    trunk: RecordArray[RangeRecord],
) -> tuple[int, int]:
    """Write the bodies and halves of all boxes; return the numbers of branches and of boxes above them.

    Each of the ``branches`` is a range of boxes: a box of at most `BRANCH` bodies whose parent has more, and all boxes
    in it. The ``trunk`` has the boxes above the branches, each as a range of one box, the innermost first.
    """
    found = above = 0
    for b in range(count):
        box = boxes[b]
        box.first, box.last, box.skip = first[b], last[b], skip[b]
        box.half = skip[b + 1] if skip[b] > b + 1 else 0
    b = 0
    while b < count:
        box = boxes[b]
        if box.last - box.first <= BRANCH or box.half == 0:
            branches[found].begin, branches[found].end = b, box.skip
            found += 1
            b = box.skip
        else:
            trunk[above].begin, trunk[above].end = b, b + 1
            above += 1
            b += 1
    for k in range(above // 2):
        other = above - 1 - k
        begin, end = trunk[k].begin, trunk[k].end
        trunk[k].begin, trunk[k].end = trunk[other].begin, trunk[other].end
        trunk[other].begin, trunk[other].end = begin, end
    return found, above


@long_kernel
def expand(
    lo: int,
    hi: int,
    taken_so_far: IntArray,
    count: int,
    ranges: RecordArray[RangeRecord],
    tree: MultipoleBoxes,
    unit: float,
    powers_of: FloatArray,
) -> None:
    """Write centre, radius and multipoles of the boxes of ``count`` ranges, from the last box of a range to the first.

    Each of the threads [lo, hi) takes the next range until none is left; ``taken_so_far``, (1,), counts the ranges.
    ``unit`` (1/m) multiplies lengths, and ``powers_of`` is a buffer, (threads, POLES), for v^n / n!.
    """
    x, m, boxes, poles, powers = tree.x, tree.m, tree.boxes, tree.poles, powers_of[lo]
    powers[0] = 1.0
    while True:
        taken = atomic_add(taken_so_far, 0, 1)
        if taken >= count:
            return
        for b in range(ranges[taken].end - 1, ranges[taken].begin - 1, -1):
            box = boxes[b]
            i0, i1 = box.first, box.last
            M = X = Y = Z = r2 = 0.0
            if box.half == 0:
                x0, y0, z0 = x[0, i0], x[1, i0], x[2, i0]
                for i in range(i0, i1):
                    M += m[i]
                    X += m[i] * (x[0, i] - x0)
                    Y += m[i] * (x[1, i] - y0)
                    Z += m[i] * (x[2, i] - z0)
            else:
                x0, y0, z0 = boxes[b + 1].x, boxes[b + 1].y, boxes[b + 1].z
                other = boxes[box.half]
                weight = poles[box.half, MASS]
                M = poles[b + 1, MASS] + weight
                X, Y, Z = weight * (other.x - x0), weight * (other.y - y0), weight * (other.z - z0)
            if M > 0.0:  # without mass, all bodies are test particles, and any centre will do
                X, Y, Z = X / M, Y / M, Z / M
            X, Y, Z = x0 + X, y0 + Y, z0 + Z
            box.x, box.y, box.z = X, Y, Z
            if i1 - i0 <= BRANCH or box.half == 0:
                for i in range(i0, i1):
                    dx, dy, dz = x[0, i] - X, x[1, i] - Y, x[2, i] - Z
                    r2 = max(r2, dx * dx + dy * dy + dz * dz)
                box.radius = np.sqrt(r2)
            else:
                box.radius = 0.0
                for h in range(2):
                    child = boxes[b + 1] if h == 0 else boxes[box.half]
                    dx, dy, dz = child.x - X, child.y - Y, child.z - Z
                    box.radius = max(box.radius, child.radius + np.sqrt(dx * dx + dy * dy + dz * dz))
            for c in range(POLES):
                poles[b, c] = 0.0
            if box.half == 0:
                for i in range(i0, i1):
                    dx, dy, dz = unit * (X - x[0, i]), unit * (Y - x[1, i]), unit * (Z - x[2, i])
                    poles[b, MASS] += m[i]
                    for c in range(1, POLES):
                        d = dx if AXIS[c] == 0 else (dy if AXIS[c] == 1 else dz)
                        powers[c] = powers[LOWER[c]] * d * SHARE[c]
                        poles[b, c] += m[i] * powers[c]
            else:
                for h in range(2):
                    half = b + 1 if h == 0 else box.half
                    dx, dy, dz = unit * (X - boxes[half].x), unit * (Y - boxes[half].y), unit * (Z - boxes[half].z)
                    for c in range(1, POLES):
                        d = dx if AXIS[c] == 0 else (dy if AXIS[c] == 1 else dz)
                        powers[c] = powers[LOWER[c]] * d * SHARE[c]
                    for q in range(len(MOVE_POLES)):
                        term = powers[MOVE_POLES[q, POWER]] * poles[half, MOVE_POLES[q, FROM]]
                        poles[b, MOVE_POLES[q, TO]] += term
            poles[b, CENTRE], poles[b, CENTRE + 1], poles[b, CENTRE + 2] = X, Y, Z


class FastMultipoleGravity:
    """Gravity between n bodies by fast multipoles, with its workspace."""

    def __init__(
        self, mass: FloatArray, constant: float, softening: float, opening_angle: float, team: Team = SOLO
    ) -> None:
        n = len(mass)
        self._mass = mass
        self._constant = constant
        self._softening_squared = softening * softening
        self._angle_squared = opening_angle * opening_angle
        self._team = team if n >= PARALLEL_FROM else SOLO
        self._nested = Boxes(mass, self._team)
        self._boxes, self._poles = Buffer(BOX), Buffer(np.float64, POLES)
        self._branches, self._trunk = np.empty(n, RANGE), np.empty(n, RANGE)
        self._potential = np.zeros(n)
        self._taken = np.zeros(1, np.int64)  # number of pieces of work taken so far
        size, depth = self._team.size, min(n, DEEPEST) + 2
        self._powers = np.empty((size, LOCAL))
        self._needed = np.zeros(size, np.int64)
        # workspace for each thread; unused pages take no memory
        self._buffers = WalkBuffers(
            far=np.empty((size, n + LANES), np.int64),
            near=np.empty((size, n), np.int64),
            opened=np.empty((size, depth), np.int64),
            left=np.empty((size, 2 * n + 2), np.int64),
            entries=np.empty((size, depth), ENTRY),
            local=np.empty((size, depth, LOCAL + 3)),
            expansion=np.empty((size, LOCAL * LANES)),
            powers=self._powers,
            lanes=np.empty((size, 7, LANES)),
        )

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the accelerations; see `GravityMethod`. The energy takes almost no additional time."""
        nested = self._nested
        nested.sort(position)
        boxes, poles = self._boxes.take(nested.count), self._poles.take(nested.count + 1)
        order = nested.count, nested.first, nested.last, nested.skip
        branches, above = describe(*order, boxes, self._branches, self._trunk)
        tree = MultipoleBoxes(self._branches, boxes, poles, nested.position, nested.mass, nested.body)
        unit = _unit(nested.position)
        self._expand(branches, self._branches, tree, unit)
        self._expand(above, self._trunk, tree, unit)
        poles[-1] = 0.0
        # the box without mass is far from all boxes
        poles[-1, CENTRE : CENTRE + 3] = nested.position[:, 0] + 8.0 / unit
        law = MultipoleLaw(self._constant, self._softening_squared, self._angle_squared, unit)
        sums = MultipoleSums(acceleration, self._potential, self._needed)
        while True:
            self._taken[0] = self._needed[:] = 0
            self._team.divide(self._team.size, 1, walk, self._taken, branches, tree, law, self._buffers, sums)
            if not self._needed.any():
                break
            size, most = self._buffers.left.shape
            self._buffers = self._buffers._replace(left=np.empty((size, 2 * most), np.int64))
        return potential_energy(self._mass, self._potential) if potential else None

    def _expand(self, count: int, ranges: RecordArray[RangeRecord], tree: MultipoleBoxes, unit: float) -> None:
        """Compute the multipoles of ranges of boxes; a single thread computes the multipoles above the branches."""
        team = self._team if ranges is self._branches else SOLO
        self._taken[0] = 0
        team.divide(team.size, 1, expand, self._taken, count, ranges, tree, unit, self._powers)


def make(gravity: Gravity, mass: FloatArray, team: Team) -> FastMultipoleGravity:
    """Return the fast multipoles for a scene's gravity section."""
    return FastMultipoleGravity(mass, gravity.constant, gravity.softening, gravity.opening_angle, team)


def _unit(position: FloatArray) -> float:
    """Return a power of two near the inverse of the largest distance in m; multiplication by it is exact."""
    size = float(np.ptp(position, axis=1).max())
    if not 0.0 < size < math.inf:
        return 1.0
    return math.ldexp(1.0, max(-UNIT_BITS, min(UNIT_BITS, -math.frexp(size)[1])))
