"""Impacts at the moments within a drift at which they happen, in the order of time.

Each body knows its next impact. The first one of all is resolved with the velocities of its moment, by the law of
`impulse`; the two bodies go on along new paths, on which each is looked at anew; and so on. Where a body's partner has
been struck by another one meanwhile, the body looks again.

Velocities of the moment τ are v + a (τ - h), h being the kick before the drift. What they say of the energy is exact:
the kicks before and after the drift together do gravity's work on the path as it was, bend and all, if the impulse J
takes out -J·(v(τ) + J/2m). With a constant acceleration a rebound keeps its energy to the last bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.continuous.event_queue import put
from carom.physics.contact.continuous.time_of_impact import meeting, meeting_in_box
from carom.physics.contact.continuous.trajectories import (
    AHEAD,
    CLOCK,
    DT,
    EXHAUSTED,
    KICK,
    ROUNDING,
    STRAYS,
    Paths,
    advance,
    strays,
)
from carom.physics.parallel.jit import inner, long_kernel
from carom.physics.rotation import turn

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MANY = 50  # impacts of a body in a step, of which each further one with e < 1 doubles what is too slow to be one
MOST = 1000  # impacts of a body in a step; what collapses has no last one
TIME, NORMAL, APPROACH, REST, LEDGER, AFTER, COLUMNS = 0, 1, 4, 5, 6, 9, 15  # of the log


@long_kernel
def foresee(lo: int, hi: int, first: IntArray, last: IntArray, others: IntArray, paths: Paths) -> None:
    """Find the first impact of each body i in [lo, hi) with planes and ``others[first[i]:last[i]]``."""
    _look_at_planes(lo, hi, paths)
    _look(lo, hi, first, last, others, paths)


@long_kernel
def resolve(first: IntArray, last: IntArray, others: IntArray, paths: Paths, pairs: IntArray, log: FloatArray) -> int:
    """Resolve impacts until none is left, or the log is full; return how many there were.

    Parameters
    ----------
    first, last, others
        (n,), (n,) and (2 m,): body i may meet ``others[first[i]:last[i]]``.
    pairs, log
        (k, 2) and (k, 15), of each impact: s from the beginning of the drift, normal from i to j, approach and the
        speed up to which it would have been at rest in m/s, J by restitution, by friction and by stabilisation, and
        the velocities of i and of j right after it in m/s.
    """
    for row in range(len(log)):
        i = _next(first, last, others, paths)
        if i < 0:
            return row
        j = paths.partner[i]
        pairs[row, 0], pairs[row, 1] = min(i, j), max(i, j)
        _collide(min(i, j), max(i, j), row, paths, log)
        lossy = paths.law[max(0, max(i, j) - len(paths.x) + 1), 0] < 1.0
        _bend(i, lossy, paths)
        _bend(j, lossy, paths)
        if paths.inverse_mass[i] > 0.0:
            _look_again(i, first, last, others, paths)
        if paths.inverse_mass[j] > 0.0:
            _look_again(j, first, last, others, paths)
    return len(log)


@inner
def _next(first: IntArray, last: IntArray, others: IntArray, paths: Paths) -> int:
    """Move the two bodies of the next impact to where it happens; return the one that knew of it, -1 if none does."""
    n = len(paths.x)
    while paths.counts[AHEAD] > 0:
        i = int(paths.heap[0])
        j = paths.partner[i]
        paths.numbers[CLOCK] = paths.moment[i]
        if j >= n or paths.known[i] == paths.impacts[j]:
            advance(i, paths)
            if j < n:
                advance(j, paths)
            return i
        _look_again(i, first, last, others, paths)  # its partner has another path by now
    return -1


@inner
def _bend(i: int, lossy: bool, paths: Paths) -> None:
    """Count an impact of a body; note if it is the last one, and if its new path leaves its reach.

    Where impacts take energy out, bodies can collide infinitely often in a finite time. Few of them are done when
    nothing but rounding closes; a crowd is stirred by its neighbours and goes on. So what closes too slowly for an
    impact grows with their number, until the crowd is left to the end of the step.
    """
    if paths.inverse_mass[i] == 0.0:
        return
    counts, v = paths.counts, paths.v
    paths.noise[i] = max(paths.noise[i], ROUNDING * (abs(v[i, 0]) + abs(v[i, 1]) + abs(v[i, 2])))
    paths.impacts[i] += 1
    if lossy and paths.impacts[i] > MANY:
        paths.noise[i] *= 2.0
    if paths.impacts[i] == MOST:
        counts[EXHAUSTED] += 1
    if paths.reach[i] >= 0.0 and strays(i, paths):
        paths.reach[i] = -1.0
        paths.strays[counts[STRAYS]] = i
        counts[STRAYS] += 1
        paths.stray_count[:] = counts[STRAYS]


@inner
def _look_again(i: int, first: IntArray, last: IntArray, others: IntArray, paths: Paths) -> None:
    """Find a body's next impact on the rest of its path, and put it on the agenda."""
    counts = paths.counts
    paths.moment[i] = np.inf
    if paths.impacts[i] < MOST:
        _look_at_planes(i, i + 1, paths)
        if paths.reach[i] < 0.0:
            _look(i, i + 1, paths.none, paths.total, paths.everyone, paths)
        else:
            _look(i, i + 1, first, last, others, paths)
            if counts[STRAYS] > 0:
                _look(i, i + 1, paths.none, paths.stray_count, paths.strays, paths)
    counts[AHEAD] = put(i, counts[AHEAD], paths.heap, paths.place, paths.moment, paths.partner)


