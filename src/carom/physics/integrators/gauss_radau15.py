"""Gauss–Radau integration of order 15 with steps from its error estimate, for bodies that only pull each other.

Within a step of length T the acceleration of a coordinate is a polynomial in h = t/T, 0 ≤ h ≤ 1 (Everhart 1985):

    a(h) = a₀ + b₀ h + b₁ h² + … + b₆ h⁷
    x(h) = x₀ + h T v₀ + (h T)² (a₀/2 + Σ b_k h^{k+1} / ((k+2)(k+3)))
    v(h) = v₀ + h T (a₀ + Σ b_k h^{k+1} / (k+2))

that interpolates the accelerations at the eight Gauss–Radau nodes h₀ = 0, …, h₇. These depend on the positions, so the
coefficients are found by iteration, starting from the extrapolated polynomial of the previous step. Newton's form

    a(h) = a₀ + g₀ h + g₁ h (h - h₁) + g₂ h (h - h₁)(h - h₂) + …

lets each node in turn improve one g. All terms after g_{s-1} vanish at h_s, so the residual of the polynomial there is
the error of g_{s-1} times h_s (h_s - h₁) … (h_s - h_{s-1}). With compensated rounding, the energy error of a planetary
system is a random walk of the last bit (Rein & Spiegel 2015).

The next step is a fraction η of the shortest time in which the acceleration of a body changes, from its first two
derivatives at the end of the step (Pham, Rein & Spiegel 2024):

    T' = η min_i √(2 a² / (ȧ² + a ä)),        η = (5040 ε)^{1/7}, ε = 10⁻⁹

It uses sums, products, quotients and square roots only, so the bits are the same on any processor.
"""

from __future__ import annotations

from fractions import Fraction
from math import comb, prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.integrators.batch import Batch
from carom.physics.integrators.checkpoint import IntegratorCheckpoint
from carom.physics.parallel.jit import inner, long_kernel
from carom.physics.time_step import END_TOLERANCE
from carom.plan.features import Requirements
from carom.scene.schema import Scene

FloatArray = NDArray[np.float64]
Records = NDArray[np.void]

# 0 and the zeros of (P₇(x) + P₈(x)) / (1 + x), with Legendre polynomials P, mapped from [-1, 1] to [0, 1]
NODES = tuple(
    Fraction(node)
    for node in (
        "0",
        "0.0562625605369221464656521910323111758",
        "0.180240691736892364987579942809181785",
        "0.352624717113169637373907770171241203",
        "0.547153626330555383001448557652348855",
        "0.734210177215410531523210608306610003",
        "0.885320946839095768090359762932485373",
        "0.97752061356128750189117450042915494",
    )
)
TERMS = 7  # of the polynomial, b₀ to b₆
WIDTH = 8  # of a row: the terms and a 0, so that a row is a cache line
STEP_FRACTION = 0.17506702932189996  # η
LARGEST_CHANGE = 4.0  # a step is repeated if it was too long by more than this factor; none grows by more
CONVERGED = 1e-16  # of the largest acceleration, tolerated residual at a node: half a last bit
MAX_ITERATIONS = 12  # rounding prevents some from converging
LIMITS = ("error", "cap", "fixed", "end")  # limits that set a step
ERROR, CAP, FIXED, END = range(len(LIMITS))


def _newton_to_powers() -> list[list[Fraction]]:
    """Return the coefficients of h^{j+1} in h (h - h₁) … (h - h_k), by k and j."""
    rows = [[Fraction(1)] + [Fraction(0)] * (TERMS - 1)]
    for k in range(1, TERMS):
        before = rows[-1]
        rows.append([(before[j - 1] if j else Fraction(0)) - NODES[k] * before[j] for j in range(TERMS)])
    return rows


def _table(rows: list[list[Fraction]]) -> FloatArray:
    """Round each number once; rows are padded with 0."""
    table = np.zeros((len(rows), WIDTH))
    for k, row in enumerate(rows):
        table[k, : len(row)] = [float(number) for number in row]
    return table


POWERS = _table(_newton_to_powers())  # [k, j]: coefficient of g_k in b_j
NODE = np.array([float(node) for node in NODES])
# [s, k]: coefficients of b_k in the acceleration at a node, and in the position there over T²
ON_ACCELERATION = _table([[h ** (k + 1) for k in range(TERMS)] for h in NODES])
ON_POSITION = _table([[h ** (k + 3) / ((k + 2) * (k + 3)) for k in range(TERMS)] for h in NODES])
TO_DIFFERENCE = np.array([0.0] + [float(1 / prod(NODES[s] - h for h in NODES[:s])) for s in range(1, len(NODES))])
SHIFTED = _table([[Fraction(comb(j + 1, k + 1)) for j in range(TERMS)] for k in range(TERMS)])  # [k, j], of b_j in b'_k


