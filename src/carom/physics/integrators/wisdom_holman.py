"""Wisdom–Holman integration of bodies about a dominant one; close encounters are left to Gauss–Radau integration.

In Jacobi coordinates each body is seen from the centre of mass of those before it, in the order of their semi-major
axes. With M_i = m_0 + … + m_i and m'_i = m_i M_{i-1}/M_i the Hamiltonian is a sum of two that can each be solved
(Wisdom & Holman 1991):

    H_Kepler = Σ_{i≥1} (p'_i² / 2m'_i - G m'_i M_i / |x'_i|) + the free motion of the centre of mass
    H_mutual = Σ_{i≥2} G m'_i M_i / |x'_i| - Σ_{i<j, j≥2} G m_i m_j / |x_i - x_j|

A step of length h drifts on Kepler's orbits for h/2 (`carom.physics.integrators.kepler`), kicks by H_mutual for h and
drifts for h/2 again. Half drifts between steps are joined. With masses ε of the dominant one, the step keeps

    H + ε h²/24 … + O(ε² h²)

The terms in ε and all even powers of h are those of a change of variables, which a symplectic corrector undoes (Wisdom,
Holman & Touma 1996). The integration runs in the variables of the steps; the corrector leads into them at the start,
and out of them for output. With x for h times the rate of change along the orbits, its generator is H_mutual times
(1 - x/2 / sinh(x/2))/x. It is a product of `STAGES` factors

    drift(a h) kick(b h) drift(-2 a h) kick(-b h) drift(a h),        a = k `SPREAD`

each of which adds 2 b sinh(a x) in first order in ε; they agree with it up to x^{2 `STAGES` - 1}. Errors in
ε² h² remain.

The step is the shortest period over `STEPS_PER_TURN`, or over `STEPS_OF_HEAVY` for bodies above `HEAVY`. The period is
that of a circular motion with the angular speed at the pericentre (Wisdom 2015). When two bodies pass within
`HILL_RADII` of their Hill radii, or one comes so close to the dominant one that the step no longer resolves its motion,
the state before that step is handed to `GaussRadau15`, which integrates all bodies until they have parted.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import factorial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.integrators.batch import Batch
from carom.physics.integrators.checkpoint import IntegratorCheckpoint, OrbitCheckpoint
from carom.physics.integrators.gauss_radau15 import GaussRadau15
from carom.physics.integrators.kepler import LANE_ROWS, LANES, TURN, revolve_all
from carom.physics.parallel.jit import long_kernel, unowned
from carom.physics.step_rule import END_TOLERANCE
from carom.plan.features import Requirements
from carom.scene.portable_math import cube_root
from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

STEPS_PER_TURN = 20.0  # of the shortest orbit
STEPS_OF_HEAVY = (
    50.0  # of the orbit of a body above `HEAVY`, whose encounters err by the square of its mass and the step
)
HEAVY = 2e-5  # of the dominant body
HILL_RADII = 12.0  # within which bodies are close whose orbits cross (docs/validation.md)
FEWEST_HILL_RADII = 3.0  # where orbits are farther apart than that, bodies are not close in passing
PART_OF_GAP = 0.9  # of the distance between two orbits: within it, both have left them
PARTED = 1.2  # times the distance from which bodies are close, beyond which they are no longer
UNRESOLVED = 2.0  # a step longer than half of √(r³/μ) is an eighth of a turn or more
STAGES = 4  # of the corrector
SPREAD = Fraction(2, 5)
LANES_FROM = 64  # bodies, from which pairs are summed in SIMD lanes
NEAREST = 0.03  # of the semi-major axis: passages closer than that are left to Gauss–Radau integration
FIRST_PART = 0.01  # of a step: the first one that Gauss–Radau integration tries
ANEW, FAR, CLOSE = range(3)  # phases: from the state as it is, by equal steps, by Gauss–Radau integration


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


class Orbits(NamedTuple):
    """Arrays of an integration; all but the first two are in the order of the Jacobi coordinates."""

    position: FloatArray  # (n, 3) m, the output, in the order of the scene
    velocity: FloatArray  # (n, 3) m/s, likewise
    order: IntArray  # (n,) index in the scene
    mu: FloatArray  # (n,) m³/s², G M_i
    pull: FloatArray  # (n,) m³/s², G m_i
    share: FloatArray  # (n,) m_i / M_i
    near: FloatArray  # (n,) m, the distance from which another body is close
    x: FloatArray  # (n, 3) m, Jacobi coordinates after the last kick; row 0 is the centre of mass
    v: FloatArray  # (n, 3) m/s
    x_spare: FloatArray  # (n, 3) m
    v_spare: FloatArray  # (n, 3) m/s
    place: FloatArray  # (n, 3) m, from the centre of mass
    speed: FloatArray  # (n, 3) m/s, likewise
    acceleration: FloatArray  # (n, 3) m/s²
    reach: FloatArray  # (n,) m, how far a body may move meanwhile
    lanes: FloatArray  # workspace of the Kepler orbits and of the pulls of many


class Conics(NamedTuple):
    """Orbits about the dominant body, (n,) each."""

    axis: FloatArray  # m, semi-major; infinite if unbound
    size: FloatArray  # m, semi-major; its modulus if unbound
    pericentre: FloatArray  # m
    apocentre: FloatArray  # m
    turn: FloatArray  # s, of a circular motion with the angular speed at the pericentre


RUN = np.dtype(
    [
        ("start", np.float64),  # s, the time at which the present series of equal steps began
        ("count", np.int64),  # steps since then
        ("dt", np.float64),  # s
        ("time", np.float64),  # s
        ("before", np.float64),  # s, the time before the last step
        ("steps", np.int64),  # of this call
        ("close", np.int64),  # 1 if the next step would meet a close encounter
    ]
)

LIMITS = ("orbit", "cap", "fixed")  # limits that set a step


class WisdomHolman:
    """Integrates bodies that orbit a dominant one, with many steps per call.

    Parameters
    ----------
    position, velocity
        (n, 3) m and m/s, moved in place.
    pull
        (n,) m³/s², G m of each body.
    max_dt
        s
    fixed_dt
        s; None for a fraction of the shortest orbit.
    resolves
        Whether close encounters of light bodies are left to Gauss–Radau integration.
    """

    def __init__(
        self,
        position: FloatArray,
        velocity: FloatArray,
        pull: FloatArray,
        max_dt: float,
        fixed_dt: float | None,
        resolves: bool = True,
    ) -> None:
        n = len(position)
        vectors = [np.zeros((n, 3)) for _ in range(7)]
        lanes = np.zeros(LANE_ROWS * LANES)
        scalars = [np.zeros(n) for _ in range(4)]
        self._orbits = Orbits(position, velocity, np.zeros(n, np.int64), *scalars, *vectors, np.zeros(n), lanes)  # type: ignore[call-arg]
        self._pull = pull
        self._first = int(np.argmax(pull))
        self._hill = cube_root(pull / (3.0 * pull[self._first]))  # Hill radii over semi-major axes
        self._max_dt, self._fixed_dt = max_dt, fixed_dt
        self._limit, self._resolves = LIMITS[0], resolves
        self._run = np.zeros(1, RUN)
        no_field, none_fixed = np.zeros(3), np.zeros(0, np.int64)
        self._radau = GaussRadau15(position, velocity, pull, none_fixed, no_field, 0.0, max_dt, None)
        self._phase = ANEW
        self._by_radau = False  # the last step
        self._encounters = 0

    @property
    def next_dt(self) -> float:
        """The next step in seconds."""
        return self._radau.next_dt if self._phase == CLOSE else float(self._run["dt"][0])

    @property
    def encounters(self) -> int:
        """Number of times that Gauss–Radau integration took over."""
        return self._encounters

    def begin(self, dt: float) -> None:
        """Begin anew at the present positions and velocities; the first step follows from them."""
        self._phase = ANEW
        self._run["dt"] = dt

    def advance(self, time: float, end: float, until: float, steps: int) -> Batch:
        """Make steps until a time, the end of the run, or a number of steps is reached; see `BatchIntegrator`."""
        taken, before, dt, limit = 0, time, 0.0, ""
        while taken < steps and time < end and (time < until or taken == 0):
            if self._phase == ANEW:
                self._start(time)
            if self._phase == CLOSE:
                did, before, time, dt, limit, _ = self._radau.advance(time, end, until, 1)
                taken += did
                self._by_radau = True
                if not time > before:
                    break
                if time < end and not meets(self._orbits, float(self._run["dt"][0])):
                    self._phase = ANEW
                continue
            run = self._run[0]
            run["steps"], run["time"] = 0, time
            advance(self._orbits, self._run, end, until, steps - taken)
            if run["steps"]:
                taken += int(run["steps"])
                before, time, dt, limit = float(run["before"]), float(run["time"]), float(run["dt"]), self._limit
                self._by_radau = False
                if not time > before:
                    break
            elif run["close"]:
                self._meet()
            else:
                orbits = self._orbits
                if leap(orbits, end - time, orbits.position, orbits.velocity, False):
                    taken, before, time, dt, limit = taken + 1, time, end, end - time, "end"
                    self._phase, self._by_radau = ANEW, False
                else:
                    self._meet()
        return Batch(taken, before, time, dt, limit)

    def at(self, earlier: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities, (n, 3) m and m/s, at a time in s before the end of the last step."""
        if self._by_radau:
            return self._radau.at(earlier)
        position, velocity = np.empty_like(self._orbits.x), np.empty_like(self._orbits.v)
        leap(self._orbits, -earlier, position, velocity, True)
        return position, velocity

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the state that the next step needs."""
        orbits, run, radau = self._orbits, self._run[0], self._radau.checkpoint
        series = [self._phase, run["start"], run["count"], run["dt"], LIMITS.index(self._limit)]
        copies = (orbits.order.astype(np.float64), orbits.near.copy(), orbits.x.copy(), orbits.v.copy())
        own = OrbitCheckpoint(np.array(series, dtype=np.float64), *copies)
        if self._phase == CLOSE:
            return replace(radau, orbits=own)
        nothing, no_rows = np.empty((0, 3)), np.empty((0, 8))
        return IntegratorCheckpoint(0.0, nothing, nothing, no_rows, no_rows, own)

    def restore(self, checkpoint: IntegratorCheckpoint | None, next_dt: float) -> None:
        """Continue from a checkpoint with a step in s; without a checkpoint, begin anew."""
        self.begin(next_dt)
        if checkpoint is None or checkpoint.orbits is None:
            return
        own, orbits, run = checkpoint.orbits, self._orbits, self._run[0]
        phase, run["start"], run["count"], run["dt"], limit = own.series.tolist()
        self._phase, self._limit = int(phase), LIMITS[int(limit)]
        self._set_order(own.order.astype(np.int64), own.near)
        orbits.x[:], orbits.v[:] = own.position, own.velocity
        if self._phase == CLOSE:
            self._radau.restore(checkpoint, next_dt)

    def _meet(self) -> None:
        """Hand over to Gauss–Radau integration."""
        self._phase = CLOSE
        self._encounters += 1
        self._radau.begin(FIRST_PART * float(self._run["dt"][0]))

    def _start(self, time: float) -> None:
        """Order the bodies, choose the step and take the present state as a new start."""
        orbits, conics = self._orbits, self._conics()
        order = np.argsort(conics.axis, kind="stable")
        steps = np.where(self._pull > HEAVY * self._pull[self._first], STEPS_OF_HEAVY, STEPS_PER_TURN)
        dt, self._limit = float((conics.turn / steps)[order[1:]].min()), "orbit"
        if self._fixed_dt is not None:
            dt, self._limit = self._fixed_dt, "fixed"
        elif dt >= self._max_dt:
            dt, self._limit = self._max_dt, "cap"
        self._run[0] = np.zeros(1, RUN)[0]
        self._run["start"], self._run["dt"] = time, dt
        self._set_order(order, self._near(conics)[order])
        begin(orbits, dt)
        self._phase = FAR

    def _set_order(self, order: IntArray, near: FloatArray) -> None:
        """Set what depends on the order of the bodies; ``near``, (n,) m, is in that order."""
        orbits = self._orbits
        orbits.order[:] = order
        orbits.pull[:] = self._pull[order]
        orbits.mu[:] = np.cumsum(orbits.pull)
        orbits.share[:] = orbits.pull / orbits.mu
        orbits.near[:] = near

    def _conics(self) -> Conics:
        """Return the orbits about the dominant body as they are now; its own axis is -1."""
        first = self._first
        x, y, z = (self._orbits.position - self._orbits.position[first]).T
        u, v, w = (self._orbits.velocity - self._orbits.velocity[first]).T
        mu = self._pull + self._pull[first]
        with np.errstate(divide="ignore", invalid="ignore"):
            beta = 2.0 * mu / np.sqrt(x * x + y * y + z * z) - (u * u + v * v + w * w)
            size = mu / np.abs(beta)
            spin = (y * w - z * v, z * u - x * w, x * v - y * u)
            parameter = (spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]) / mu
            e = np.sqrt(np.maximum(1.0 - beta * parameter / mu, 0.0))
            pericentre = parameter / (1.0 + e)
            resolved = np.maximum(pericentre, NEAREST * size)
            turn = TURN * np.sqrt(resolved * resolved * resolved / (mu * (1.0 + e)))
            axis = np.where(beta > 0.0, size, np.inf)
            apocentre = np.where(beta > 0.0, size * (1.0 + e), np.inf)
        axis[first] = -1.0
        return Conics(axis, size, pericentre, apocentre, turn)

    def _near(self, conics: Conics) -> FloatArray:
        """Return the distances in m from which bodies are close to others, (n,); 0 where that does not matter."""
        if not self._resolves:
            return np.zeros(len(self._pull))
        hill = self._hill * np.minimum(conics.size, np.where(conics.axis < np.inf, np.inf, conics.pericentre))
        near = HILL_RADII * hill
        near[self._first] = 0.0
        for i in range(len(near)):
            if i == self._first:
                continue
            gap = np.maximum(conics.pericentre - conics.apocentre[i], conics.pericentre[i] - conics.apocentre)
            gap[[i, self._first]] = np.inf
            if gap.min() > FEWEST_HILL_RADII * hill[i]:
                near[i] = min(near[i], max(FEWEST_HILL_RADII * hill[i], PART_OF_GAP * gap.min()))
        return near


def make(scene: Scene, needs: Requirements, bodies: Bodies, uniform: FloatArray) -> WisdomHolman:
    """Make the integrator of a scene's bodies; a scene with a uniform field is refused before."""
    pull = scene.gravity.constant * bodies.mass
    rule = scene.time
    steps, resolves = (rule.max_dt, rule.fixed_dt), rule.encounters == "resolve"
    return WisdomHolman(bodies.position, bodies.velocity, pull, *steps, resolves)


