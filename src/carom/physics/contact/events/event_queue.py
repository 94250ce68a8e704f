"""The event queue: a binary heap of the bodies with a predicted impact, the earliest first.

A body is in the queue at most once, with its next impact. An impact of two bodies needs only one entry: the entry of
the body whose impact was predicted last. Simultaneous impacts are in the order of their pairs.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from carom.arrays import IntArray, RecordArray
from carom.physics.jit.decorators import inner


class QueuedRecord(Protocol):
    """A body in the event queue."""

    impact_time: float  # s, time of the body's next impact; infinite if there is none
    partner: int  # other end of the body's next impact: body j, or n + p for plane p
    queue_place: int  # place in the event queue; -1 outside


@inner
def is_sooner(i: int, j: int, body: RecordArray[QueuedRecord]) -> bool:
    """Return whether body i's next impact comes before body j's."""
    one, other = body[i], body[j]
    if one.impact_time != other.impact_time:
        return bool(one.impact_time < other.impact_time)
    first, second = min(i, one.partner), min(j, other.partner)
    if first != second:
        return bool(first < second)
    return bool(max(i, one.partner) < max(j, other.partner))


@inner
def put(i: int, size: int, queue: IntArray, body: RecordArray[QueuedRecord]) -> int:
    """Update the place of body i in a queue after its next impact has changed; without an impact, remove the body.

    Return the new number of queued bodies; the old number is ``size``.
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