class Motion(NamedTuple):
    """Arrays of an integration; rows are the coordinates x, y, z of body after body."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    position_rest: FloatArray  # (n, 3) m, rounding errors of the positions so far
    velocity_rest: FloatArray  # (n, 3) m/s
    start: FloatArray  # (n, 3) m/s², a₀
    pull: FloatArray  # (n, 3) m/s², at a node
    at: FloatArray  # (n, 3) m, positions at a node
    expected: FloatArray  # (n, 3) m/s², acceleration there by the polynomial
    b: FloatArray  # (3 n, 8) m/s²
    predicted: FloatArray  # (3 n, 8) m/s², b before the iterations
    accepted: FloatArray  # (3 n, 8) m/s², b of the last step
    correction: FloatArray  # (3 n, 8) m/s², error of its prediction
    pull_of: FloatArray  # (n,) m³/s², G m
    moves: FloatArray  # (n,) 1, or 0 if it is fixed
    field: FloatArray  # (3,) m/s², uniform


PROGRESS = np.dtype(
    [
        ("time", np.float64),  # s
        ("before", np.float64),  # s, the time before the last step
        ("next_dt", np.float64),  # s
        ("last_dt", np.float64),  # s, 0 before the first step
        ("fraction", np.float64),  # η
        ("steps", np.int64),
        ("limit", np.int64),  # index of `LIMITS`
        ("iterations", np.int64),
        ("rejected", np.int64),
    ]
)


class GaussRadau15:
    """Integrates bodies that pull each other, with many steps per call.

    Parameters
    ----------
    position, velocity
        (n, 3) m and m/s, moved in place.
    pull
        (n,) m³/s², G m of each body.
    fixed
        Indices of bodies that do not move.
    field
        (3,) m/s², uniform acceleration.
    softening
        m
    max_dt
        s
    fixed_dt
        s; None for steps from the error estimate.
    fraction
        η, of the shortest time in which an acceleration changes, that a step takes.
    """

    def __init__(
        self,
        position: FloatArray,
        velocity: FloatArray,
        pull: FloatArray,
        fixed: NDArray[np.int64],
        field: FloatArray,
        softening: float,
        max_dt: float,
        fixed_dt: float | None,
        fraction: float = STEP_FRACTION,
    ) -> None:
        n = len(position)
        moves = np.ones(n)
        moves[fixed] = 0.0
        vectors = [np.zeros((n, 3)) for _ in range(6)]
        rows = [np.zeros((3 * n, WIDTH)) for _ in range(4)]
        self._motion = Motion(position, velocity, *vectors, *rows, pull, moves, field)  # type: ignore[call-arg]
        self._softening_squared = softening * softening
        self._max_dt = max_dt if fixed_dt is None else fixed_dt
        self._adapts = fixed_dt is None
        self._fraction = fraction
        self._progress = np.zeros(1, PROGRESS)

    @property
    def next_dt(self) -> float:
        """The next step in seconds."""
        return float(self._progress["next_dt"][0])

    @property
    def iterations(self) -> int:
        """Number of iterations of all steps so far."""
        return int(self._progress["iterations"][0])

    @property
    def rejected(self) -> int:
        """Number of steps that were repeated with a shorter one."""
        return int(self._progress["rejected"][0])

    def begin(self, dt: float) -> None:
        """Begin anew at the present positions and velocities, with a first step of about dt seconds."""
        motion = self._motion
        for array in (motion.position_rest, motion.velocity_rest, motion.accepted, motion.correction):
            array[:] = 0.0
        self._progress[0] = np.zeros(1, PROGRESS)[0]
        self._progress["next_dt"] = dt
        self._progress["fraction"] = self._fraction

    def advance(self, time: float, end: float, until: float, steps: int) -> Batch:
        """Make steps until a time, the end of the run, or a number of steps is reached; see `BatchIntegrator`."""
        progress = self._progress
        progress["time"], progress["steps"] = time, 0
        advance(self._motion, self._softening_squared, progress, end, until, steps, self._max_dt, self._adapts)
        last = progress[0]
        times = float(last["before"]), float(last["time"]), float(last["last_dt"])
        return Batch(int(last["steps"]), *times, LIMITS[last["limit"]])

    def at(self, earlier: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities, (n, 3) m and m/s, at a time in s before the end of the last step."""
        motion, dt = self._motion, float(self._progress["last_dt"][0])
        h = (dt - earlier) / dt
        a = motion.start + motion.field * motion.moves[:, np.newaxis]
        b = motion.accepted.reshape(*a.shape, WIDTH)[..., :TERMS]
        k = np.arange(TERMS)
        turned = dt * ((1.0 - h) * a + b @ ((1.0 - h ** (k + 2)) / (k + 2)))
        v = motion.velocity - turned
        begin = motion.velocity - dt * (a + b @ (1.0 / (k + 2)))
        bent = 0.5 * (1.0 - h * h) * a + b @ ((1.0 - h ** (k + 3)) / ((k + 2) * (k + 3)))
        return motion.position - (earlier * begin + dt * dt * bent), v

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the state that the next step needs."""
        motion = self._motion
        rests = motion.position_rest.copy(), motion.velocity_rest.copy()
        last_dt = float(self._progress["last_dt"][0])
        return IntegratorCheckpoint(last_dt, *rests, motion.accepted.copy(), motion.correction.copy())

    def restore(self, checkpoint: IntegratorCheckpoint | None, next_dt: float) -> None:
        """Continue from a checkpoint with a step in s; without a checkpoint, begin anew."""
        motion = self._motion
        self.begin(next_dt)
        if checkpoint is None:
            return
        self._progress["last_dt"] = checkpoint.last_dt
        motion.position_rest[:] = checkpoint.position_rest
        motion.velocity_rest[:] = checkpoint.velocity_rest
        motion.accepted[:] = checkpoint.accepted
        motion.correction[:] = checkpoint.correction


def make(scene: Scene, needs: Requirements, bodies: Bodies, uniform: FloatArray) -> GaussRadau15:
    """Make the integrator of a scene's bodies in a uniform field, (3,) m/s²."""
    rule, gravity = scene.time, scene.gravity
    pull = gravity.constant * bodies.mass if needs.gravity.modelled else np.zeros(len(bodies))
    fixed = np.flatnonzero(bodies.ends.inverse_mass[: len(bodies)] == 0.0)
    steps = (rule.max_dt, rule.fixed_dt, STEP_FRACTION / scene.refinement)
    return GaussRadau15(bodies.position, bodies.velocity, pull, fixed, uniform, gravity.softening, *steps)