@unowned
def _drift(x: FloatArray, v: FloatArray, mu: FloatArray, lanes: FloatArray, h: float) -> None:
    """Move all on their Kepler orbits, and the centre of mass on a line."""
    for k in range(3):
        x[0, k] += h * v[0, k]
    revolve_all(x, v, mu, h, lanes)


@unowned
def _from_jacobi(x: FloatArray, share: FloatArray, place: FloatArray) -> None:
    """Turn Jacobi coordinates or their rates into Cartesian ones about the centre of mass."""
    rx, ry, rz = 0.0, 0.0, 0.0  # centre of mass of the bodies up to i
    for i in range(len(x) - 1, 0, -1):
        rx, ry, rz = rx - share[i] * x[i, 0], ry - share[i] * x[i, 1], rz - share[i] * x[i, 2]
        place[i, 0], place[i, 1], place[i, 2] = rx + x[i, 0], ry + x[i, 1], rz + x[i, 2]
    place[0, 0], place[0, 1], place[0, 2] = rx, ry, rz


@unowned
def _to_jacobi(place: FloatArray, order: IntArray, share: FloatArray, x: FloatArray) -> None:
    """Turn Cartesian coordinates or rates, in the order of the scene, into Jacobi ones."""
    first = order[0]
    rx, ry, rz = place[first, 0], place[first, 1], place[first, 2]
    for i in range(1, len(x)):
        j = order[i]
        x[i, 0], x[i, 1], x[i, 2] = place[j, 0] - rx, place[j, 1] - ry, place[j, 2] - rz
        rx, ry, rz = rx + share[i] * x[i, 0], ry + share[i] * x[i, 1], rz + share[i] * x[i, 2]
    x[0, 0], x[0, 1], x[0, 2] = rx, ry, rz


