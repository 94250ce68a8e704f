"""One step of Gauss–Radau integration: its polynomial, its error estimate, and the motion to its end.

`gauss_radau15` has the equations. Each number in a table is computed in exact arithmetic, and rounded once.
"""

from __future__ import annotations

from fractions import Fraction
from math import comb, prod
from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, dtype_of
from carom.physics.forces.gravity.pair import attraction, mutual_attraction
from carom.physics.forces.kernel_forces import Parameters, add_forces
from carom.physics.jit.decorators import inline, inner

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
TERMS = 7  # terms b₀ to b₆ of the polynomial
WIDTH = 8  # length of a row: the terms and a 0 fill a cache line
LANES_FROM = 16  # smallest number of bodies for which SIMD lanes are used
# an acceleration passes through 0 if (τ / τ')² is below this, which never happens on Kepler orbits up to e = 0.99
PASSING = 1.0 / 16.0
LARGEST_CHANGE = 4.0  # largest factor by which a step grows; a step that is too long by a larger factor is repeated
SHRINKING = 2.0  # a step is repeated again only if the ratio of wanted to tried step has risen by this factor
MAX_ITERATIONS = 12  # largest number of iterations of a step; rounding keeps some steps from converging
CONVERGED = 1e-16  # tolerated residual at a node, relative to the largest acceleration: half a unit in the last place
# Refinements, and the residual that is tolerated below each. On orbits of eccentricity 0.05 to 0.9, these residuals add
# less to the error of 1000 orbits than the steps themselves, which take 2.0 to 3.0 iterations.
LONGER = ((2.0**-1.75, 1e-9), (2.0**-1.25, 1e-11), (2.0**-0.25, 1e-12))


def _newton_to_powers() -> list[list[Fraction]]:
    """Return the coefficients of h^{j+1} in h (h - h₁) … (h - h_k), by k and j."""
    rows = [[Fraction(1)] + [Fraction(0)] * (TERMS - 1)]
    for k in range(1, TERMS):
        before = rows[-1]
        rows.append([(before[j - 1] if j else Fraction(0)) - NODES[k] * before[j] for j in range(TERMS)])
    return rows


def _table(rows: list[list[Fraction]]) -> FloatArray:
    """Round each number once, and pad rows with 0."""
    table = np.zeros((len(rows), WIDTH))
    for k, row in enumerate(rows):
        table[k, : len(row)] = [float(number) for number in row]
    return table


POWERS = _table(_newton_to_powers())  # [k, j]: coefficient of g_k in b_j
NODE = np.array([float(node) for node in NODES])
# [s, k]: coefficients of b_k in the acceleration at node s, and in the position at this node divided by T²
ON_ACCELERATION = _table([[h ** (k + 1) for k in range(TERMS)] for h in NODES])
ON_POSITION = _table([[h ** (k + 3) / ((k + 2) * (k + 3)) for k in range(TERMS)] for h in NODES])
TO_DIFFERENCE = np.array([0.0] + [float(1 / prod(NODES[s] - h for h in NODES[:s])) for s in range(1, len(NODES))])
# [k, j]: coefficient of b_j in b'_k
SHIFTED = _table([[Fraction(comb(j + 1, k + 1)) for j in range(TERMS)] for k in range(TERMS)])


class ProgressRecord(Protocol):
    """The progress of an integration."""

    time: float  # s
    before: float  # s, time before the last step
    next_dt: float  # s
    last_dt: float  # s, length of the last step; 0 before the first
    fraction: float  # η
    tolerance: float  # tolerated residual at a node, relative to the largest acceleration
    steps: int
    limit: int  # index into `LIMITS`
    iterations: int
    after_impact: bool  # whether the last step ended at an impact, so that the next step cannot be predicted
    meets: bool  # whether bodies meet at the end of the last step
    rests: bool  # whether the contact of these bodies is at rest
    i: int  # both ends that meet: bodies, or n + p for plane p
    j: int
    clearance: float  # m, smallest gap between any pair at the last test


PROGRESS = dtype_of(ProgressRecord)


