"""The adaptive step, from the state of the frame before.

    dt_a = √(2 target_dx / |a|max)                 no acceleration moves a body further than target_dx
    dt_v = cfl · min_i r_i / |v_i - V|             no body crosses more than a part of its own radius
    dt   = min(dt_a, dt_v, max_dt)                 smoothed by a moving average where it grows

V is the velocity of the centre of mass: a scene that moves as a whole gets the same steps. The seed takes the radius
of the *fastest* body in dt_v, and smooths in both directions; its velocity limit is kept as "fastest-body". A shrink
is taken at once, because a smoothed shrink breaks the bound that it exists for.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.kernel import kernel
from carom.scene.schema import Time

FloatArray = NDArray[np.float64]

END_TOLERANCE = 1e-9  # part of a step; a last step shorter than this is merged into the one before


class Timestep:
    """Chooses each step and remembers what the average needs."""

    def __init__(self, time: Time) -> None:
        self._time = time
        self.previous = 0.0  # s, the average; 0 until there is one

    def choose(self, bodies: Bodies, remaining: float) -> tuple[float, str]:
        """Choose the next step.

        Parameters
        ----------
        remaining
            s, until the run ends; the last step is cut to end there.

        Returns
        -------
        dt, limit
            s, and what set it: "acceleration", "velocity", "cap", "growth" (the average), "fixed" or "end".
        """
        if self._time.fixed_dt is not None:
            dt, limit = self._time.fixed_dt, "fixed"
        else:
            dt, limit = self._adaptive(bodies)
        if remaining <= dt * (1.0 + END_TOLERANCE):
            return remaining, "end"
        return dt, limit

    def _adaptive(self, bodies: Bodies) -> tuple[float, str]:
        target, limit = self.target(bodies)
        if 0.0 < self.previous < target:
            smoothed = self.previous + self._time.smoothing * (target - self.previous)
            target, limit = smoothed, limit if self._time.smoothing == 1.0 else "growth"
        self.previous = target
        return target, limit

    def target(self, bodies: Bodies) -> tuple[float, str]:
        """Return the step that the limits allow, before smoothing, and the limit that set it."""
        time = self._time
        fastest_body = time.velocity_limit == "fastest-body"
        a_max, crossing = _limits(bodies.velocity, bodies.acceleration, bodies.mass, bodies.radius, fastest_body)
        dt_a = math.sqrt(2.0 * time.target_dx / a_max) if a_max > 0.0 else math.inf
        dt_v = time.cfl * crossing
        dt = min(dt_a, dt_v, time.max_dt)
        limit = "cap" if dt == time.max_dt else "velocity" if dt == dt_v else "acceleration"
        return dt, limit


@kernel
def _limits(
    velocity: FloatArray, acceleration: FloatArray, mass: FloatArray, radius: FloatArray, fastest_body: bool
) -> tuple[float, float]:
    """Return |a|max in m/s² and the time in which a body crosses its own radius in s, infinite at rest."""
    M, px, py, pz = 0.0, 0.0, 0.0, 0.0
    for i in range(len(mass)):
        M += mass[i]
        px += mass[i] * velocity[i, 0]
        py += mass[i] * velocity[i, 1]
        pz += mass[i] * velocity[i, 2]
    Vx, Vy, Vz = px / M, py / M, pz / M
    a2_max, v2_max, fastest, slowness = 0.0, 0.0, 0, np.inf
    for i in range(len(mass)):
        a2 = acceleration[i, 0] ** 2 + acceleration[i, 1] ** 2 + acceleration[i, 2] ** 2
        a2_max = max(a2_max, a2)
        v2 = (velocity[i, 0] - Vx) ** 2 + (velocity[i, 1] - Vy) ** 2 + (velocity[i, 2] - Vz) ** 2
        if v2 > v2_max:
            v2_max, fastest = v2, i
        if v2 > 0.0:
            slowness = min(slowness, radius[i] / np.sqrt(v2))
    if fastest_body and v2_max > 0.0:
        slowness = radius[fastest] / np.sqrt(v2_max)
    return np.sqrt(a2_max), slowness
