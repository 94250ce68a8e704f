"""The steps of Wisdom–Holman integration: many equal steps, or a single step of any length.

`wisdom_holman` has the Hamiltonian. A change of variables removes the error terms of first order in ε, in all even
powers of h (Wisdom, Holman & Touma 1996). The integration runs in the changed variables. A symplectic corrector
converts the state to the changed variables at the start, and back for output. If x stands for h times the rate of
change along the orbits, the generator of the corrector is H_mutual times (1 - x/2 / sinh(x/2))/x. The corrector is a
product of `STAGES` factors

    drift(a h) kick(b h) drift(-2 a h) kick(-b h) drift(a h),        a = k `SPREAD`

and each factor adds 2 b sinh(a x) to first order in ε. The sum of these terms agrees with the generator up to x^{2
`STAGES` - 1}. Errors in ε² h² remain.
"""

from __future__ import annotations

from fractions import Fraction
from math import factorial
from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.forces.gravity.pair import attraction, mutual_attraction
from carom.physics.integrators.wisdom_holman.kepler import END_X, END_Y, END_Z, LANES, X, Y, Z, revolve_all
from carom.physics.jit.decorators import inner, long_kernel
from carom.physics.step_rule import END_TOLERANCE
from carom.physics.vector import Vector, add, between, square, vector, write


class RunRecord(Protocol):
    """The progress of an integration."""

    start: float  # s, start of the present series of equal steps
    count: int  # number of steps since then
    dt: float  # s
    time: float  # s, the present time
    before: float  # s, time before the last step
    steps: int  # number of steps in this call
    close: int  # 1 if the next step would meet a close encounter


RUN = dtype_of(RunRecord)
LANES_FROM = 64  # smallest number of bodies for which pairs are summed in SIMD lanes
STAGES = 4  # stages of the corrector
SPREAD = Fraction(2, 5)
UNRESOLVED = 2.0  # a step longer than √(r³/μ) divided by this number is more than 8 % of a circular orbit
SEPARATED = 1.2  # ratio of the distances at which an encounter ends and begins


class OrbitArrays(NamedTuple):
    """Arrays of an integration; all but the first two are in the order of the Jacobi coordinates."""

    position: FloatArray  # (n, 3) m, output positions in the order of the scene
    velocity: FloatArray  # (n, 3) m/s, output velocities in the order of the scene
    order: IntArray  # (n,) index of each body in the scene
    mu: FloatArray  # (n,) m³/s², G M_i
    gm: FloatArray  # (n,) m³/s², G m_i
    mass_fraction: FloatArray  # (n,) m_i / M_i
    near: FloatArray  # (n,) m, distance below which another body is close
    x: FloatArray  # (n, 3) m, Jacobi coordinates after the last kick; row 0 is the centre of mass
    v: FloatArray  # (n, 3) m/s
    x_spare: FloatArray  # (n, 3) m
    v_spare: FloatArray  # (n, 3) m/s
    place: FloatArray  # (n, 3) m, positions relative to the centre of mass
    speed: FloatArray  # (n, 3) m/s, velocities relative to the centre of mass
    acceleration: FloatArray  # (n, 3) m/s²
    max_displacement: FloatArray  # (n,) m, largest displacement of each body in the time that `meets` tests
    lanes: FloatArray  # workspace for Kepler orbits, and for gravity between many bodies


@inner
def from_jacobi(x: FloatArray, mass_fraction: FloatArray, place: FloatArray) -> None:
    """Convert Jacobi coordinates, or their rates, to Cartesian coordinates about the centre of mass."""
    rx, ry, rz = 0.0, 0.0, 0.0  # centre of mass of the bodies up to i
    for i in range(len(x) - 1, 0, -1):
        px, py, pz = vector(x, i)
        rx, ry, rz = rx - mass_fraction[i] * px, ry - mass_fraction[i] * py, rz - mass_fraction[i] * pz
        write(place, i, rx + px, ry + py, rz + pz)
    write(place, 0, rx, ry, rz)