@unowned
def _mutual(place: FloatArray, pull: FloatArray, a: FloatArray) -> None:
    """Write the accelerations by all pairs except the first two bodies, a_i = Σ_j G m_j d_ij / |d_ij|³."""
    n = len(place)
    for i in range(min(n, 2)):
        a[i, 0] = a[i, 1] = a[i, 2] = 0.0
    for i in range(2, n):
        px, py, pz, own = place[i, 0], place[i, 1], place[i, 2], pull[i]
        ax, ay, az = 0.0, 0.0, 0.0
        for j in range(i):
            dx, dy, dz = place[j, 0] - px, place[j, 1] - py, place[j, 2] - pz
            d2 = dx * dx + dy * dy + dz * dz
            d3 = 1.0 / (d2 * np.sqrt(d2))
            f, g = pull[j] * d3, own * d3
            ax, ay, az = ax + f * dx, ay + f * dy, az + f * dz
            a[j, 0], a[j, 1], a[j, 2] = a[j, 0] - g * dx, a[j, 1] - g * dy, a[j, 2] - g * dz
        a[i, 0], a[i, 1], a[i, 2] = ax, ay, az


@unowned
def _mutual_in_lanes(place: FloatArray, pull: FloatArray, a: FloatArray, lanes: FloatArray) -> None:
    """Do the same for many bodies, with those that are pulled side by side in SIMD lanes."""
    n = len(place)
    sx, sy, sz = 0.0, 0.0, 0.0  # of the dominant one
    for i in range(1, n):
        dx, dy, dz = place[0, 0] - place[i, 0], place[0, 1] - place[i, 1], place[0, 2] - place[i, 2]
        d2 = dx * dx + dy * dy + dz * dz
        d3 = 1.0 / (d2 * np.sqrt(d2)) if i > 1 else 0.0
        f, g = pull[0] * d3, pull[i] * d3
        a[i, 0], a[i, 1], a[i, 2] = f * dx, f * dy, f * dz
        sx, sy, sz = sx - g * dx, sy - g * dy, sz - g * dz
    a[0, 0], a[0, 1], a[0, 2] = sx, sy, sz
    for first in range(1, n, LANES):
        count = min(LANES, n - first)
        for k in range(count):
            for row in range(3):
                lanes[row * LANES + k] = place[first + k, row]
                lanes[(row + 3) * LANES + k] = 0.0
        for j in range(1, n):
            xj, yj, zj, mj = place[j, 0], place[j, 1], place[j, 2], pull[j]
            for k in range(count):
                dx, dy, dz = xj - lanes[k], yj - lanes[LANES + k], zj - lanes[2 * LANES + k]
                d2 = dx * dx + dy * dy + dz * dz
                f = mj / (d2 * np.sqrt(d2)) if d2 > 0.0 else 0.0
                lanes[3 * LANES + k] += f * dx
                lanes[4 * LANES + k] += f * dy
                lanes[5 * LANES + k] += f * dz
        for k in range(count):
            for row in range(3):
                a[first + k, row] += lanes[(row + 3) * LANES + k]


