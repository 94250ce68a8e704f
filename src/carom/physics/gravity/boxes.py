"""Bodies sorted into nested boxes: the tree.

Each box is the tight one around its bodies. It is halved in the middle of its longest side, and each half gets its own
tight box, until no more than `LEAF` bodies are in one. Around a cube this is Morton's (1966) order, and the sort is a
radix sort from the most significant bit on; but the bits adapt to the bodies, so none run out where one body is far
away or thousands lie close to one point. Bodies at one point end as one leaf, of any size.

The boxes stand in preorder: a box, then all boxes in it. A walk goes on to the next one to look into a box, and to
``skip[box]`` to pass by it.

Rejected, at 10⁵ bodies: octrees (halved along every side longer than 0.5 or 0.7 of the longest) need a tenth to a third
more time for the same error, since a box that is a little too large is split into eight. And keys of 21 bits a
coordinate, which have to be made anew wherever they do not tell bodies apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAF = 12  # bodies at most, unless they coincide
GROUP = 128  # bodies at most that share a walk: at 64, 8 % slower at equal error, since the walks are shared by fewer
DEPTH = 2200  # levels at most: each halves the longest side, and there are 2098 powers of two in float64


class Boxes:
    """The boxes of n bodies, with their workspace.

    Attributes
    ----------
    position, body
        Of the sorted bodies: (3, n) m, and their indices.
    count
        Number of boxes.
    first, last, skip
        For each box its sorted bodies, from first to last - 1, and the next box that is not in it.
    groups
        Where each group of the sorted bodies begins, and the end of the last one.
    """

    def __init__(self, n: int) -> None:
        self.most = 2 * n  # a halving leaves a body on either side; pages that are never touched take no memory
        self.position = np.empty((3, n))
        self.body = np.empty(n, np.int64)
        self.count = 0
        self.first, self.last, self.skip = (np.empty(self.most, np.int64) for _ in range(3))
        self.groups = np.empty(0, np.int64)
        self._indices = np.arange(n)
        self._spare = np.empty((3, n))
        self._spare_body = np.empty(n, np.int64)
        self._stack = np.empty((DEPTH, 2), np.int64)
        self._begins = np.empty(n + 1, np.int64)
        self._edges = np.empty(n + 1, np.int64)

    def sort(self, position: FloatArray) -> None:
        """Sort the bodies at (n, 3) m into boxes."""
        self.position[:] = position.T
        self.body[:] = self._indices  # always from the same order: the bits must not depend on the steps before
        self.count = _sort(self.position, self.body, self._spare, self._spare_body, self.first, self.last, self._stack)
        _link(self.count, self.first, self.last, self.skip, self._begins)
        groups = _group(self.count, self.first, self.last, self.skip, self._edges)
        self.groups = self._edges[: groups + 1]


@long_kernel
def _sort(
    x: FloatArray,
    body: IntArray,
    spare: FloatArray,
    spare_body: IntArray,
    first: IntArray,
    last: IntArray,
    stack: IntArray,
) -> int:
    """Sort bodies into boxes; return how many there are."""
    boxes, top = 0, 1
    stack[0, 0], stack[0, 1] = 0, len(body)
    while top > 0:
        top -= 1
        lo, hi = stack[top, 0], stack[top, 1]
        first[boxes], last[boxes] = lo, hi
        boxes += 1
        if hi - lo <= LEAF:
            continue
        axis, middle = _longest_side(x, lo, hi)
        half, over = lo, 0
        for i in range(lo, hi):  # without a branch: either half is written to, and one of them moves on
            x0, x1, x2, b = x[0, i], x[1, i], x[2, i], body[i]
            below = 1 if x[axis, i] < middle else 0
            x[0, half], x[1, half], x[2, half], body[half] = x0, x1, x2, b
            spare[0, over], spare[1, over], spare[2, over], spare_body[over] = x0, x1, x2, b
            half += below
            over += 1 - below
        for k in range(over):
            x[0, half + k], x[1, half + k], x[2, half + k] = spare[0, k], spare[1, k], spare[2, k]
            body[half + k] = spare_body[k]
        if lo < half < hi:  # else they are at one point, or not finite
            stack[top, 0], stack[top, 1] = half, hi
            stack[top + 1, 0], stack[top + 1, 1] = lo, half
            top += 2
    return boxes


@long_kernel
def _longest_side(x: FloatArray, lo: int, hi: int) -> tuple[int, float]:
    """Return the longest side of the box around some bodies, and the middle of it."""
    ax = bx = x[0, lo]
    ay = by = x[1, lo]
    az = bz = x[2, lo]
    for i in range(lo, hi):
        ax, bx = min(ax, x[0, i]), max(bx, x[0, i])
        ay, by = min(ay, x[1, i]), max(by, x[1, i])
        az, bz = min(az, x[2, i]), max(bz, x[2, i])
    axis, low, high = 0, ax, bx
    if by - ay > high - low:
        axis, low, high = 1, ay, by
    if bz - az > high - low:
        axis, low, high = 2, az, bz
    middle = low + 0.5 * (high - low)
    return axis, middle if middle > low else high  # of neighbouring numbers, the higher one parts them


@long_kernel
def _link(boxes: int, first: IntArray, last: IntArray, skip: IntArray, begins: IntArray) -> None:
    """Write for each box the one that follows all that is in it: the largest one that begins where this one ends."""
    begins[len(begins) - 1] = boxes
    for box in range(boxes - 1, -1, -1):
        skip[box] = begins[last[box]]
        begins[first[box]] = box


@long_kernel
def _group(boxes: int, first: IntArray, last: IntArray, skip: IntArray, edges: IntArray) -> int:
    """Cut the sorted bodies into groups, each the bodies of a box; return how many there are."""
    groups, box = 0, 0
    while box < boxes:
        if last[box] - first[box] <= GROUP or skip[box] == box + 1:
            for lo in range(first[box], last[box], GROUP):
                edges[groups] = lo
                groups += 1
            box = skip[box]
        else:
            box += 1
    edges[groups] = last[0]
    return groups