@inner
def to_jacobi(place: FloatArray, order: IntArray, mass_fraction: FloatArray, x: FloatArray) -> None:
    """Convert Cartesian coordinates, or their rates, in the order of the scene to Jacobi coordinates."""
    first = order[0]
    rx, ry, rz = vector(place, first)
    for i in range(1, len(x)):
        j = order[i]
        px, py, pz = vector(place, j)
        px, py, pz = px - rx, py - ry, pz - rz
        write(x, i, px, py, pz)
        rx, ry, rz = rx + mass_fraction[i] * px, ry + mass_fraction[i] * py, rz + mass_fraction[i] * pz
    write(x, 0, rx, ry, rz)


@inner
def put(o: OrbitArrays, x: FloatArray, place: FloatArray, into: FloatArray) -> None:
    """Convert Jacobi coordinates, or their rates, to Cartesian coordinates in the order of the scene."""
    from_jacobi(x, o.mass_fraction, place)
    for i in range(len(x)):
        for k in range(3):
            into[o.order[i], k] = place[i, k] + x[0, k]


@inner
def kick(o: OrbitArrays, x: FloatArray, v: FloatArray, h: float) -> None:
    """Change the rates of Jacobi coordinates by H_mutual; `OrbitArrays.place` must correspond to x."""
    if len(x) < LANES_FROM:
        _mutual(o.place, o.gm, o.acceleration)
    else:
        _mutual_in_lanes(o.place, o.gm, o.acceleration, o.lanes)
    # convert Cartesian accelerations to Jacobi accelerations, and subtract the accelerations of the Kepler orbits
    a, mass_fraction = o.acceleration, o.mass_fraction
    rx, ry, rz = vector(a, 0)  # acceleration of the centre of mass of the bodies before i
    for i in range(1, len(x)):
        ax, ay, az = vector(a, i)
        ax, ay, az = ax - rx, ay - ry, az - rz
        rx, ry, rz = rx + mass_fraction[i] * ax, ry + mass_fraction[i] * ay, rz + mass_fraction[i] * az
        if i > 1:
            px, py, pz = vector(x, i)
            back = attraction(o.mu[i], px * px + py * py + pz * pz)
            ax, ay, az = ax + back * px, ay + back * py, az + back * pz
        add(v, i, h, ax, ay, az)


@inner
def _mutual(place: FloatArray, gm: FloatArray, a: FloatArray) -> None:
    """Write the accelerations by all pairs but the pair of the first two bodies, a_i = Σ_j G m_j d_ij / |d_ij|³."""
    n = len(place)
    for i in range(min(n, 2)):
        write(a, i, 0.0, 0.0, 0.0)
    for i in range(2, n):
        own = gm[i]
        px, py, pz = vector(place, i)
        ax, ay, az = 0.0, 0.0, 0.0
        for j in range(i):
            dx, dy, dz = vector(place, j)
            dx, dy, dz = dx - px, dy - py, dz - pz
            f, g, _ = mutual_attraction(dx, dy, dz, own, gm[j], 0.0)
            ax, ay, az = ax + f * dx, ay + f * dy, az + f * dz
            add(a, j, -g, dx, dy, dz)
        write(a, i, ax, ay, az)


@inner
def _mutual_in_lanes(place: FloatArray, gm: FloatArray, a: FloatArray, lanes: FloatArray) -> None:
    """Write the accelerations of `_mutual` for many bodies, in SIMD lanes."""
    n = len(place)
    sx, sy, sz = 0.0, 0.0, 0.0  # acceleration of the dominant body
    for i in range(1, n):
        dx, dy, dz = between(place, i, 0)
        f, g, _ = mutual_attraction(dx, dy, dz, gm[i], gm[0], 0.0) if i > 1 else (0.0, 0.0, 0.0)
        write(a, i, f * dx, f * dy, f * dz)
        sx, sy, sz = sx - g * dx, sy - g * dy, sz - g * dz
    write(a, 0, sx, sy, sz)
    for first in range(1, n, LANES):
        count = min(LANES, n - first)
        for k in range(count):
            lanes[X + k], lanes[Y + k], lanes[Z + k] = vector(place, first + k)
            lanes[END_X + k] = lanes[END_Y + k] = lanes[END_Z + k] = 0.0  # the accelerations
        for j in range(1, n):
            gm_j = gm[j]
            xj, yj, zj = vector(place, j)
            for k in range(count):
                dx, dy, dz = xj - lanes[X + k], yj - lanes[Y + k], zj - lanes[Z + k]
                f = attraction(gm_j, dx * dx + dy * dy + dz * dz)
                lanes[END_X + k] += f * dx
                lanes[END_Y + k] += f * dy
                lanes[END_Z + k] += f * dz
        for k in range(count):
            add(a, first + k, 1.0, lanes[END_X + k], lanes[END_Y + k], lanes[END_Z + k])