@unowned
def _kick(o: Orbits, x: FloatArray, v: FloatArray, h: float) -> None:
    """Change the rates of Jacobi coordinates by H_mutual; `place` has to belong to x."""
    if len(x) < LANES_FROM:
        _mutual(o.place, o.pull, o.acceleration)
    else:
        _mutual_in_lanes(o.place, o.pull, o.acceleration, o.lanes)
    _turn(x, v, o.acceleration, o.share, o.mu, h)


@unowned
def _turn(x: FloatArray, v: FloatArray, a: FloatArray, share: FloatArray, mu: FloatArray, h: float) -> None:
    """Change the rates of Jacobi coordinates by Cartesian accelerations, less those of the Kepler orbits."""
    rx, ry, rz = a[0, 0], a[0, 1], a[0, 2]  # acceleration of the centre of mass of those before i
    for i in range(1, len(x)):
        ax, ay, az = a[i, 0] - rx, a[i, 1] - ry, a[i, 2] - rz
        rx, ry, rz = rx + share[i] * ax, ry + share[i] * ay, rz + share[i] * az
        if i > 1:
            r2 = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1] + x[i, 2] * x[i, 2]
            back = mu[i] / (r2 * np.sqrt(r2))
            ax, ay, az = ax + back * x[i, 0], ay + back * x[i, 1], az + back * x[i, 2]
        v[i, 0], v[i, 1], v[i, 2] = v[i, 0] + h * ax, v[i, 1] + h * ay, v[i, 2] + h * az