@long_kernel
def advance(
    motion: Motion,
    eps2: float,
    progress: Records,
    end: float,
    until: float,
    most: int,
    max_dt: float,
    adapts: bool,
) -> None:
    """Make steps; see `GaussRadau15.advance`."""
    run = progress[0]
    while run.steps < most and run.time < end and (run.time < until or run.steps == 0):
        dt, run.limit = run.next_dt, ERROR
        if dt >= max_dt or not adapts:
            dt, run.limit = max_dt, CAP if adapts else FIXED
        if end - run.time <= dt * (1.0 + END_TOLERANCE):
            dt, run.limit = end - run.time, END
        accelerate(motion.position, motion.pull_of, motion.moves, eps2, motion.start)
        wanted = _attempt(motion, eps2, run, dt)
        while adapts and wanted * LARGEST_CHANGE < dt:
            dt, run.limit = wanted, ERROR
            run.rejected += 1
            wanted = _attempt(motion, eps2, run, dt)
        _move(motion, dt)
        run.before = run.time
        run.time = end if run.limit == END else run.time + dt
        run.last_dt, run.next_dt = dt, min(wanted, LARGEST_CHANGE * dt)
        run.steps += 1
        if not run.time > run.before:
            break  # the step is too short to change the clock, or NaN


@inner
def _attempt(motion: Motion, eps2: float, run: Any, dt: float) -> float:
    """Find the polynomial of a step; return the longest next step, in s."""
    _predict(motion, dt / run.last_dt if run.last_dt > 0.0 else 0.0)
    before = np.inf
    for iteration in range(MAX_ITERATIONS):
        error = _iterate(motion, eps2, dt)
        run.iterations += 1
        if error < CONVERGED:
            break
        if iteration > 0 and (error >= before or error * (error / before) < CONVERGED):
            break  # only rounding is left, or would be after another pass with the same gain
        before = error
    return _next_step(motion, dt, run.fraction)


@inner
def _predict(motion: Motion, ratio: float) -> None:
    """Extrapolate the polynomial of the last step over one that is ``ratio`` times as long, as the first guess.

    b'_k = ratio^{k+1} Σ_{j≥k} (j+1 over k+1) b_j, plus the error of the previous guess.
    """
    accepted, correction, predicted, b = motion.accepted, motion.correction, motion.predicted, motion.b
    for c in range(len(b)):
        power = 1.0
        for k in range(TERMS):
            power *= ratio
            shifted = 0.0
            for j in range(TERMS - 1, k - 1, -1):
                shifted += SHIFTED[k, j] * accepted[c, j]
            predicted[c, k] = power * shifted
            b[c, k] = predicted[c, k] + (correction[c, k] if ratio > 0.0 else 0.0)


