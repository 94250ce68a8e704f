"""A 64-bit fingerprint of the exact state: XXH64 of the bytes of its arrays, in their order."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xxhash

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies


def fingerprint(bodies: Bodies, time: float) -> int:
    """Return the fingerprint of time, positions, velocities, orientations and angular velocities, in this order."""
    return fingerprint_of(time, (bodies.position, bodies.velocity, bodies.orientation, bodies.angular_velocity))


def fingerprint_of(time: float, arrays: Iterable[FloatArray | None]) -> int:
    """Return the fingerprint of a time (s) and of arrays; None counts as no array."""
    digest = xxhash.xxh64(np.float64(time).tobytes())
    for array in arrays:
        if array is not None:
            digest.update(np.ascontiguousarray(array).data)
    return digest.intdigest()