@unowned
def _correct(o: Orbits, x: FloatArray, v: FloatArray, h: float, into: bool) -> None:
    """Apply the corrector, or its inverse: into the variables of the steps or out of them."""
    waiting = 0.0  # drift that is not done yet
    for stage in range(STAGES):
        k = stage if into else STAGES - 1 - stage
        a, b = CORRECTOR_DRIFT[k], CORRECTOR_KICK[k]
        if not into:
            a = -a
        _drift(x, v, o.mu, o.lanes, (waiting + a) * h)
        _from_jacobi(x, o.share, o.place)
        _kick(o, x, v, b * h)
        _drift(x, v, o.mu, o.lanes, -2.0 * a * h)
        _from_jacobi(x, o.share, o.place)
        _kick(o, x, v, -b * h)
        waiting = a
    _drift(x, v, o.mu, o.lanes, waiting * h)


@unowned
def _meets(o: Orbits, x: FloatArray, after: float, until: float, apart: float) -> bool:
    """Tell whether two bodies come close from a time after ``place`` until another, on straight lines, both in s.

    Close is nearer than ``apart`` times `Orbits.near`.
    """
    place, speed, near, reach = o.place, o.speed, o.near, o.reach
    longest = max(abs(after), abs(until))
    shortest = apart * UNRESOLVED * (until - after)
    n, widest = len(place), 0.0
    for i in range(1, n):
        widest = max(widest, near[i])
        r2 = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1] + x[i, 2] * x[i, 2]
        if r2 * np.sqrt(r2) < shortest * shortest * o.mu[i]:
            return True
        v2 = speed[i, 0] * speed[i, 0] + speed[i, 1] * speed[i, 1] + speed[i, 2] * speed[i, 2]
        reach[i] = longest * np.sqrt(v2)
    if not widest > 0.0:
        return False
    for i in range(2, n):
        px, py, pz, own, far = place[i, 0], place[i, 1], place[i, 2], near[i], reach[i]
        for j in range(1, i):
            dx, dy, dz = place[j, 0] - px, place[j, 1] - py, place[j, 2] - pz
            d2 = dx * dx + dy * dy + dz * dz
            close = apart * max(own, near[j])
            wide = close + far + reach[j]
            if d2 < wide * wide and _passes(speed, i, j, dx, dy, dz, close, after, until):
                return True
    return False


