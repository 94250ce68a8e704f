"""State of an integrator besides positions and velocities."""

from __future__ import annotations

from dataclasses import dataclass

from carom.arrays import FloatArray

BY_LEAPFROG = -1.0  # in place of ``last_dt``: contacts came to rest, and leapfrog takes the steps


@dataclass(frozen=True, slots=True)
class OrbitCheckpoint:
    """State of Wisdom–Holman integration; arrays are in the order of its Jacobi coordinates."""

    series: FloatArray  # (5,) phase, start in s, steps since then, step in s, index of what set it
    order: FloatArray  # (n,) index of each body in the scene
    near: FloatArray  # (n,) m, the distance from which another body is close
    position: FloatArray  # (n, 3) m, Jacobi coordinates after the last kick
    velocity: FloatArray  # (n, 3) m/s


@dataclass(frozen=True, slots=True)
class IntegratorCheckpoint:
    """State of Gauss–Radau integration; rows of the last two are the coordinates x, y, z of body after body.

    Its arrays have no rows while Wisdom–Holman integration goes on without it.
    """

    last_dt: float  # s; 0 if nothing is to be predicted from the last step, or `BY_LEAPFROG`
    position_rest: FloatArray  # (n, 3) m, rounding errors of the positions so far
    velocity_rest: FloatArray  # (n, 3) m/s
    accepted: FloatArray  # (3 n, 8) m/s², coefficients of the last step's polynomial
    correction: FloatArray  # (3 n, 8) m/s², error of their prediction
    orbits: OrbitCheckpoint | None = None  # None with Gauss–Radau integration alone
