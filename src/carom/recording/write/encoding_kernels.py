"""Loops over the bodies and contacts of a batch of frames that convert float64 state to the float32 that is drawn.

The loops are kernels because NumPy would hold the interpreter lock, which the physics needs after each of its kernels.
The kernels process many frames, and release the lock. A call takes some microseconds, as long as the work on a frame of
ten contacts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.arrays import ColourArray, FloatArray, IntArray, Records, SingleArray
from carom.physics.jit.decorators import inline, inner, long_kernel
from carom.recording.layout.drawing import part_of_longest

SMALLEST_NORMAL = float(np.finfo(np.float64).tiny)  # N s, smallest median that can be a divisor
# `part_of_longest` for kernels; the original is for NumPy arrays
_part_of_longest = inline(part_of_longest)


class FrameContacts(NamedTuple):
    """The edges of the collision graphs of consecutive frames, their contacts and their impacts, frame by frame."""

    pairs: IntArray  # (m, 2)
    normals: FloatArray  # (m, 3)
    overlaps: FloatArray  # (m,) m
    colours: IntArray  # (m,)
    rows: Records  # (k,) `CONTACT_ROW`, in each frame sorted by pair
    impacts: Records  # (l,) `CONTACT_ROW`, in order of time
    each: IntArray  # (frames, 3) numbers of edges, contacts and impacts in each frame


class TorqueList(NamedTuple):
    """Torques that can be drawn, frame by frame."""

    torque: FloatArray  # (frames, n, 3) N m, torques of all bodies
    each: IntArray  # (frames,) number of listed bodies in each frame
    body: NDArray[np.uint32]  # (m,) the bodies listed
    magnitude: FloatArray  # (m,) N m, magnitudes of their torques


class Arrows(NamedTuple):
    """Arrows of a batch, in the order of `TorqueList`."""

    origin: SingleArray  # (m, 3)
    vector: SingleArray  # (m, 3)


class EdgeColumns(NamedTuple):
    """One value for each edge."""

    bodies: NDArray[np.uint32]  # (m, 2)
    normal_impulse: SingleArray
    tangential_impulse: SingleArray
    mode: NDArray[np.uint8]
    colour: ColourArray
    width: SingleArray


@long_kernel
def cast_positions(position: FloatArray, origin: FloatArray, points: SingleArray) -> None:
    """Write positions (frames, n, 3) relative to an origin."""
    for f in range(position.shape[0]):
        for i in range(position.shape[1]):
            for k in range(3):
                points[f, i, k] = np.float32(position[f, i, k] - origin[k])


@long_kernel
def cast_orientations(orientation: FloatArray, turned: SingleArray) -> None:
    """Write quaternions (frames, n, 4)."""
    for f in range(orientation.shape[0]):
        for i in range(orientation.shape[1]):
            for k in range(4):
                turned[f, i, k] = np.float32(orientation[f, i, k])


@long_kernel
def list_torques(torques: TorqueList) -> int:
    """List the bodies whose torque can be drawn, in an array for all bodies; return the length of the list."""
    torque, each, body, magnitude = torques
    found = 0
    for f in range(torque.shape[0]):
        before = found
        for i in range(torque.shape[1]):
            x, y, z = abs(torque[f, i, 0]), abs(torque[f, i, 1]), abs(torque[f, i, 2])
            largest = max(x, y, z)  # components are divided by it, so that no square overflows
            if largest > 0.0 and np.isfinite(x + y + z):
                x, y, z = x / largest, y / largest, z / largest
                body[found] = i
                magnitude[found] = largest * np.sqrt(x * x + y * y + z * z)
                found += 1
        each[f] = found - before
    return found


@long_kernel
def draw_arrows(
    torques: TorqueList, points: SingleArray, radius: FloatArray, unit: FloatArray, l_max: float, arrows: Arrows
) -> None:
    """Write arrows along the torques of the bodies listed, by the law of `carom.recording.layout.drawing`.

    A body with the torque ``unit``, (n,) N m, has an arrow of half the length ``l_max``.
    """
    (torque, each, body, magnitude), (origin, vector) = torques, arrows
    c = 0
    for f in range(len(each)):
        for _ in range(each[f]):
            i = body[c]
            length = (radius[i] + l_max * _part_of_longest(magnitude[c], unit[i])) / magnitude[c]
            for k in range(3):
                origin[c, k] = points[f, i, k]
                vector[c, k] = np.float32(torque[f, i, k] * length)
            c += 1


@long_kernel
def draw_edges(
    contacts: FrameContacts,
    points: SingleArray,
    radius: FloatArray,
    box: FloatArray,
    stages: ColourArray,
    strips: SingleArray,
    drawn: ColourArray,
    extremes: FloatArray,
) -> None:
    """Write lines (m, 6) between the centres of touching bodies, to the nearest image, and their colours (m,).

    A line to a plane ends at the foot of the perpendicular. ``stages`` are the colours of the first stages; all later
    stages have the last colour. The ``extremes``, (frames, 3), are the deepest overlap (m), the largest ratio of
    overlap to smaller radius, and the number of colours.
    """
    pairs, normals, overlaps, colours = contacts.pairs, contacts.normals, contacts.overlaps, contacts.colours
    e = 0
    for f in range(len(contacts.each)):
        deepest, deepest_share, most = 0.0, 0.0, -1
        for _ in range(contacts.each[f, 0]):
            i, j = pairs[e, 0], pairs[e, 1]
            smaller = radius[i]
            if j < len(radius):
                smaller = min(smaller, radius[j])
            deepest = max(deepest, overlaps[e])
            deepest_share = max(deepest_share, overlaps[e] / smaller)
            most = max(most, colours[e])
            for k in range(3):
                start = points[f, i, k]
                if j < len(radius):
                    end = points[f, j, k]
                    if box[k] > 0.0:
                        end -= np.float32(box[k] * np.floor((end - start) / box[k] + 0.5))
                else:
                    end = start + np.float32((radius[i] - overlaps[e]) * normals[e, k])
                strips[e, k] = start
                strips[e, 3 + k] = end
            drawn[e] = stages[min(colours[e], len(stages) - 1)]
            e += 1
        extremes[f, 0], extremes[f, 1], extremes[f, 2] = deepest, deepest_share, most + 1


@long_kernel
def write_contacts(
    contacts: FrameContacts, middles: FloatArray, scale: ColourArray, widths: SingleArray, columns: EdgeColumns
) -> int:
    """Write the data of the contacts, and how edges are drawn by their impulses; return the number of edges written.

    Writing ends at the first edge without a contact. There are more contacts than edges if some contacts opened within
    the step. ``middles`` (frames,) are the impulses (N s) in the middle of each scale; ``scale`` and ``widths`` are
    colours and radii in ascending order of impulse.
    """
    pairs, rows = contacts.pairs, contacts.rows
    e, end_of_rows = 0, 0
    for f in range(len(contacts.each)):
        a, end_of_rows = end_of_rows, end_of_rows + contacts.each[f, 1]
        for _ in range(contacts.each[f, 0]):
            i, j = pairs[e, 0], pairs[e, 1]
            while a < end_of_rows and (rows[a].i < i or (rows[a].i == i and rows[a].j < j)):
                a += 1
            if a == end_of_rows or rows[a].i != i or rows[a].j != j:
                return e
            row = rows[a]
            columns.bodies[e, 0], columns.bodies[e, 1] = i, j
            x, y, z = row.friction_x, row.friction_y, row.friction_z
            columns.normal_impulse[e] = np.float32(row.normal_impulse)
            columns.tangential_impulse[e] = np.float32(np.sqrt(x * x + y * y + z * z))
            columns.mode[e] = row.mode
            level = min(len(scale) - 1, int(len(scale) * _part_of_longest(max(0.0, row.normal_impulse), middles[f])))
            columns.colour[e], columns.width[e] = scale[level], widths[level]
            e += 1
    return e


@long_kernel
def find_middles(contacts: FrameContacts, positive: FloatArray, middles: FloatArray) -> None:
    """Write the median (N s) of each frame's positive normal impulses; 1 if a frame has none.

    ``positive`` is overwritten; it must be at least as long as the rows of any frame.
    """
    rows, c = contacts.rows, 0
    for f in range(len(contacts.each)):
        count = 0
        for _ in range(contacts.each[f, 1]):
            if rows[c].normal_impulse > 0.0:
                positive[count] = rows[c].normal_impulse
                count += 1
            c += 1
        middles[f] = 1.0 if count == 0 else max(_median(positive[:count]), SMALLEST_NORMAL)


@inner
def _median(values: FloatArray) -> float:
    """Return the median; the order of the values changes."""
    half = len(values) // 2
    middle = _select(values, half)
    if len(values) % 2 == 1:
        return middle
    below = values[0]
    for k in range(1, half):
        below = max(below, values[k])
    return float(0.5 * (below + middle))


@inner
def _select(values: FloatArray, place: int) -> float:
    """Partition values in place around the value that belongs at an index; return that value (Hoare's quickselect).

    Rejected: np.median and np.partition, which take Numba 3 s and 10 s to compile.
    """
    lo, hi = 0, len(values) - 1
    while lo < hi:
        pivot, i, j = values[(lo + hi) // 2], lo, hi
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < place:
            lo = i
        if i > place:
            hi = j
    return float(values[place])


@long_kernel
def pick_strongest(
    rows: Records, each: IntArray, counts: IntArray, scratch: FloatArray, chosen: IntArray, picked: Records
) -> None:
    """Select the rows with the largest normal impulses of each frame, in their order; among equal impulses, the first.

    ``each`` and ``counts``, (frames,), are the numbers of rows and of selected rows. The indices of the selected rows
    in their frames are written to ``chosen``, the rows to ``picked``. ``scratch`` is at least as long as the rows of
    any frame.
    """
    begin, found = 0, 0
    for f in range(len(each)):
        m, count = each[f], counts[f]
        least, equal = -np.inf, 0  # the smallest selected impulse, and the number of selected impulses equal to it
        if 0 < count < m:
            for c in range(m):
                scratch[c] = rows[begin + c].normal_impulse
            least, equal = _select(scratch[:m], m - count), count
            for c in range(m):
                equal -= rows[begin + c].normal_impulse > least
        for c in range(m if count > 0 else 0):
            impulse = rows[begin + c].normal_impulse
            if count == m or impulse > least or (impulse == least and equal > 0):
                equal -= impulse == least
                chosen[found], picked[found] = c, rows[begin + c]
                found += 1
        begin += m


@long_kernel
def count_moved(position: FloatArray, before: SingleArray, moved: IntArray) -> None:
    """Count the bodies of each frame, (frames, n, 3), that are drawn at other positions than in the previous frame.

    ``before``, (n, 3), are the positions in the previous frame, which the positions of the last frame overwrite.
    """
    for f in range(len(position)):
        moved[f] = 0
        for i in range(position.shape[1]):
            same = True
            for k in range(3):
                drawn = np.float32(position[f, i, k])
                same = same and drawn == before[i, k]
                before[i, k] = drawn
            moved[f] += not same
