"""Places where bodies wait, and the choice of the bodies that enter because their places are free."""

from __future__ import annotations

import math

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.physics.contact.geometry import are_near
from carom.physics.jit.decorators import kernel
from carom.physics.vector import is_periodic, sizes
from carom.scene.schema.settings import Domain
from carom.scene.start import HalfSpaces

APART = 2.5  # distance between waiting bodies in largest radii; too far for a search to list their pairs


def waiting_places(position: FloatArray, radius: FloatArray, domain: Domain, solids: HalfSpaces) -> FloatArray:
    """Return a place for each body to wait, (n, 3) m: a lattice beside the places where bodies enter.

    Contacts of waiting bodies are left out, wherever the bodies are. At these places, a search does not even find such
    contacts, and few bodies are behind a plane, where each would be examined in every step.
    """
    spacing = APART * float(radius.max())
    low, high = position.min(axis=0) - spacing, position.max(axis=0) + spacing
    middle, reach = 0.5 * (low + high), high - low
    beside = [axis for axis in range(3) if axis not in domain.repeating]
    ways = [(axis, sign) for axis in reversed(beside) for sign in (1.0, -1.0)]  # above is tried first

    def base(axis: int, sign: float) -> FloatArray:
        found = np.array(middle)
        found[axis] += sign * (reach[axis] + spacing)
        return found

    behind = [int((solids.heights(base(*way)[None]) < 0.0).sum()) for way in ways]
    axis, sign = ways[behind.index(min(behind))]
    across = [k for k in range(3) if k != axis]
    side = math.ceil(len(radius) ** (1.0 / 3.0))
    counts = [
        min(side, max(1, math.floor(domain.size[k] / spacing))) if k in domain.repeating and domain.size else side
        for k in across
    ]
    number = np.arange(len(radius))
    places = np.tile(base(axis, sign), (len(radius), 1))
    for k, count, index in zip(across, counts, (number % counts[0], number // counts[0] % counts[1]), strict=True):
        centre = 0.0 if k in domain.repeating else middle[k]
        places[:, k] = centre + (index - 0.5 * (count - 1)) * spacing
    places[:, axis] += sign * (number // (counts[0] * counts[1])) * spacing
    return places


@kernel
def _bounds(which: IntArray, place: FloatArray, low: FloatArray, high: FloatArray) -> None:
    """Write the corners of the box around the places of some bodies."""
    low[:], high[:] = np.inf, -np.inf
    for i in which:
        for k in range(3):
            low[k], high[k] = min(low[k], place[i, k]), max(high[k], place[i, k])


@kernel
def choose(
    which: IntArray,
    inlets: IntArray,
    room: IntArray,
    place: FloatArray,
    bodies: tuple[FloatArray, FloatArray, BoolArray],
    box: FloatArray,
    largest: float,
) -> IntArray:
    """Return the bodies that enter, in order, given the due bodies ``which`` and the ``room`` at each inlet.

    A body enters if its place is free of present bodies, and of bodies that enter before it. ``bodies`` are positions,
    (n, 3) m, radii, (n,) m, and which wait, (n,); ``largest`` is the largest radius in m.
    """
    position, radius, waits = bodies
    size, repeats = sizes(box), is_periodic(box)
    low, high = np.empty(3), np.empty(3)
    _bounds(which, place, low, high)
    # bodies that may be in the way: present bodies near the places, then bodies that enter
    near, x = np.empty(len(radius) + len(which), dtype=np.int64), np.empty((len(radius) + len(which), 3))
    count = 0
    for i in range(len(radius)):
        if waits[i]:
            continue
        is_close, reach = True, radius[i] + largest
        for k in range(3):
            outside = position[i, k] < low[k] - reach or position[i, k] > high[k] + reach
            is_close = is_close and (repeats or not outside)
        if is_close:
            near[count], x[count] = i, position[i]
            count += 1
    left = room.copy()
    entering, found = np.empty(len(which), dtype=np.int64), 0
    for i in which:
        if left[inlets[i]] == 0:
            continue
        is_free = True
        for c in range(count):
            j = near[c]
            dx, dy, dz = place[i, 0] - x[c, 0], place[i, 1] - x[c, 1], place[i, 2] - x[c, 2]
            if are_near(dx, dy, dz, radius[i] + radius[j], size, 1.0, 0.0):
                is_free = False
                break
        if is_free:
            near[count], x[count] = i, place[i]
            entering[found] = i
            count, found = count + 1, found + 1
            left[inlets[i]] -= 1
    return entering[:found].copy()