@inner
def _look(lo: int, hi: int, first: IntArray, last: IntArray, others: IntArray, paths: Paths) -> None:
    """Look along the path of each body i in [lo, hi) for an impact with ``others[first[i]:last[i]]``."""
    x, v, a, radius, inverse_mass = paths.x, paths.v, paths.a, paths.radius, paths.inverse_mass
    rest, noise, now, impacts = paths.rest, paths.noise, paths.now, paths.impacts
    moment, partner, known = paths.moment, paths.partner, paths.known
    Lx, Ly, Lz = paths.box[0], paths.box[1], paths.box[2]
    clock = paths.numbers[CLOCK]
    span, since_kick = paths.numbers[DT] - clock, clock - paths.numbers[KICK]
    for i in range(lo, hi):
        for m in range(first[i], last[i]):
            j = others[m]
            if j == i or impacts[j] >= MOST or inverse_mass[i] + inverse_mass[j] == 0.0:
                continue
            s, t = clock - now[i], clock - now[j]
            dx = (x[j, 0] + v[j, 0] * t) - (x[i, 0] + v[i, 0] * s)
            dy = (x[j, 1] + v[j, 1] * t) - (x[i, 1] + v[i, 1] * s)
            dz = (x[j, 2] + v[j, 2] * t) - (x[i, 2] + v[i, 2] * s)
            vx, vy, vz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
            ax, ay, az = a[j, 0] - a[i, 0], a[j, 1] - a[i, 1], a[j, 2] - a[i, 2]
            R, slow = radius[i] + radius[j], max(rest[i], rest[j]) + noise[i] + noise[j]
            if Lx > 0.0:
                tau = meeting_in_box(dx, dy, dz, vx, vy, vz, ax, ay, az, R, span, since_kick, slow, Lx, Ly, Lz)
            else:
                tau = meeting(dx, dy, dz, vx, vy, vz, ax, ay, az, R, span, since_kick, slow)
            if clock + tau < moment[i] or (clock + tau == moment[i] < np.inf and j < partner[i]):
                moment[i], partner[i], known[i] = clock + tau, j, impacts[j]


@inner
def _look_at_planes(lo: int, hi: int, paths: Paths) -> None:
    """Look along the path of each body in [lo, hi) for an impact with a plane."""
    x, v, a, N, offset = paths.x, paths.v, paths.a, paths.surface, paths.offset
    clock, dt, kick = paths.numbers[CLOCK], paths.numbers[DT], paths.numbers[KICK]
    for i in range(lo, hi if len(offset) > 0 else lo):
        if paths.inverse_mass[i] == 0.0:
            continue
        s = clock - paths.now[i]
        slow = paths.rest[i] + paths.noise[i]
        for p in range(len(offset)):
            gap, rate, pull = -offset[p] - paths.radius[i], 0.0, 0.0
            for k in range(3):
                gap += N[p, k] * (x[i, k] + v[i, k] * s)
                rate += N[p, k] * v[i, k]
                pull += N[p, k] * a[i, k]
            if rate < 0.0:
                meets = clock + max(0.0, gap / -rate)
                if meets <= min(dt, paths.moment[i]) and -(rate + pull * (meets - kick)) > slow:
                    if meets == paths.moment[i] and paths.partner[i] < len(x) + p:
                        continue
                    paths.moment[i], paths.partner[i], paths.known[i] = meets, len(x) + p, 0