class Motion(NamedTuple):
    """Arrays of an integration, with one row for each coordinate x, y, z of body after body."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    position_compensation: FloatArray  # (n, 3) m, accumulated rounding errors of the positions
    velocity_compensation: FloatArray  # (n, 3) m/s
    start: FloatArray  # (n, 3) m/s², accelerations a₀ at the start
    there: FloatArray  # (n, 3) m/s², acceleration at a node
    at: FloatArray  # (n, 3) m, positions at a node
    expected: FloatArray  # (n, 3) m/s², acceleration of the polynomial at a node
    b: FloatArray  # (3 n, 8) m/s²
    predicted: FloatArray  # (3 n, 8) m/s², b before the iterations
    accepted: FloatArray  # (3 n, 8) m/s², b of the last step
    correction: FloatArray  # (3 n, 8) m/s², error of the predicted b
    gm: FloatArray  # (n,) m³/s², G m
    moves: FloatArray  # (n,) 1 for movable bodies, 0 for fixed ones
    field: FloatArray  # (3,) m/s², the uniform field
    eps2: float  # m², the softening squared
    lanes: FloatArray  # (4, n) workspace of `accelerate`
    mass: FloatArray  # (n,) kg
    box: FloatArray  # (3,) zeros, since space is open
    forces: Parameters  # forces of installed packages


def motion_of(
    position: FloatArray,
    velocity: FloatArray,
    gm: FloatArray,
    fixed: IntArray,
    field: FloatArray,
    softening: float,
    mass: FloatArray | None = None,
    forces: Parameters = (),
) -> Motion:
    """Return the arrays of an integration, which moves positions and velocities in place.

    ``fixed`` are the indices of bodies that do not move. Only the forces of installed packages need masses.
    """
    n = len(position)
    moves = np.ones(n)
    moves[fixed] = 0.0
    return Motion(
        position=position,
        velocity=velocity,
        position_compensation=np.zeros((n, 3)),
        velocity_compensation=np.zeros((n, 3)),
        start=np.zeros((n, 3)),
        there=np.zeros((n, 3)),
        at=np.zeros((n, 3)),
        expected=np.zeros((n, 3)),
        b=np.zeros((3 * n, WIDTH)),
        predicted=np.zeros((3 * n, WIDTH)),
        accepted=np.zeros((3 * n, WIDTH)),
        correction=np.zeros((3 * n, WIDTH)),
        gm=gm,
        moves=moves,
        field=field,
        eps2=float(softening * softening),
        lanes=np.empty((4, n)),
        mass=np.zeros(n) if mass is None else mass,
        box=np.zeros(3),
        forces=forces,
    )


@inline
def acceleration_at_start(motion: Motion, i: int, k: int) -> float:
    """Return a coordinate of a₀ with the uniform field, in m/s²."""
    a: float = motion.start[i, k] + motion.field[k] * motion.moves[i]
    return a


@inner
def attempt(motion: Motion, twin: Motion | None, run: ProgressRecord, dt: float, change: float) -> tuple[float, float]:
    """Compute the polynomial of a step, which is shortened while it is too long by more than a factor ``change``.

    Return the step's length and the longest possible next step, in s.
    """
    wanted = _attempt_once(motion, twin, run, dt)
    while wanted * change < dt:
        fraction = wanted / dt
        dt = wanted
        wanted = _attempt_once(motion, twin, run, dt)
        if not wanted > SHRINKING * fraction * dt:
            break  # relative to itself, an acceleration that starts at 0 changes much in any step, however short
    return dt, wanted


@inner
def _attempt_once(motion: Motion, twin: Motion | None, run: ProgressRecord, dt: float) -> float:
    """Compute the polynomial of a step; return the longest possible next step, in s."""
    predict(motion, dt / run.last_dt if run.last_dt > 0.0 and not run.after_impact else 0.0)
    _converge(motion, twin, run, dt)
    return next_step(motion, dt, run.fraction)


@inner
def shorten(motion: Motion, run: ProgressRecord, dt: float, ratio: float) -> None:
    """Compute the polynomial of a step of dt that starts like the present one and is ``ratio`` times as long."""
    b = motion.b
    for c in range(len(b)):
        power = 1.0
        for k in range(TERMS):
            power *= ratio
            b[c, k] *= power
    _converge(motion, None, run, dt)


@inner
def _converge(motion: Motion, twin: Motion | None, run: ProgressRecord, dt: float) -> None:
    """Iterate until the polynomial agrees with the accelerations at the nodes, to the tolerance of the run.

    The twin gets the polynomial as it was before the last iteration.
    """
    before = np.inf
    for iteration in range(MAX_ITERATIONS):
        if twin is not None:
            for c in range(len(motion.b)):
                for j in range(TERMS):
                    twin.b[c, j] = motion.b[c, j]
        error = iterate(motion, dt)
        run.iterations += 1
        if stops(iteration, error, before, run.tolerance):
            break
        before = error


@inline
def stops(iteration: int, error: float, before: float, tolerance: float) -> bool:
    """Return whether iterations end: the residual is small, will be small next time, or no longer falls."""
    return error < tolerance or (iteration > 0 and (error >= before or error * (error / before) < tolerance))


@inner
def predict(motion: Motion, ratio: float) -> None:
    """Extrapolate the polynomial of the last step to a step that is ``ratio`` times as long, as the first guess.

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
def iterate(motion: Motion, dt: float) -> float:
    """Visit the nodes once; return the largest residual relative to the largest acceleration."""
    start, there, expected, b = motion.start, motion.there, motion.expected, motion.b
    most, largest = 0.0, 0.0
    for s in range(1, len(NODE)):
        _evaluate(motion, s, dt)
        accelerate(motion, motion.at, there)
        for i in range(len(start)):
            for k in range(3):
                c = 3 * i + k
                residual = (there[i, k] - start[i, k]) - expected[i, k]  # δ
                difference = residual * TO_DIFFERENCE[s]
                for j in range(WIDTH):
                    b[c, j] += POWERS[s - 1, j] * difference
                most = max(most, abs(residual))
                largest = max(largest, abs(there[i, k]))
    return most / largest if largest > 0.0 else 0.0


