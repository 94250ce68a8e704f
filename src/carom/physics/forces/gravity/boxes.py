"""The tree: bodies sorted into nested boxes.

Each box tightly encloses its bodies. A box is halved in the middle of its longest side, and each half gets a tight box
again, until boxes have at most `LEAF` bodies. For bodies in a cube this is Morton's (1966) order, and the sort is a
radix sort that starts with the most significant bit. The boxes adapt to the bodies, so the sort works even if one body
is far away, or thousands lie close to one point. Bodies at one point form one leaf, of any size.

The boxes are in preorder: a box, then all boxes in it. To open a box, a walk continues with the next box; to pass over
it, the walk continues with ``skip[box]``.

Rejected, at 10⁵ bodies: octrees (boxes halved along every side longer than 0.5 or 0.7 of the longest side), because
they split a box that is a little too large into eight, and take a tenth to a third more time for the same error; keys
of 21 bits per coordinate, because they must be recomputed for bodies that share a key.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, Records, dtype_of
from carom.physics.jit.decorators import kernel, long_kernel
from carom.physics.jit.instructions import atomic_add, atomic_load, atomic_store
from carom.physics.jit.team import SOLO, Team

LEAF = 12  # largest number of bodies in a leaf, unless they coincide
GROUP = 128  # largest number of bodies that share a walk; 64 is 8 % slower at equal error
# largest number of bodies that a thread sorts alone; half of a larger range is queued for other threads
GRAIN = 2048
MIN_BODIES_PER_TASK = 20_000  # bodies per copying task

UNSORTED, PUT, TAKEN = 0, 8, 16  # indices of the queue's counters, each in a cache line of its own
COUNTERS = 24


class RangeRecord(Protocol):
    """A range of sorted bodies."""

    begin: int
    end: int


class SortedBodyRecord(Protocol):
    """A body to be sorted."""

    x: float  # m
    y: float
    z: float
    index: int  # index in the scene


RANGE = dtype_of(RangeRecord)
BODY = dtype_of(SortedBodyRecord)


class Queue(NamedTuple):
    """A queue of ranges of bodies to be sorted."""

    counters: IntArray  # (COUNTERS,) numbers of unsorted bodies, of ranges put into the queue, and of ranges taken
    end: IntArray  # (k,) end of each range; 0 until the range is written
    begin: IntArray  # (k,)
    box: IntArray  # (k,) index of the first box of each range


class Sorting(NamedTuple):
    """Workspace of the sort."""

    rows: RecordArray[SortedBodyRecord]  # (n,)
    spare: RecordArray[SortedBodyRecord]  # (n,)
    stacks: Records  # (threads, GRAIN) RANGE


class SortedBodies(NamedTuple):
    """The bodies in the order of the boxes."""

    x: FloatArray  # (3, n) m
    m: FloatArray  # (n,) kg
    body: IntArray  # (n,) index of each body in the scene


class BoxRanges(NamedTuple):
    """The boxes as arrays; see `Boxes`."""

    first: IntArray
    last: IntArray
    skip: IntArray


class Boxes:
    """The boxes of n bodies, with their workspace."""

    def __init__(self, mass: FloatArray, team: Team = SOLO) -> None:
        n = len(mass)
        self.most = 2 * n  # each halving leaves bodies on both sides; unused pages take no memory
        # arrays of the sorted bodies: (3, n) m, (n,) kg, and their indices
        self.position, self.mass, self.body = np.empty((3, n)), np.empty(n), np.empty(n, np.int64)
        self.count = 0  # number of boxes
        # sorted bodies of each box, from first to last - 1, and the next box outside the box
        self.first, self.last, self.skip = (np.empty(self.most, np.int64) for _ in range(3))
        self.groups = np.empty(0, np.int64)  # (g + 1,) start of each group of sorted bodies, and end of the last group
        self._mass = mass
        self._team = team
        ranges = n + team.size
        self._queue = Queue(np.zeros(COUNTERS, np.int64), *(np.zeros(ranges, np.int64) for _ in range(3)))
        self._sorting = Sorting(np.empty(n, BODY), np.empty(n, BODY), np.empty((team.size, GRAIN), RANGE))
        self._sorted = SortedBodies(self.position, self.mass, self.body)
        self._ranges = BoxRanges(self.first, self.last, self.skip)
        self._begins = np.empty(n + 1, np.int64)
        self._edges = np.empty(n + 1, np.int64)

    def sort(self, position: FloatArray) -> None:
        """Sort the bodies at (n, 3) m into boxes."""
        n = len(position)
        # in every step, the sort starts from the order of the scene
        self._team.divide(n, MIN_BODIES_PER_TASK, _lay_out, position, self._sorting.rows)
        _begin(self._queue, n)
        arrays = self._queue, self._mass, self._sorting, self._sorted, self._ranges
        self._team.divide(self._team.size, 1, _sort, *arrays)
        self.count, groups = _put_in_order(n, self.first, self.last, self.skip, self._begins, self._edges)
        self.groups = self._edges[: groups + 1]


@long_kernel
def _lay_out(lo: int, hi: int, position: FloatArray, rows: RecordArray[SortedBodyRecord]) -> None:
    """Write a record for each of the bodies [lo, hi)."""
    for i in range(lo, hi):
        row = rows[i]
        row.x, row.y, row.z, row.index = position[i, 0], position[i, 1], position[i, 2], i


@kernel
def _begin(queue: Queue, n: int) -> None:
    """Clear the queue, and put the range of all bodies on it."""
    counters = queue.counters
    for k in range(counters[PUT]):
        queue.end[k] = 0
    counters[UNSORTED], counters[PUT], counters[TAKEN] = n, 0, 0
    _put(queue, 0, n, 0)


@kernel
def _put(queue: Queue, lo: int, hi: int, box: int) -> None:
    """Put a range of bodies on the queue, with the index of its box."""
    k = atomic_add(queue.counters, PUT, 1)
    queue.begin[k], queue.box[k] = lo, box
    atomic_store(queue.end, k, hi)  # written last: a thread that reads this value finds the others written


@long_kernel
def _sort(
    lo: int, hi: int, queue: Queue, mass: FloatArray, sorting: Sorting, bodies: SortedBodies, ranges: BoxRanges
) -> None:
    """Sort the bodies: each of the threads from lo to hi takes ranges from the queue until all bodies are sorted.

    A range of k bodies has space for 2 k - 1 boxes, the largest possible number. The range can therefore be sorted
    while the number of boxes in earlier ranges is still unknown. At the first box of a range, ``skip`` temporarily
    holds the number of boxes in the range, or 0 if a box was halved and its halves were queued separately.

    The function is not split into smaller ones, because each call that passes arrays updates reference counts, in
    memory that all threads write to. With such calls, the sort took 1.5 times as long.
    """
    rows, spare, stack, counters = sorting.rows, sorting.spare, sorting.stacks[lo], queue.counters
    x, m, body = bodies.x, bodies.m, bodies.body
    first, last, boxes = ranges.first, ranges.last, ranges.skip
    while True:
        taken = atomic_add(counters, TAKEN, 1)
        while atomic_load(queue.end, taken) == 0:
            if atomic_load(counters, UNSORTED) == 0:
                return
        i0, i1, box = np.uint64(queue.begin[taken]), np.uint64(queue.end[taken]), queue.box[taken]
        begin, end, root, top = i0, i1, box, 0
        while True:
            first[box], last[box] = i0, i1
            half = i1
            if i1 - i0 > np.uint64(LEAF):
                ax = bx = rows[i0].x
                ay = by = rows[i0].y
                az = bz = rows[i0].z
                for i in range(i0, i1):
                    row = rows[i]
                    ax, bx = min(ax, row.x), max(bx, row.x)
                    ay, by = min(ay, row.y), max(by, row.y)
                    az, bz = min(az, row.z), max(bz, row.z)
                axis, middle = _longest_side(ax, bx, ay, by, az, bz)
                half = over = i0
                for i in range(i0, i1):  # the code has no branch: both halves are written, and one of them advances
                    row = rows[i]
                    x0, y0, z0, index = row.x, row.y, row.z, row.index
                    along = x0 if axis == 0 else (y0 if axis == 1 else z0)
                    below = np.uint64(along < middle)
                    lower, upper = rows[half], spare[over]
                    lower.x, lower.y, lower.z, lower.index = x0, y0, z0, index
                    upper.x, upper.y, upper.z, upper.index = x0, y0, z0, index
                    half += below
                    over += np.uint64(1) - below
                for k in range(over - i0):
                    lower, upper = rows[half + k], spare[i0 + k]
                    lower.x, lower.y, lower.z, lower.index = upper.x, upper.y, upper.z, upper.index
            if i0 < half < i1:  # otherwise, the bodies are few, or lie at one point, or are not finite
                if i1 - i0 > np.uint64(GRAIN):
                    boxes[box] = 0
                    _put(queue, int(half), int(i1), box + 2 * int(half - i0))
                    root, end = box + 1, half
                else:
                    stack[top].begin, stack[top].end = half, i1
                    top += 1
                i1 = half
            elif top > 0:
                top -= 1
                i0, i1 = np.uint64(stack[top].begin), np.uint64(stack[top].end)
            else:
                break
            box += 1
        boxes[root] = box + 1 - root
        for i in range(begin, end):
            row = rows[i]
            x[0, i], x[1, i], x[2, i], m[i], body[i] = row.x, row.y, row.z, mass[row.index], row.index
        atomic_add(counters, UNSORTED, int(begin) - int(end))


@kernel
def _longest_side(ax: float, bx: float, ay: float, by: float, az: float, bz: float) -> tuple[int, float]:
    """Return the axis of the longest side of the box from a to b, and its middle."""
    axis, low, high = 0, ax, bx
    if by - ay > high - low:
        axis, low, high = 1, ay, by
    if bz - az > high - low:
        axis, low, high = 2, az, bz
    middle = low + 0.5 * (high - low)
    return axis, middle if middle > low else high  # if low and high are neighbouring numbers, high separates the halves


@long_kernel
def _put_in_order(
    n: int, first: IntArray, last: IntArray, skip: IntArray, begins: IntArray, edges: IntArray
) -> tuple[int, int]:
    """Join the boxes of all ranges; return the numbers of boxes and of groups."""
    boxes = _close_up(n, first, last, skip)
    begins[len(begins) - 1] = boxes
    for box in range(boxes - 1, -1, -1):  # the next box outside is the largest box that begins where this box ends
        skip[box] = begins[last[box]]
        begins[first[box]] = box
    return boxes, _group(boxes, first, last, skip, edges)


@kernel
def _close_up(n: int, first: IntArray, last: IntArray, boxes: IntArray) -> int:
    """Close the gaps between the boxes of the ranges; return the number of boxes."""
    count = box = 0
    while box < 2 * n - 1:
        bodies, nested = last[box] - first[box], boxes[box]
        for k in range(max(nested, 1)):
            first[count], last[count] = first[box + k], last[box + k]
            count += 1
        box += 2 * bodies - 1 if nested > 0 else 1
    return count


@kernel
def _group(boxes: int, first: IntArray, last: IntArray, skip: IntArray, edges: IntArray) -> int:
    """Divide the sorted bodies into groups, each with the bodies of one box; return the number of groups."""
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
