"""Loops over the bodies and contacts of a batch of frames that turn float64 state into the float32 that is drawn.

They are kernels because NumPy holds the interpreter lock, which the physics needs after each of its own kernels. One
call handles a whole batch: a call for every frame takes the lock so often that it costs twice the work itself.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import carray, types  # type: ignore[attr-defined]
from numpy.typing import NDArray

from carom.contact_table import CONTACT_ROW
from carom.physics.jit.decorators import inline, inner, kernel, long_kernel
from carom.physics.jit.intrinsics import pointer_to
from carom.recording.layout.drawing import part_of_longest

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
ColourArray = NDArray[np.uint32]

PAIRS, NORMALS, OVERLAPS, COLOURS, ROWS, IMPACTS = range(6)  # columns of `locate`

_reals, _integers = pointer_to(types.float64), pointer_to(types.int64)
_records = pointer_to(numba.from_dtype(CONTACT_ROW))

_part_of_longest = inline(part_of_longest)  # the same function, compiled: NumPy takes the other for arrays


@kernel
def locate(
    pairs: IntArray,
    normals: FloatArray,
    overlaps: FloatArray,
    colours: IntArray,
    rows: NDArray[np.void],
    impacts: NDArray[np.void],
    addresses: IntArray,
) -> None:
    """Write where the contacts of a frame lie, (6,): a batch need not copy them together, which is megabytes.

    The arrays are contiguous and must be kept as long as the addresses are used.
    """
    addresses[PAIRS], addresses[NORMALS] = pairs.ctypes.data, normals.ctypes.data
    addresses[OVERLAPS], addresses[COLOURS] = overlaps.ctypes.data, colours.ctypes.data
    addresses[ROWS], addresses[IMPACTS] = rows.ctypes.data, impacts.ctypes.data


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
def turning(torque: FloatArray, body: NDArray[np.uint32], magnitude: FloatArray, each: IntArray) -> int:
    """List the bodies with a torque that can be drawn, frame by frame, and its magnitude; return how many there are.

    The largest component is the unit, so that no square overflows.

    Parameters
    ----------
    torque
        (frames, n, 3) N m.
    each
        (frames,), overwritten: how many bodies each frame lists.
    """
    found = 0
    for f in range(torque.shape[0]):
        before = found
        for i in range(torque.shape[1]):
            x, y, z = abs(torque[f, i, 0]), abs(torque[f, i, 1]), abs(torque[f, i, 2])
            largest = max(x, y, z)
            if largest > 0.0 and np.isfinite(x + y + z):
                x, y, z = x / largest, y / largest, z / largest
                body[found] = i
                magnitude[found] = largest * np.sqrt(x * x + y * y + z * z)
                found += 1
        each[f] = found - before
    return found


@long_kernel
def draw_arrows(
    torque: FloatArray,
    each: IntArray,
    body: NDArray[np.uint32],
    magnitude: FloatArray,
    points: SingleArray,
    radius: FloatArray,
    unit: FloatArray,
    l_max: float,
    origin: SingleArray,
    vector: SingleArray,
) -> None:
    """Write arrows along the torques of the bodies listed, by the law of `carom.recording.layout.drawing`.

    Parameters
    ----------
    unit
        (n,) N m, the torque of each body whose arrow sticks out by half of ``l_max``.
    """
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
    addresses: IntArray,
    each: IntArray,
    points: SingleArray,
    radius: FloatArray,
    box: FloatArray,
    cycle: ColourArray,
    serial: int,
    serial_colour: np.uint32,
    strips: SingleArray,
    drawn: ColourArray,
    extremes: FloatArray,
) -> None:
    """Write lines (m, 6) between the centres of touching bodies, to the nearest image, and their colours (m,).

    A line to a plane ends at the foot of the perpendicular.

    Parameters
    ----------
    addresses, each
        (frames, 6) where the contacts of each frame lie, and (frames,) how many it has.
    extremes
        (frames, 3), overwritten: the deepest overlap in m, the deepest over the smaller radius, and the number of
        colours.
    """
    c = 0
    for f in range(len(each)):
        deepest, deepest_share, most = 0.0, 0.0, -1
        at, m = addresses[f], each[f]
        pairs, normals = carray(_integers(at[PAIRS]), (m, 2)), carray(_reals(at[NORMALS]), (m, 3))
        overlaps, colours = carray(_reals(at[OVERLAPS]), m), carray(_integers(at[COLOURS]), m)
        for e in range(m):
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
                strips[c, k] = start
                strips[c, 3 + k] = end
            drawn[c] = serial_colour if colours[e] >= serial else cycle[colours[e] % len(cycle)]
            c += 1
        extremes[f, 0], extremes[f, 1], extremes[f, 2] = deepest, deepest_share, most + 1


@long_kernel
def write_contacts(
    addresses: IntArray,
    edges: IntArray,
    each: IntArray,
    middle: FloatArray,
    scale: ColourArray,
    widths: SingleArray,
    ends: NDArray[np.uint32],
    normal: SingleArray,
    tangential: SingleArray,
    mode: NDArray[np.uint8],
    colour: ColourArray,
    width: SingleArray,
) -> None:
    """Write what the contacts at edges did, and how the edges are drawn by their impulses.

    Parameters
    ----------
    addresses, edges, each
        (frames, 6) where the contacts of each frame lie, sorted by pair, and (frames,) how many edges and rows it has.
    middle
        (frames,) N s, the impulse in the middle of the scale.
    scale, widths
        (levels,) colours and radii by rising impulse.
    """
    c = 0
    for f in range(len(edges)):
        pairs = carray(_integers(addresses[f, PAIRS]), (edges[f], 2))
        rows = carray(_records(addresses[f, ROWS]), each[f])
        a = 0
        for e in range(edges[f]):
            i, j = pairs[e, 0], pairs[e, 1]
            while a < each[f] and (rows[a].i < i or (rows[a].i == i and rows[a].j < j)):
                a += 1
            row = rows[a]
            ends[c, 0], ends[c, 1] = i, j
            x, y, z = row.friction_x, row.friction_y, row.friction_z
            normal[c] = np.float32(row.normal_impulse)
            tangential[c] = np.float32(np.sqrt(x * x + y * y + z * z))
            mode[c] = row.mode
            level = min(len(scale) - 1, int(len(scale) * _part_of_longest(max(0.0, row.normal_impulse), middle[f])))
            colour[c], width[c] = scale[level], widths[level]
            c += 1


@long_kernel
def middles(addresses: IntArray, each: IntArray, positive: FloatArray, middle: FloatArray) -> None:
    """Write the median of each frame's normal impulses (N s) that are more than zero; 1 if it has none.

    Parameters
    ----------
    addresses, each
        (frames, 6) where the contacts of each frame lie, and (frames,) how many rows it has.
    positive
        As many as the most rows of a frame, overwritten.
    """
    for f in range(len(each)):
        rows = carray(_records(addresses[f, ROWS]), each[f])
        count = 0
        for c in range(each[f]):
            if rows[c].normal_impulse > 0.0:
                positive[count] = rows[c].normal_impulse
                count += 1
        middle[f] = 1.0 if count == 0 else max(_median(positive[:count]), 2.2250738585072014e-308)


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
    """Partition values in place around the one of a place in rising order, and return it: Hoare's quickselect.

    Rejected: np.median and np.partition, which Numba compiles in 3 and 10 s.
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


