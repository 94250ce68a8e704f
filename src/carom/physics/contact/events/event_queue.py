"""The event queue: a binary heap of the bodies with a predicted impact, the earliest first.

Each body is in it at most once, with its own next impact. For an impact of two bodies it is enough that one of them is
in the queue: the one whose impact was predicted last. Impacts at the same time come in the order of their pairs.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import IntArray, Records
from carom.physics.jit.decorators import kernel


@kernel
def is_sooner(i: int, j: int, body: Records) -> bool:
    """Return whether body i's next impact comes before body j's."""
    one, other = body[i], body[j]
    if one.impact_time != other.impact_time:
        return bool(one.impact_time < other.impact_time)
    first, second = min(i, one.partner), min(j, other.partner)
    if first != second:
        return bool(first < second)
    return bool(max(i, one.partner) < max(j, other.partner))


@kernel
def put(i: int, size: int, queue: IntArray, body: Records) -> int:
    """Update the place of body i after its next impact has changed; remove it if there is none.

    Parameters
    ----------
    size
        Number of bodies in the queue.
    queue
        (n,) the heap.
    body
        (n,) `TRAJECTORY`.

    Returns
    -------
    size
        Number of bodies in the queue now.
    """
    k, placed = body[i].queue_place, i
    if body[i].impact_time == np.inf:
        if k < 0:
            return size
        size -= 1
        body[i].queue_place = -1
        if k == size:
            return size
        placed = queue[size]  # the last body of the heap fills the gap
    elif k < 0:
        k = size
        size += 1
    while k > 0 and is_sooner(placed, queue[(k - 1) // 2], body):
        queue[k] = queue[(k - 1) // 2]
        body[queue[k]].queue_place = k
        k = (k - 1) // 2
    while 2 * k + 1 < size:
        child = 2 * k + 1
        if child + 1 < size and is_sooner(queue[child + 1], queue[child], body):
            child += 1
        if not is_sooner(queue[child], placed, body):
            break
        queue[k] = queue[child]
        body[queue[k]].queue_place = k
        k = child
    queue[k] = placed
    body[placed].queue_place = k
    return size