@inner
def _iterate(motion: Motion, eps2: float, dt: float) -> float:
    """Visit the nodes once; return the largest residual over the largest acceleration."""
    start, pull, expected, b = motion.start, motion.pull, motion.expected, motion.b
    most, largest = 0.0, 0.0
    for s in range(1, len(NODE)):
        _evaluate(motion, s, dt)
        accelerate(motion.at, motion.pull_of, motion.moves, eps2, pull)
        for i in range(len(start)):
            for k in range(3):
                c = 3 * i + k
                missing = (pull[i, k] - start[i, k]) - expected[i, k]
                delta = missing * TO_DIFFERENCE[s]
                for j in range(WIDTH):
                    b[c, j] += POWERS[s - 1, j] * delta
                most = max(most, abs(missing))
                largest = max(largest, abs(pull[i, k]))
    return most / largest if largest > 0.0 else 0.0


@inner
def _evaluate(motion: Motion, s: int, dt: float) -> None:
    """Evaluate the polynomial at a node: positions, and the change of the accelerations since the start."""
    x, v, start, b, field = motion.position, motion.velocity, motion.start, motion.b, motion.field
    t, square = NODE[s] * dt, dt * dt
    for i in range(len(x)):
        for k in range(3):
            c = 3 * i + k
            bent, more = 0.0, 0.0
            for j in range(TERMS - 1, -1, -1):
                bent += ON_POSITION[s, j] * b[c, j]
                more += ON_ACCELERATION[s, j] * b[c, j]
            motion.expected[i, k] = more
            curved = 0.5 * t * t * (start[i, k] + field[k] * motion.moves[i]) + square * bent
            motion.at[i, k] = x[i, k] + (motion.position_rest[i, k] + (t * v[i, k] + curved))


@inner
def _next_step(motion: Motion, dt: float, fraction: float) -> float:
    """Return η times the shortest time in which an acceleration changes, at the end of the step, in s."""
    start, b = motion.start, motion.b
    shortest = np.inf
    for i in range(len(start)):
        a, jerk, snap = 0.0, 0.0, 0.0  # squares, times powers of dt
        for k in range(3):
            c = 3 * i + k
            a1, j1, s1 = start[i, k], 0.0, 0.0
            for j in range(TERMS):
                a1 += b[c, j]
                j1 += (j + 1) * b[c, j]
                s1 += (j + 1) * j * b[c, j]
            a, jerk, snap = a + a1 * a1, jerk + j1 * j1, snap + s1 * s1
        if jerk > 0.0:
            shortest = min(shortest, 2.0 * a / (jerk + np.sqrt(a * snap)))
    return float(fraction * dt * np.sqrt(shortest))


@inner
def _move(motion: Motion, dt: float) -> None:
    """Move to the end of the step with compensated sums, and keep the polynomial for the next prediction."""
    x, v, start, b, field = motion.position, motion.velocity, motion.start, motion.b, motion.field
    for i in range(len(x)):
        for k in range(3):
            c = 3 * i + k
            bent, turned = 0.0, 0.0
            for j in range(TERMS - 1, -1, -1):
                bent += b[c, j] / ((j + 2) * (j + 3))  # division, because the rounding of reciprocals would accumulate
                turned += b[c, j] / (j + 2)
                motion.correction[c, j] = b[c, j] - motion.predicted[c, j]
                motion.accepted[c, j] = b[c, j]
            a = start[i, k] + field[k] * motion.moves[i]
            step = (bent + 0.5 * a) * (dt * dt) + v[i, k] * dt
            _add(x, motion.position_rest, i, k, step)
            _add(v, motion.velocity_rest, i, k, (turned + a) * dt)


@inner
def _add(total: FloatArray, rest: FloatArray, i: int, k: int, term: float) -> None:
    """Add a term by compensated summation (Kahan 1965)."""
    term += rest[i, k]
    rounded = total[i, k] + term
    rest[i, k] = term - (rounded - total[i, k])
    total[i, k] = rounded


@inner
def accelerate(x: FloatArray, pull_of: FloatArray, moves: FloatArray, eps2: float, a: FloatArray) -> None:
    """Write the accelerations by gravity, a_i = Σ_j G m_j d_ij / (d_ij² + ε²)^{3/2}."""
    n = len(x)
    for i in range(n):
        a[i, 0] = a[i, 1] = a[i, 2] = 0.0
        for j in range(i):
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            d2 = dx * dx + dy * dy + dz * dz + eps2
            d3 = 1.0 / (d2 * np.sqrt(d2)) if d2 > 0.0 else 0.0
            on_i, on_j = pull_of[j] * d3, pull_of[i] * d3
            a[i, 0], a[i, 1], a[i, 2] = a[i, 0] + on_i * dx, a[i, 1] + on_i * dy, a[i, 2] + on_i * dz
            a[j, 0], a[j, 1], a[j, 2] = a[j, 0] - on_j * dx, a[j, 1] - on_j * dy, a[j, 2] - on_j * dz
    for i in range(n):
        a[i, 0], a[i, 1], a[i, 2] = moves[i] * a[i, 0], moves[i] * a[i, 1], moves[i] * a[i, 2]