def _corrector() -> tuple[FloatArray, FloatArray]:
    """Return a and b of the stages: Σ 2 b sinh(a x) = (1 - x/2 / sinh(x/2)) / x up to x^{2 STAGES - 1}."""
    # (x/2) / sinh(x/2) = Σ c_j x^{2j}, from sinh(x/2) / (x/2) = Σ x^{2j} / 4^j (2j+1)!
    quotient = [Fraction(1)]
    for j in range(1, STAGES + 1):
        quotient.append(-sum(quotient[j - i] / (4**i * factorial(2 * i + 1)) for i in range(1, j + 1)))
    spread = [SPREAD * k for k in range(1, STAGES + 1)]
    rows = [[*(2 * a ** (2 * j + 1) / factorial(2 * j + 1) for a in spread), -quotient[j + 1]] for j in range(STAGES)]
    for k in range(STAGES):  # Gauss–Jordan elimination; no pivot vanishes, as in any Vandermonde matrix
        rows[k] = [entry / rows[k][k] for entry in rows[k]]
        for j in range(STAGES):
            if j != k:
                rows[j] = [entry - rows[j][k] * pivot for entry, pivot in zip(rows[j], rows[k], strict=True)]
    return np.array([float(a) for a in spread]), np.array([-float(row[-1]) for row in rows])


CORRECTOR_DRIFT, CORRECTOR_KICK = _corrector()


@inner
def drift(x: FloatArray, v: FloatArray, mu: FloatArray, lanes: FloatArray, h: float) -> None:
    """Move all bodies on their Kepler orbits, and the centre of mass on a line."""
    for k in range(3):
        x[0, k] += h * v[0, k]
    revolve_all(x, v, mu, h, lanes)


@inner
def correct(o: OrbitArrays, x: FloatArray, v: FloatArray, h: float, into: bool) -> None:
    """Apply the corrector or its inverse: convert to the variables of the steps, or back."""
    pending = 0.0  # s, length of the drift that is still pending
    for stage in range(STAGES):
        k = stage if into else STAGES - 1 - stage
        a, b = CORRECTOR_DRIFT[k], CORRECTOR_KICK[k]
        if not into:
            a = -a
        drift(x, v, o.mu, o.lanes, (pending + a) * h)
        from_jacobi(x, o.mass_fraction, o.place)
        kick(o, x, v, b * h)
        drift(x, v, o.mu, o.lanes, -2.0 * a * h)
        from_jacobi(x, o.mass_fraction, o.place)
        kick(o, x, v, -b * h)
        pending = a
    drift(x, v, o.mu, o.lanes, pending * h)


@inner
def meets(o: OrbitArrays, x: FloatArray, after: float, until: float, apart: float) -> bool:
    """Return whether two bodies, moving straight from ``place``, come close between two times (s).

    Close means nearer than ``apart`` times `OrbitArrays.near`.
    """
    place, speed, near, max_displacement = o.place, o.speed, o.near, o.max_displacement
    longest = max(abs(after), abs(until))
    shortest = apart * UNRESOLVED * (until - after)
    n, widest = len(place), 0.0
    for i in range(1, n):
        widest = max(widest, near[i])
        r2 = square(x, i)
        if r2 * np.sqrt(r2) < shortest * shortest * o.mu[i]:
            return True
        max_displacement[i] = longest * np.sqrt(square(speed, i))
    if not widest > 0.0:
        return False
    for i in range(2, n):
        own, far = near[i], max_displacement[i]
        for j in range(1, i):
            dx, dy, dz = between(place, i, j)
            d2 = dx * dx + dy * dy + dz * dz
            close = apart * max(own, near[j])
            wide = close + far + max_displacement[j]
            if d2 < wide * wide and _passes(speed, i, j, (dx, dy, dz), close, after, until):
                return True
    return False