@inner
def _pick_strongest(rows: NDArray[np.void], count: int, scratch: FloatArray, chosen: IntArray) -> None:
    """Write which rows have the largest normal impulses, ``count`` of them, in their order; of equal ones the first."""
    m = len(rows)
    if count <= 0:
        return
    if count >= m:
        for c in range(m):
            chosen[c] = c
        return
    for c in range(m):
        scratch[c] = rows[c].normal_impulse
    least = _select(scratch[:m], m - count)
    equal = count  # how many of those as large as the smallest that is chosen
    for c in range(m):
        equal -= rows[c].normal_impulse > least
    found = 0
    for c in range(m):
        impulse = rows[c].normal_impulse
        if impulse > least or (impulse == least and equal > 0):
            equal -= impulse == least
            chosen[found] = c
            found += 1


@long_kernel
def pick_strongest(
    addresses: IntArray, column: int, each: IntArray, counts: IntArray, scratch: FloatArray, chosen: IntArray
) -> None:
    """Write which rows of each frame have the largest normal impulses, as many as it counts, frame after frame.

    Parameters
    ----------
    column, each
        Of the addresses, `ROWS` or `IMPACTS`, and how many of them each frame has.
    scratch
        As many as the most rows of a frame, overwritten.
    """
    first = 0
    for f in range(len(each)):
        rows = carray(_records(addresses[f, column]), each[f])
        _pick_strongest(rows, counts[f], scratch, chosen[first:])
        first += counts[f]


@long_kernel
def gather(addresses: IntArray, column: int, counts: IntArray, chosen: IntArray, found: NDArray[np.void]) -> None:
    """Copy the chosen rows of each frame, ``counts`` of them, one frame's after another's."""
    c = 0
    for f in range(len(counts)):
        rows = carray(_records(addresses[f, column]), 1 << 62)
        for _ in range(counts[f]):
            found[c] = rows[chosen[c]]
            c += 1


@long_kernel
def count_moved(position: FloatArray, before: SingleArray, moved: IntArray) -> None:
    """Count the bodies of each frame, (frames, n, 3), that are drawn elsewhere than in the frame before.

    Parameters
    ----------
    before
        (n, 3), of the frame before the first, overwritten by the last.
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
