"""A 64-bit fingerprint of the exact state: XXH64 of the arrays' bytes as they lie in memory, one after the other."""

from __future__ import annotations

import numpy as np
import xxhash

from carom.physics.bodies import Bodies


def fingerprint(bodies: Bodies, time: float) -> int:
    """Return the fingerprint of time, positions, velocities, orientations and angular velocities, in this order."""
    digest = xxhash.xxh64(np.float64(time).tobytes())
    for array in (bodies.position, bodies.velocity, bodies.orientation, bodies.angular_velocity):
        digest.update(array.data)
    return digest.intdigest()