@unowned
def _passes(
    speed: FloatArray, i: int, j: int, dx: float, dy: float, dz: float, close: float, after: float, until: float
) -> bool:
    """Tell whether the distance of two bodies falls below a length ``close`` in m."""
    ux, uy, uz = speed[j, 0] - speed[i, 0], speed[j, 1] - speed[i, 1], speed[j, 2] - speed[i, 2]
    u2 = ux * ux + uy * uy + uz * uz
    t = -(dx * ux + dy * uy + dz * uz) / u2 if u2 > 0.0 else after
    t = min(max(t, after), until)
    dx, dy, dz = dx + t * ux, dy + t * uy, dz + t * uz
    return dx * dx + dy * dy + dz * dz < close * close


@unowned
def _copy(source: FloatArray, target: FloatArray) -> None:
    for i in range(len(source)):
        target[i, 0], target[i, 1], target[i, 2] = source[i, 0], source[i, 1], source[i, 2]


@unowned
def _put(o: Orbits, x: FloatArray, place: FloatArray, into: FloatArray) -> None:
    """Write Jacobi coordinates or rates in the order of the scene."""
    _from_jacobi(x, o.share, place)
    for i in range(len(x)):
        for k in range(3):
            into[o.order[i], k] = place[i, k] + x[0, k]