@inner
def _passes(speed: FloatArray, i: int, j: int, d: Vector, close: float, after: float, until: float) -> bool:
    """Return whether the distance of two bodies falls below a length ``close`` in m."""
    (dx, dy, dz), (ux, uy, uz) = d, between(speed, i, j)
    u2 = ux * ux + uy * uy + uz * uz
    t = -(dx * ux + dy * uy + dz * uz) / u2 if u2 > 0.0 else after
    t = min(max(t, after), until)
    dx, dy, dz = dx + t * ux, dy + t * uy, dz + t * uz
    return dx * dx + dy * dy + dz * dz < close * close


@long_kernel
def begin(o: OrbitArrays, h: float) -> None:
    """Start from the present positions and velocities, with steps of h seconds."""
    to_jacobi(o.position, o.order, o.mass_fraction, o.x)
    to_jacobi(o.velocity, o.order, o.mass_fraction, o.v)
    correct(o, o.x, o.v, h, True)


@long_kernel
def advance(o: OrbitArrays, progress: RecordArray[RunRecord], end: float, until: float, most: int) -> None:
    """Take whole steps; see `BatchIntegrator`."""
    run = progress[0]
    run.close = 0
    while run.steps < most and (run.time < until or run.steps == 0) and end - run.time > run.dt * (1.0 + END_TOLERANCE):
        _copy(o.x, o.x_spare)
        _copy(o.v, o.v_spare)
        ahead = run.dt if run.count > 0 else 0.5 * run.dt
        if not _drift_and_kick(o, o.x_spare, o.v_spare, ahead, run.dt, False):
            run.close = 1
            break
        _copy(o.x_spare, o.x)
        _copy(o.v_spare, o.v)
        run.count += 1
        run.steps += 1
        run.before = run.time
        run.time = run.start + run.count * run.dt
        if not run.time > run.before:
            break
    if run.count > 0:
        _put_out(o, run.dt)


@long_kernel
def leap(o: OrbitArrays, h: float, position: FloatArray, velocity: FloatArray, surely: bool) -> bool:
    """Write the positions and velocities after a step of h seconds, forward or backward.

    Return False without writing if bodies meet on the way, unless ``surely``.
    """
    x, v = o.x_spare, o.v_spare
    to_jacobi(o.position, o.order, o.mass_fraction, x)
    to_jacobi(o.velocity, o.order, o.mass_fraction, v)
    correct(o, x, v, h, True)
    if not _drift_and_kick(o, x, v, 0.5 * h, h, surely):
        return False
    drift(x, v, o.mu, o.lanes, 0.5 * h)
    correct(o, x, v, h, False)
    put(o, x, o.place, position)
    put(o, v, o.speed, velocity)
    return True


@long_kernel
def meets_soon(o: OrbitArrays, until: float) -> bool:
    """Return whether bodies come close within a time (s) from now."""
    x, v = o.x_spare, o.v_spare
    to_jacobi(o.position, o.order, o.mass_fraction, x)
    to_jacobi(o.velocity, o.order, o.mass_fraction, v)
    from_jacobi(x, o.mass_fraction, o.place)
    from_jacobi(v, o.mass_fraction, o.speed)
    return meets(o, x, 0.0, until, SEPARATED)


@inner
def _drift_and_kick(o: OrbitArrays, x: FloatArray, v: FloatArray, ahead: float, h: float, surely: bool) -> bool:
    """Drift to the middle of a step of h seconds and kick, unless bodies meet in the step."""
    drift(x, v, o.mu, o.lanes, ahead)
    from_jacobi(x, o.mass_fraction, o.place)
    from_jacobi(v, o.mass_fraction, o.speed)
    if not surely and meets(o, x, -0.5 * abs(h), 0.5 * abs(h), 1.0):
        return False
    kick(o, x, v, h)
    return True


@inner
def _put_out(o: OrbitArrays, h: float) -> None:
    """Write positions and velocities after the last whole step."""
    x, v = o.x_spare, o.v_spare
    _copy(o.x, x)
    _copy(o.v, v)
    drift(x, v, o.mu, o.lanes, 0.5 * h)
    correct(o, x, v, h, False)
    put(o, x, o.place, o.position)
    put(o, v, o.speed, o.velocity)


@inner
def _copy(source: FloatArray, target: FloatArray) -> None:
    for i in range(len(source)):
        target[i, 0], target[i, 1], target[i, 2] = source[i, 0], source[i, 1], source[i, 2]
