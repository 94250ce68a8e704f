"""The bound on the energy of contacts that last: impulses that sweeps have left too large are scaled back.

Impulses λ change the velocities at the contacts from v to v' = v + A λ. What they are to minimise,

    f(λ) = λ·(v + c) + ½ λ·A λ,

is 0 without them, and an impulse that takes energy out keeps it below. Sweeps lower f, but they begin with the impulses
of the kick before, which may be far too large. On the ray θ λ the minimum is at θ = -λ·(v + c) / λ·(v' - v). Where that
is less than 1, the impulses of the island are scaled by it; with the largest of them there is then f ≤ 0, and over a
whole step, whose second kick begins with the impulses of the first, a contact gains no energy. An island is a connected
component of the collision graph without what is fixed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.load import BEFORE
from carom.physics.contact.rest import root_of
from carom.physics.parallel.jit import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def scale_back(
    pairs: IntArray,
    C: FloatArray,
    cold: FloatArray,
    V: FloatArray,
    who: IntArray,
    velocity: FloatArray,
    spin: FloatArray,
    island: IntArray,
    work: FloatArray,
) -> None:
    """Scale the impulses of each island back to where they take out most.

    Parameters
    ----------
    pairs, C, cold, V, who
        See `Load`.
    velocity, spin
        (n + p, 3) m/s and rad/s before the impulses; ``spin`` has no rows where nothing turns.
    island, work
        (n + p,) and (n + p, 2), tables to write in.
    """
    for k in range(len(who)):
        island[who[k]] = who[k]
        work[who[k], 0] = work[who[k], 1] = 0.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        if V[i, 6] > 0.0 and V[j, 6] > 0.0:
            i, j = root_of(island, i), root_of(island, j)
            island[max(i, j)] = min(i, j)
    for c in range(len(pairs)):
        if C[c, 7] == np.inf:
            continue
        i, j = pairs[c, 0], pairs[c, 1]
        nx, ny, nz = C[c, 0], C[c, 1], C[c, 2]
        ux, uy, uz = V[j, 0] - V[i, 0], V[j, 1] - V[i, 1], V[j, 2] - V[i, 2]
        vn = ux * nx + uy * ny + uz * nz
        slope = C[c, 8] * (cold[c, BEFORE] + C[c, 7])
        curvature = C[c, 8] * (vn - cold[c, BEFORE])
        if len(spin) > 0:
            ri, rj = C[c, 3], C[c, 4]
            wx, wy, wz = ri * V[i, 3] + rj * V[j, 3], ri * V[i, 4] + rj * V[j, 4], ri * V[i, 5] + rj * V[j, 5]
            ux = ux - vn * nx - (wy * nz - wz * ny) - cold[c, BEFORE + 1]
            uy = uy - vn * ny - (wz * nx - wx * nz) - cold[c, BEFORE + 2]
            uz = uz - vn * nz - (wx * ny - wy * nx) - cold[c, BEFORE + 3]
            before = C[c, 9] * cold[c, BEFORE + 1] + C[c, 10] * cold[c, BEFORE + 2] + C[c, 11] * cold[c, BEFORE + 3]
            slope += before
            curvature += C[c, 9] * ux + C[c, 10] * uy + C[c, 11] * uz
        own = root_of(island, i if V[i, 6] > 0.0 else j)
        work[own, 0] += slope
        work[own, 1] += curvature
    for k in range(len(who)):
        b = who[k]
        if island[b] == b:  # from here on the scale of the island
            slope, curvature = work[b, 0], work[b, 1]
            work[b, 0] = max(0.0, -slope / curvature) if -slope < curvature else 1.0
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        scale = work[root_of(island, i if V[i, 6] > 0.0 else j), 0]
        if scale < 1.0:
            for k in range(8, 12):
                C[c, k] *= scale
    for k in range(len(who)):
        b = who[k]
        scale = work[root_of(island, b), 0]
        if V[b, 6] > 0.0 and scale < 1.0:
            for axis in range(3):
                V[b, axis] = velocity[b, axis] + scale * (V[b, axis] - velocity[b, axis])
                if len(spin) > 0:
                    V[b, 3 + axis] = spin[b, axis] + scale * (V[b, 3 + axis] - spin[b, axis])
