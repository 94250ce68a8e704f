"""The bodies that have an impact ahead, the earliest first: a heap, in which each body stands once.

A body is on the agenda with its own next impact. Two bodies that will meet need not both be on it for that: the one
whose path was looked along last knows. Impacts at the same moment come in the order of their pairs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.jit import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def is_sooner(i: int, j: int, moment: FloatArray, partner: IntArray) -> bool:
    """Tell whether body i's next impact comes before body j's."""
    if moment[i] != moment[j]:
        return bool(moment[i] < moment[j])
    first, second = min(i, partner[i]), min(j, partner[j])
    if first != second:
        return bool(first < second)
    return bool(max(i, partner[i]) < max(j, partner[j]))


@kernel
def put(i: int, size: int, heap: IntArray, place: IntArray, moment: FloatArray, partner: IntArray) -> int:
    """Put a body where its next impact belongs, which has changed, or take it off if there is none.

    Parameters
    ----------
    heap, place
        (n,) bodies, of which so many count, and where each stands, -1 if nowhere.
    moment, partner
        (n,) s and whom: of each body's next impact, infinite if there is none.

    Returns
    -------
    size
        How many bodies there are now.
    """
    k = place[i]
    if moment[i] == np.inf:
        if k < 0:
            return size
        size -= 1
        place[i] = -1
        if k == size:
            return size
        i = heap[size]
    elif k < 0:
        k = size
        size += 1
    while k > 0 and is_sooner(i, heap[(k - 1) // 2], moment, partner):
        heap[k] = heap[(k - 1) // 2]
        place[heap[k]] = k
        k = (k - 1) // 2
    while 2 * k + 1 < size:
        child = 2 * k + 1
        if child + 1 < size and is_sooner(heap[child + 1], heap[child], moment, partner):
            child += 1
        if not is_sooner(heap[child], i, moment, partner):
            break
        heap[k] = heap[child]
        place[heap[k]] = k
        k = child
    heap[k], place[i] = i, k
    return size