@inner
def _collide(i: int, j: int, row: int, paths: Paths, log: FloatArray) -> None:
    """Resolve one impact, with the velocities of the moment; write what it was into a row of the log."""
    v, a, omega, clock = paths.v, paths.a, paths.omega, paths.numbers[CLOCK]
    n, mi, mj = len(paths.x), paths.inverse_mass[i], paths.inverse_mass[j]
    nx, ny, nz, ri, rj = _where_they_meet(i, j, paths)
    s = clock - paths.numbers[KICK]
    vx = v[j, 0] - v[i, 0] + (a[j, 0] - a[i, 0]) * s
    vy = v[j, 1] - v[i, 1] + (a[j, 1] - a[i, 1]) * s
    vz = v[j, 2] - v[i, 2] + (a[j, 2] - a[i, 2]) * s
    vn = vx * nx + vy * ny + vz * nz
    material = max(0, j - n + 1)
    Kn = mi + mj
    Jn = max(0.0, -(1.0 + paths.law[material, 0]) * vn) / Kn
    Jx, Jy, Jz = Jn * nx, Jn * ny, Jn * nz
    log[row, TIME], log[row, APPROACH] = clock, max(0.0, -vn)
    log[row, NORMAL], log[row, NORMAL + 1], log[row, NORMAL + 2] = nx, ny, nz
    log[row, REST] = max(paths.rest[i], paths.rest[j])
    log[row, LEDGER] = -Jn * (vn + 0.5 * Jn * Kn)
    log[row, LEDGER + 1] = log[row, LEDGER + 2] = 0.0
    if len(omega) > 0:
        wx, wy, wz = (
            ri * omega[i, 0] + rj * omega[j, 0],
            ri * omega[i, 1] + rj * omega[j, 1],
            ri * omega[i, 2] + rj * omega[j, 2],
        )
        ux = vx - vn * nx - (wy * nz - wz * ny)
        uy = vy - vn * ny - (wz * nx - wx * nz)
        uz = vz - vn * nz - (wx * ny - wy * nx)
        slip = np.sqrt(ux * ux + uy * uy + uz * uz)
        if slip > 0.0:
            Kt = Kn + ri * ri * paths.inverse_inertia[i] + rj * rj * paths.inverse_inertia[j]
            Jt = slip / Kt
            if Jt > paths.law[material, 1] * Jn:
                Jt = paths.law[material, 2] * Jn
            if Jt > 0.0:
                log[row, LEDGER + 1] = Jt * (slip - 0.5 * Jt * Kt)
                fx, fy, fz = -Jt * (ux / slip), -Jt * (uy / slip), -Jt * (uz / slip)
                Jx, Jy, Jz = Jx + fx, Jy + fy, Jz + fz
                tx, ty, tz = nz * fy - ny * fz, nx * fz - nz * fx, ny * fx - nx * fy  # the normal part turns nothing
                _spin_up(i, ri, tx, ty, tz, paths)
                if j < n:
                    _spin_up(j, rj, tx, ty, tz, paths)
    v[i, 0], v[i, 1], v[i, 2] = v[i, 0] - Jx * mi, v[i, 1] - Jy * mi, v[i, 2] - Jz * mi
    if mj > 0.0:
        v[j, 0], v[j, 1], v[j, 2] = v[j, 0] + Jx * mj, v[j, 1] + Jy * mj, v[j, 2] + Jz * mj
    for k in range(3):
        log[row, AFTER + k], log[row, AFTER + 3 + k] = v[i, k] + a[i, k] * s, v[j, k] + a[j, k] * s


@inner
def _where_they_meet(i: int, j: int, paths: Paths) -> tuple[float, float, float, float, float]:
    """Return the normal from i to j, and both lever arms in m; see `meeting.meet`."""
    x, n = paths.x, len(paths.x)
    if j >= n:
        height = -paths.offset[j - n]
        for k in range(3):
            height += paths.surface[j - n, k] * x[i, k]
        N = paths.surface[j - n]
        return -N[0], -N[1], -N[2], max(0.0, height), 0.0
    dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
    box = paths.box
    if box[0] > 0.0:
        dx -= box[0] * np.floor(dx / box[0] + 0.5)
        dy -= box[1] * np.floor(dy / box[1] + 0.5)
        dz -= box[2] * np.floor(dz / box[2] + 0.5)
    d = np.sqrt(dx * dx + dy * dy + dz * dz)
    share = d / (paths.radius[i] + paths.radius[j])
    return dx / d, dy / d, dz / d, share * paths.radius[i], share * paths.radius[j]


@inner
def _spin_up(i: int, arm: float, tx: float, ty: float, tz: float, paths: Paths) -> None:
    """Change a body's spin by an impulse; turn it as from now on it turns, and not as it would have without that."""
    s = arm * paths.inverse_inertia[i]
    if s == 0.0:
        return
    left = paths.numbers[DT] - paths.numbers[CLOCK]
    turn(i, i + 1, paths.q, paths.omega, -left)
    paths.omega[i, 0] += s * tx
    paths.omega[i, 1] += s * ty
    paths.omega[i, 2] += s * tz
    turn(i, i + 1, paths.q, paths.omega, left)
