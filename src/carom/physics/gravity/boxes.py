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

from carom.physics.parallel.atomics import atomic_add, atomic_load, atomic_store
from carom.physics.parallel.jit import kernel, long_kernel
from carom.physics.parallel.thread_team import SOLO, Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAF = 12  # bodies at most, unless they coincide
GROUP = 128  # bodies at most that share a walk: at 64, 8 % slower at equal error, since the walks are shared by fewer
GRAIN = 2048  # bodies at most that one thread sorts to the end; of more it leaves a half to whoever is free
SOME = 20_000  # bodies that are worth a part of their own when they are copied

UNSORTED, PUT, TAKEN, QUEUE = 0, 8, 16, 24  # words of the queue, each in a cache line of its own; then its ranges,
RANGE = 3  # words each: its end, 0 until it is there, its begin, and the place of its box


class Boxes:
    """The boxes of n bodies, with their workspace.

    Attributes
    ----------
    position, mass, body
        Of the sorted bodies: (3, n) m, (n,) kg, and their indices.
    count
        Number of boxes.
    first, last, skip
        For each box its sorted bodies, from first to last - 1, and the next box that is not in it.
    groups
        Where each group of the sorted bodies begins, and the end of the last one.
    """

    def __init__(self, mass: FloatArray, team: Team = SOLO) -> None:
        n = len(mass)
        self.most = 2 * n  # a halving leaves a body on either side; pages that are never touched take no memory
        self.position = np.empty((3, n))
        self.mass = np.empty(n)
        self.body = np.empty(n, np.int64)
        self.count = 0
        self.first, self.last, self.skip = (np.empty(self.most, np.int64) for _ in range(3))
        self.groups = np.empty(0, np.int64)
        self._mass = mass
        self._team = team
        self._rows, self._spare = np.empty((n, 4)), np.empty((n, 4))
        self._queue = np.zeros(QUEUE + RANGE * (n + team.size), np.int64)
        self._stacks = np.empty((team.size, GRAIN, 2), np.int64)
        self._begins = np.empty(n + 1, np.int64)
        self._edges = np.empty(n + 1, np.int64)

    def sort(self, position: FloatArray) -> None:
        """Sort the bodies at (n, 3) m into boxes."""
        n = len(position)
        self._team.divide(n, SOME, _lay_out, position, self._rows)  # in the same order in every step
        _begin(self._queue, n)
        bodies = self._rows, self._spare, self.position, self.mass, self.body
        self._team.divide(
            self._team.size, 1, _sort, self._queue, self._mass, *bodies, self.first, self.last, self.skip, self._stacks
        )
        self.count, groups = _put_in_order(n, self.first, self.last, self.skip, self._begins, self._edges)
        self.groups = self._edges[: groups + 1]


@long_kernel
def _lay_out(lo: int, hi: int, position: FloatArray, rows: FloatArray) -> None:
    """Write a row for each of the bodies from lo to hi: where it is, and its index."""
    for i in range(lo, hi):
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] = position[i, 0], position[i, 1], position[i, 2], i


@kernel
def _begin(queue: IntArray, n: int) -> None:
    """Clear the queue, and put all bodies on it."""
    for word in range(QUEUE + RANGE * queue[PUT]):
        queue[word] = 0
    queue[UNSORTED] = n
    _put(queue, 0, n, 0)


@kernel
def _put(queue: IntArray, lo: int, hi: int, box: int) -> None:
    """Put a range of bodies on the queue, with the place of its box."""
    at = QUEUE + RANGE * atomic_add(queue, PUT, 1)
    queue[at + 1], queue[at + 2] = lo, box
    atomic_store(queue, at, hi)  # last: who finds it finds the others, too