@unowned
def _step(o: Orbits, run: Any, x: FloatArray, v: FloatArray) -> bool:
    """Drift to the middle of the next step and kick, unless bodies meet there."""
    dt = run.dt
    _drift(x, v, o.mu, o.lanes, dt if run.count > 0 else 0.5 * dt)
    _from_jacobi(x, o.share, o.place)
    _from_jacobi(v, o.share, o.speed)
    if _meets(o, x, -0.5 * dt, 0.5 * dt, 1.0):
        return False
    _kick(o, x, v, dt)
    return True


@long_kernel
def begin(o: Orbits, h: float) -> None:
    """Take positions and velocities as a new start, for steps of h seconds."""
    _to_jacobi(o.position, o.order, o.share, o.x)
    _to_jacobi(o.velocity, o.order, o.share, o.v)
    _correct(o, o.x, o.v, h, True)


@long_kernel
def advance(o: Orbits, progress: Records, end: float, until: float, most: int) -> None:
    """Make whole steps; see `BatchIntegrator`."""
    run = progress[0]
    run.close = 0
    while run.steps < most and (run.time < until or run.steps == 0) and end - run.time > run.dt * (1.0 + END_TOLERANCE):
        _copy(o.x, o.x_spare)
        _copy(o.v, o.v_spare)
        if not _step(o, run, o.x_spare, o.v_spare):
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


@unowned
def _put_out(o: Orbits, h: float) -> None:
    """Write positions and velocities after the last whole step."""
    x, v = o.x_spare, o.v_spare
    _copy(o.x, x)
    _copy(o.v, v)
    _drift(x, v, o.mu, o.lanes, 0.5 * h)
    _correct(o, x, v, h, False)
    _put(o, x, o.place, o.position)
    _put(o, v, o.speed, o.velocity)


@long_kernel
def leap(o: Orbits, h: float, position: FloatArray, velocity: FloatArray, surely: bool) -> bool:
    """Write positions and velocities a single step of h seconds, forward or back, from those of the bodies.

    Returns False without writing if bodies meet on the way, unless ``surely``.
    """
    x, v = o.x_spare, o.v_spare
    _to_jacobi(o.position, o.order, o.share, x)
    _to_jacobi(o.velocity, o.order, o.share, v)
    _correct(o, x, v, h, True)
    _drift(x, v, o.mu, o.lanes, 0.5 * h)
    _from_jacobi(x, o.share, o.place)
    _from_jacobi(v, o.share, o.speed)
    if not surely and _meets(o, x, -0.5 * abs(h), 0.5 * abs(h), 1.0):
        return False
    _kick(o, x, v, h)
    _drift(x, v, o.mu, o.lanes, 0.5 * h)
    _correct(o, x, v, h, False)
    _put(o, x, o.place, position)
    _put(o, v, o.speed, velocity)
    return True


@long_kernel
def meets(o: Orbits, until: float) -> bool:
    """Tell whether bodies come close in a time in s from now."""
    x, v = o.x_spare, o.v_spare
    _to_jacobi(o.position, o.order, o.share, x)
    _to_jacobi(o.velocity, o.order, o.share, v)
    _from_jacobi(x, o.share, o.place)
    _from_jacobi(v, o.share, o.speed)
    return _meets(o, x, 0.0, until, PARTED)