@inner
def _evaluate(motion: Motion, s: int, dt: float) -> None:
    """Evaluate the polynomial at a node: positions, and the change of the accelerations since the start."""
    x, v, b = motion.position, motion.velocity, motion.b
    t, square = NODE[s] * dt, dt * dt
    for i in range(len(x)):
        for k in range(3):
            c = 3 * i + k
            position_sum, acceleration_sum = 0.0, 0.0
            for j in range(TERMS - 1, -1, -1):
                position_sum += ON_POSITION[s, j] * b[c, j]
                acceleration_sum += ON_ACCELERATION[s, j] * b[c, j]
            motion.expected[i, k] = acceleration_sum
            curved = 0.5 * t * t * acceleration_at_start(motion, i, k) + square * position_sum
            motion.at[i, k] = x[i, k] + (motion.position_compensation[i, k] + (t * v[i, k] + curved))


@inner
def next_step(motion: Motion, dt: float, fraction: float) -> float:
    """Return the next step (s), a fraction of the shortest time in which an acceleration changes at the step's end."""
    start, b = motion.start, motion.b
    shortest = np.inf
    for i in range(len(start)):
        a, jerk, snap, crackle = 0.0, 0.0, 0.0, 0.0  # squared derivatives, times powers of dt
        for k in range(3):
            c = 3 * i + k
            a1, j1, s1, c1 = start[i, k], 0.0, 0.0, 0.0
            for j in range(TERMS):
                a1 += b[c, j]
                j1 += (j + 1) * b[c, j]
                s1 += (j + 1) * j * b[c, j]
                c1 += (j + 1) * j * (j - 1) * b[c, j]
            a, jerk, snap, crackle = a + a1 * a1, jerk + j1 * j1, snap + s1 * s1, crackle + c1 * c1
        if jerk > 0.0:
            change = jerk + np.sqrt(a * snap)
            passing = change / (np.sqrt(jerk * crackle) + snap)
            shortest = min(shortest, max(2.0 * a / change, PASSING * passing))
    return float(fraction * dt * np.sqrt(shortest))


@inner
def move(motion: Motion, dt: float) -> None:
    """Move to the end of the step with compensated summation, and keep the polynomial for the next prediction."""
    x, v, b = motion.position, motion.velocity, motion.b
    for i in range(len(x)):
        for k in range(3):
            c = 3 * i + k
            position_sum, velocity_sum = 0.0, 0.0
            for j in range(TERMS - 1, -1, -1):
                # a division, since rounded reciprocals would cause a drift
                position_sum += b[c, j] / ((j + 2) * (j + 3))
                velocity_sum += b[c, j] / (j + 2)
                motion.correction[c, j] = b[c, j] - motion.predicted[c, j]
                motion.accepted[c, j] = b[c, j]
            a = acceleration_at_start(motion, i, k)
            step = (position_sum + 0.5 * a) * (dt * dt) + v[i, k] * dt
            _add(x, motion.position_compensation, i, k, step)
            _add(v, motion.velocity_compensation, i, k, (velocity_sum + a) * dt)


