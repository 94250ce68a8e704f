"""The paths of bodies through a drift: straight lines that bend at impacts, and what is known of each of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.diagnostics.momentum import centre_velocity
from carom.physics.parallel.jit import inner, kernel, long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ROUNDING = 1e-14  # of a body's speed so far, and of a radius a drift; what closes more slowly has been resolved
DT, KICK, CLOCK = 0, 1, 2  # numbers, s: the drift, the kick before it, and what time it is
AHEAD, STRAYS, EXHAUSTED = 0, 1, 2  # counts: bodies with an impact ahead, strays, bodies that had `MOST` impacts
FARTHEST = 1e150  # m; what might go farther is not followed, since the square of its way is no number


class Paths(NamedTuple):
    """n bodies and p planes in a drift."""

    x: FloatArray  # (n, 3) m, at the time `now` of each
    v: FloatArray  # (n + p, 3) m/s
    a: FloatArray  # (n + p, 3) m/s²
    q: FloatArray  # (n, 4) xyzw at the end of the drift; (0, 4) where nothing spins
    omega: FloatArray  # (n + p, 3) rad/s; (0, 3) without friction
    inverse_mass: FloatArray  # (n + p,) 1/kg
    inverse_inertia: FloatArray  # (n + p,) 1/(kg m²)
    radius: FloatArray  # (n + p,) m
    box: FloatArray  # (3,) m; zeros in open space
    surface: FloatArray  # (p, 3) normals
    offset: FloatArray  # (p,) m
    law: FloatArray  # (1 + p, 3) restitution, static and kinetic friction: between bodies, then of each plane
    start: FloatArray  # (n, 3) m, at the beginning of the drift
    reach: FloatArray  # (n,) m, how far from there it stays, seen from the bulk; negative for a stray, which does not
    rest: FloatArray  # (n + p,) m/s, closing speed up to which what it touches is at rest
    noise: FloatArray  # (n,) m/s, what rounding does to its velocity
    now: FloatArray  # (n,) s from the beginning of the drift
    moment: FloatArray  # (n,) s, of its next impact; infinite if there is none
    partner: IntArray  # (n,) whom it meets then
    known: IntArray  # (n,) impacts of the partner when that was found
    impacts: IntArray  # (n,) so far
    heap: IntArray  # (n,), see `agenda`
    place: IntArray  # (n,)
    strays: IntArray  # (n,)
    everyone: IntArray  # (n,) all bodies
    none: IntArray  # (n,) 0: where each body's part of one of the two lists above begins,
    total: IntArray  # (n,) n, and where it ends
    stray_count: IntArray  # (n,) likewise
    bulk: FloatArray  # (3,) m/s, the velocity that the reach counts from
    numbers: FloatArray  # (3,)
    counts: IntArray  # (3,)


@kernel
def reaches(
    v: FloatArray, mass: FloatArray, radius: FloatArray, anchored: bool, dt: float, reach: FloatArray, bulk: FloatArray
) -> float:
    """Write how far bodies may get in dt, and the velocity that this counts from; return the largest part of a radius.

    A body stays within what it would cover at its own speed and the mean speed of all, seen from the centre of mass, or
    from what stands still: enough room for what most impacts do to it, and one fast body widens no other's reach.
    """
    bulk[0], bulk[1], bulk[2] = (0.0, 0.0, 0.0) if anchored else centre_velocity(v, mass)
    mean, largest = 0.0, 0.0
    for i in range(len(reach)):
        ux, uy, uz = v[i, 0] - bulk[0], v[i, 1] - bulk[1], v[i, 2] - bulk[2]
        reach[i] = np.sqrt(ux * ux + uy * uy + uz * uz)
        mean += reach[i] / len(reach)
    for i in range(len(reach)):
        reach[i] = min(FARTHEST, dt * (reach[i] + mean))
        largest = max(largest, reach[i] / radius[i])
    return largest


@kernel
def set_out(paths: Paths, dt: float, kick: float) -> None:
    """Begin a drift."""
    paths.numbers[DT], paths.numbers[KICK], paths.numbers[CLOCK] = dt, kick, 0.0
    paths.counts[:] = 0
    x, v, radius, start, noise = paths.x, paths.v, paths.radius, paths.start, paths.noise
    now, moment, impacts, place = paths.now, paths.moment, paths.impacts, paths.place
    for i in range(len(x)):
        start[i, 0], start[i, 1], start[i, 2] = x[i, 0], x[i, 1], x[i, 2]
        now[i], moment[i], impacts[i], place[i] = 0.0, np.inf, 0, -1
        noise[i] = ROUNDING * (abs(v[i, 0]) + abs(v[i, 1]) + abs(v[i, 2]) + radius[i] / dt)


@inner
def advance(i: int, paths: Paths) -> None:
    """Move a body along its path to where it is now."""
    s = paths.numbers[CLOCK] - paths.now[i]
    for k in range(3):
        paths.x[i, k] += paths.v[i, k] * s
    paths.now[i] = paths.numbers[CLOCK]


@inner
def strays(i: int, paths: Paths) -> bool:
    """Tell whether the rest of a body's path leaves the reach that neighbours were searched with."""
    numbers = paths.numbers
    way2 = 0.0
    for k in range(3):
        end = paths.x[i, k] + paths.v[i, k] * (numbers[DT] - paths.now[i])
        way = end - paths.bulk[k] * numbers[DT] - paths.start[i, k]
        way2 += way * way
    return bool(way2 > paths.reach[i] * paths.reach[i])


@long_kernel
def arrive(lo: int, hi: int, paths: Paths) -> None:
    """Move the bodies [lo, hi) to the end of the drift."""
    x, v, now, dt = paths.x, paths.v, paths.now, paths.numbers[DT]
    for i in range(lo, hi):
        s = dt - now[i]
        x[i, 0] += v[i, 0] * s
        x[i, 1] += v[i, 1] * s
        x[i, 2] += v[i, 2] * s
