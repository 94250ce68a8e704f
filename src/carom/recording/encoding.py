"""The loops over bodies and contacts of a frame: float64 state into the float32 that is drawn.

They are kernels for the sake of the physics, not of speed as such: NumPy would hold the interpreter's lock meanwhile,
and the physics wants it back after every kernel of its own: 0.3 ms instead of 0.5 ms a frame of 1000 bodies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
ColourArray = NDArray[np.uint32]


@kernel
def cast_positions(position: FloatArray, origin: FloatArray, points: SingleArray) -> None:
    """Write positions (n, 3) relative to an origin."""
    for i in range(len(position)):
        for k in range(3):
            points[i, k] = np.float32(position[i, k] - origin[k])


@kernel
def cast_orientations(orientation: FloatArray, turned: SingleArray) -> None:
    """Write quaternions (n, 4)."""
    for i in range(len(orientation)):
        for k in range(4):
            turned[i, k] = np.float32(orientation[i, k])


@kernel
def turning(torque: FloatArray, body: NDArray[np.uint32], magnitude: FloatArray) -> int:
    """List the bodies with a torque that can be drawn, and its magnitude; return how many there are.

    The largest component is the unit, so that no square overflows.
    """
    found = 0
    for i in range(len(torque)):
        x, y, z = abs(torque[i, 0]), abs(torque[i, 1]), abs(torque[i, 2])
        largest = max(x, y, z)
        if largest > 0.0 and np.isfinite(x + y + z):
            x, y, z = x / largest, y / largest, z / largest
            body[found] = i
            magnitude[found] = largest * np.sqrt(x * x + y * y + z * z)
            found += 1
    return found


@kernel
def draw_arrows(
    torque: FloatArray,
    body: NDArray[np.uint32],
    magnitude: FloatArray,
    points: SingleArray,
    radius: FloatArray,
    unit: FloatArray,
    l_max: float,
    origin: SingleArray,
    vector: SingleArray,
) -> None:
    """Write arrows along the torques of the bodies listed, by the law of `carom.recording.arrows`.

    Parameters
    ----------
    unit
        (n,) N m, the torque of each body whose arrow sticks out by half of ``l_max``.
    """
    for c in range(len(body)):
        i = body[c]
        s = np.cbrt(magnitude[c] / unit[i])
        length = (radius[i] + l_max * (1.0 - 1.0 / (1.0 + s))) / magnitude[c]
        for k in range(3):
            origin[c, k] = points[i, k]
            vector[c, k] = np.float32(torque[i, k] * length)


@kernel
def draw_edges(
    pairs: IntArray,
    normals: FloatArray,
    overlaps: FloatArray,
    colours: IntArray,
    points: SingleArray,
    radius: FloatArray,
    box: FloatArray,
    cycle: ColourArray,
    serial: int,
    serial_colour: np.uint32,
    strips: SingleArray,
    drawn: ColourArray,
) -> None:
    """Write lines (m, 6) between the centres of touching bodies, to the nearest image, and their colours (m,).

    A line to a plane ends at the foot of the perpendicular.
    """
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        for k in range(3):
            start = points[i, k]
            if j < len(points):
                end = points[j, k]
                if box[k] > 0.0:
                    end -= np.float32(box[k] * np.floor((end - start) / box[k] + 0.5))
            else:
                end = start + np.float32((radius[i] - overlaps[c]) * normals[c, k])
            strips[c, k] = start
            strips[c, 3 + k] = end
        drawn[c] = serial_colour if colours[c] >= serial else cycle[colours[c] % len(cycle)]


@kernel
def deepest(pairs: IntArray, overlaps: FloatArray, radius: FloatArray) -> tuple[float, float]:
    """Return the deepest overlap in m, and the deepest over the smaller radius; 0 where nothing overlaps."""
    absolute, relative = 0.0, 0.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        smaller = min(radius[i], radius[j]) if j < len(radius) else radius[i]
        absolute = max(absolute, overlaps[c])
        relative = max(relative, overlaps[c] / smaller)
    return absolute, relative