@long_kernel
def _sort(
    lo: int,
    hi: int,
    queue: IntArray,
    mass: FloatArray,
    rows: FloatArray,
    spare: FloatArray,
    x: FloatArray,
    m: FloatArray,
    body: IntArray,
    first: IntArray,
    last: IntArray,
    boxes: IntArray,
    stacks: IntArray,
) -> None:
    """Sort the bodies: each of the threads from lo to hi takes ranges from the queue until all bodies are sorted.

    A range of k bodies has 2 k - 1 places for its boxes, as many as there can be: so it can be sorted before anybody
    knows how many boxes stand before its own. At the place of the first one ``boxes`` tells how many there are; it is 0
    where a box was halved and its halves went their own ways.

    Written out in one piece: each call of a function that takes arrays counts their references, in memory that all
    threads write to, and that took half as long again.
    """
    stack = stacks[lo]
    while True:
        at = QUEUE + RANGE * atomic_add(queue, TAKEN, 1)
        while atomic_load(queue, at) == 0:
            if atomic_load(queue, UNSORTED) == 0:
                return
        i1, i0, box = np.uint64(queue[at]), np.uint64(queue[at + 1]), queue[at + 2]
        begin, end, root, top = i0, i1, box, 0
        while True:
            first[box], last[box] = i0, i1
            half = i1
            if i1 - i0 > np.uint64(LEAF):
                ax = bx = rows[i0, 0]
                ay = by = rows[i0, 1]
                az = bz = rows[i0, 2]
                for i in range(i0, i1):
                    ax, bx = min(ax, rows[i, 0]), max(bx, rows[i, 0])
                    ay, by = min(ay, rows[i, 1]), max(by, rows[i, 1])
                    az, bz = min(az, rows[i, 2]), max(bz, rows[i, 2])
                axis, middle = _longest_side(ax, bx, ay, by, az, bz)
                along = np.uint64(axis)
                half = over = i0
                for i in range(i0, i1):  # without a branch: either half is written to, and one of them moves on
                    x0, x1, x2, x3 = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]
                    below = np.uint64(rows[i, along] < middle)
                    rows[half, 0], rows[half, 1], rows[half, 2], rows[half, 3] = x0, x1, x2, x3
                    spare[over, 0], spare[over, 1], spare[over, 2], spare[over, 3] = x0, x1, x2, x3
                    half += below
                    over += np.uint64(1) - below
                for k in range(over - i0):
                    for c in range(4):
                        rows[half + k, c] = spare[i0 + k, c]
            if i0 < half < i1:  # else they are few, or at one point, or not finite
                if i1 - i0 > np.uint64(GRAIN):
                    boxes[box] = 0
                    _put(queue, int(half), int(i1), box + 2 * int(half - i0))
                    root, end = box + 1, half
                else:
                    stack[top, 0], stack[top, 1] = half, i1
                    top += 1
                i1 = half
            elif top > 0:
                top -= 1
                i0, i1 = np.uint64(stack[top, 0]), np.uint64(stack[top, 1])
            else:
                break
            box += 1
        boxes[root] = box + 1 - root
        for i in range(begin, end):
            b = int(rows[i, 3])
            x[0, i], x[1, i], x[2, i], m[i], body[i] = rows[i, 0], rows[i, 1], rows[i, 2], mass[b], b
        atomic_add(queue, UNSORTED, int(begin) - int(end))


@kernel
def _longest_side(ax: float, bx: float, ay: float, by: float, az: float, bz: float) -> tuple[int, float]:
    """Return the longest side of the box from a to b, and the middle of it."""
    axis, low, high = 0, ax, bx
    if by - ay > high - low:
        axis, low, high = 1, ay, by
    if bz - az > high - low:
        axis, low, high = 2, az, bz
    middle = low + 0.5 * (high - low)
    return axis, middle if middle > low else high  # of neighbouring numbers, the higher one parts them


@long_kernel
def _put_in_order(
    n: int, first: IntArray, last: IntArray, skip: IntArray, begins: IntArray, edges: IntArray
) -> tuple[int, int]:
    """Make of the boxes of the ranges those of the whole; return how many there are, and how many groups."""
    boxes = _close_up(n, first, last, skip)
    _link(boxes, first, last, skip, begins)
    return boxes, _group(boxes, first, last, skip, edges)


@kernel
def _close_up(n: int, first: IntArray, last: IntArray, boxes: IntArray) -> int:
    """Close the gaps between the boxes of one range and of the next; return how many boxes there are."""
    count = box = 0
    while box < 2 * n - 1:
        bodies, nested = last[box] - first[box], boxes[box]
        for k in range(max(nested, 1)):
            first[count], last[count] = first[box + k], last[box + k]
            count += 1
        box += 2 * bodies - 1 if nested > 0 else 1
    return count


@kernel
def _link(boxes: int, first: IntArray, last: IntArray, skip: IntArray, begins: IntArray) -> None:
    """Write for each box the one that follows all that is in it: the largest one that begins where this one ends."""
    begins[len(begins) - 1] = boxes
    for box in range(boxes - 1, -1, -1):
        skip[box] = begins[last[box]]
        begins[first[box]] = box


@kernel
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
