"""The longest step while contacts are held, chosen so that an impact falls into a short step.

A contact that is held pushes its bodies with one impulse for the whole step. An impact in the middle finds velocities
that lack a part of it, and bodies that leave keep a part too much: errors of first order in the step. Each step
therefore covers nine tenths of the time to the impact, until a very short one passes it. The forecast ignores held
contacts, an error of second order.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.contact.events.time_of_impact import time_of_impact
from carom.physics.contact.events.trajectories import ROUNDING
from carom.physics.jit.decorators import inline, kernel
from carom.physics.vector import between, vector

PASSES = 3  # each uses the mean velocity until the impact that the pass before found
SLOW = 2.0  # times the speed that a contact at rest may gain in the time; slower contacts are no impacts
APPROACH = 0.9  # of the time until the impact
SHORT = 1e-4  # of the span; an impact that is nearer is passed by as much


@kernel
def step_by_impacts(
    x: FloatArray,
    v: FloatArray,
    a: FloatArray,
    radius: FloatArray,
    surface: FloatArray,
    offset: FloatArray,
    span: float,
) -> float:
    """Return the longest step in s by the next impact of bodies and planes; infinite if there is none in a span.

    Parameters
    ----------
    x, v, a, radius
        (n, 3) m, m/s and m/s²; (n,) m.
    surface, offset
        (p, 3) normals of planes and (p,) m.
    span
        s.
    """
    first = np.inf
    for i in range(len(radius)):
        for j in range(i + 1, len(radius)):
            dx, dy, dz = between(x, i, j)
            vx, vy, vz = between(v, i, j)
            ax, ay, az = between(a, i, j)
            first = min(first, _time_to_impact(dx, dy, dz, vx, vy, vz, ax, ay, az, radius[i] + radius[j], span))
        for p in range(len(offset)):
            nx, ny, nz = vector(surface, p)
            h = nx * x[i, 0] + ny * x[i, 1] + nz * x[i, 2] - offset[p]
            u = nx * v[i, 0] + ny * v[i, 1] + nz * v[i, 2]
            g = nx * a[i, 0] + ny * a[i, 1] + nz * a[i, 2]
            first = min(first, _time_to_impact(h, 0.0, 0.0, u, 0.0, 0.0, g, 0.0, 0.0, radius[i], span))
    return APPROACH * first if first > SHORT * span else first + SHORT * span


@inline
def _time_to_impact(
    dx: float,
    dy: float,
    dz: float,
    vx: float,
    vy: float,
    vz: float,
    ax: float,
    ay: float,
    az: float,
    R: float,
    span: float,
) -> float:
    """Return the time in s until two meet in an impact, on their parabolas without contacts."""
    tau = span
    for _ in range(PASSES):
        h = 0.5 * tau
        slow = SLOW * span * np.sqrt(ax * ax + ay * ay + az * az) + ROUNDING * R / span
        tau = time_of_impact(dx, dy, dz, vx + ax * h, vy + ay * h, vz + az * h, ax, ay, az, R, span, -h, slow)
        if tau == np.inf:
            break
    return tau