@inner
def _add(total: FloatArray, compensation: FloatArray, i: int, k: int, term: float) -> None:
    """Add a term by compensated summation (Kahan 1965)."""
    term += compensation[i, k]
    rounded = total[i, k] + term
    compensation[i, k] = term - (rounded - total[i, k])
    total[i, k] = rounded


@inner
def accelerate(motion: Motion, x: FloatArray, a: FloatArray) -> None:
    """Write the accelerations by gravity, a_i = Σ_j G m_j d_ij / (d_ij² + ε²)^{3/2}, and by other forces.

    The uniform field is added later, without rounding.
    """
    n, moves = len(x), motion.moves
    if n < LANES_FROM:
        _accelerate_few(x, motion.gm, motion.eps2, a)
    else:
        _accelerate_many(x, motion.gm, motion.eps2, a, motion.lanes)
    add_forces(motion.forces, 0, n, x, motion.mass, motion.box, a)
    for i in range(n):
        a[i, 0], a[i, 1], a[i, 2] = moves[i] * a[i, 0], moves[i] * a[i, 1], moves[i] * a[i, 2]


@inner
def _accelerate_few(x: FloatArray, gm: FloatArray, eps2: float, a: FloatArray) -> None:
    for i in range(len(x)):
        a[i, 0] = a[i, 1] = a[i, 2] = 0.0
        for j in range(i):
            dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            on_i, on_j, _ = mutual_attraction(dx, dy, dz, gm[i], gm[j], eps2)
            a[i, 0], a[i, 1], a[i, 2] = a[i, 0] + on_i * dx, a[i, 1] + on_i * dy, a[i, 2] + on_i * dz
            a[j, 0], a[j, 1], a[j, 2] = a[j, 0] - on_j * dx, a[j, 1] - on_j * dy, a[j, 2] - on_j * dz


@inner
def _accelerate_many(x: FloatArray, gm: FloatArray, eps2: float, a: FloatArray, lanes: FloatArray) -> None:
    """Sum as `_accelerate_few` does, with the same bits; the roots and divisions of a body are in SIMD lanes.

    This form takes 0.64 times as long as `_accelerate_few` at 30 bodies, 0.44 times at 100, and longer below 16.
    """
    n = len(x)
    X, Y, Z, d3 = lanes[0], lanes[1], lanes[2], lanes[3]
    for i in range(n):
        X[i], Y[i], Z[i] = x[i, 0], x[i, 1], x[i, 2]
    for i in range(n):
        xi, yi, zi = x[i, 0], x[i, 1], x[i, 2]
        for j in range(np.uint64(i)):  # the bound must be unsigned for the loop to be vectorised
            dx, dy, dz = X[j] - xi, Y[j] - yi, Z[j] - zi
            d3[j] = attraction(1.0, dx * dx + dy * dy + dz * dz + eps2)
        ax, ay, az = 0.0, 0.0, 0.0
        for j in range(i):
            dx, dy, dz = X[j] - xi, Y[j] - yi, Z[j] - zi
            on_i, on_j = gm[j] * d3[j], gm[i] * d3[j]
            ax, ay, az = ax + on_i * dx, ay + on_i * dy, az + on_i * dz
            a[j, 0], a[j, 1], a[j, 2] = a[j, 0] - on_j * dx, a[j, 1] - on_j * dy, a[j, 2] - on_j * dz
        a[i, 0], a[i, 1], a[i, 2] = ax, ay, az


def tolerance(refinement: float) -> float:
    """Return the residual at a node, relative to the largest acceleration, at which iterations end.

    Steps that are 1 / ``refinement`` times as long as usual have larger errors than this residual. Usual steps take two
    iterations; long steps therefore take few more, instead of up to eight. With steps of 1.4, 2, 2.8 and 4 times the
    usual length, 1000 orbits of eccentricity 0.3 take 0.64, 0.59, 0.52 and 0.36 of the time with usual steps. If
    iterations went on down to rounding, these fractions would be 1.1, 1.0, 0.85 and 0.75.
    """
    return next((residual for below, residual in LONGER if refinement < below), CONVERGED)
