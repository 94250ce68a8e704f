"""Taylor series, to order `ORDER`, of the potential between the bodies of two boxes.

Let ψ(d) = (d² + ε²)^{-1/2}, and D_n = ∂ⁿψ for the multi-index n = (n_x, n_y, n_z), with |n| = n_x + n_y + n_z and n! =
n_x! n_y! n_z!. For a box B with centre of mass X_B, and a target displaced by u from the centre X_A of box A,

    M_m = Σ m_j (-y_j)^m / m!                            y_j = x_j - X_B      (multipoles, |m| < p)
    L_k = Σ_m D_{k+m}(X_A - X_B) M_m                     |k| + |m| ≤ p        (local expansion)
    Σ_j m_j ψ = Σ_k L_k u^k / k!                         a = G ∇, φ = -G times this sum

The same pairs (k, m) appear in the force of B on A and in the force of A on B, so the two forces are opposite up to
rounding (Dehnen, 2002). M_m = 0 for |m| = 1, because X_B is the centre of mass; a row of multipoles stores X_B in place
of these zeros.

D_n follows from ψ^{(s)} = (-1)^s (2s-1)!! (d² + ε²)^{-s-1/2} by D^{(s)}_{n+e} = d_e D^{(s+1)}_n + n_e D^{(s+1)}_{n-e}
(McMurchie & Davidson, 1978).

The instructions process eight boxes or bodies at a time, one per lane of a vector, with every operation of the series
written out: 728 products for the pairs (k, m). One pair of boxes takes 54 ns on a core with AVX-512. A loop over a
table of the products would take 1.5 times as long, because it loads and stores each sum for each product. The plain
form is such a loop, for one box or body at a time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.physics.forces.gravity.pair import attraction
from carom.physics.jit.decorators import inner, kernel
from carom.physics.jit.instructions import Code, instruction
from carom.physics.jit.vectors import DOUBLE, Lanes, Sum, read_doubles, spread, transposed, write_doubles
from carom.physics.jit.vectors import WIDTH as LANES
from carom.physics.vector import Vector

Index = tuple[int, int, int]

ORDER = 6  # order p; at equal error, order 5 is slower for errors below 1e-3, and order 7 is as fast only below 1e-4
ZERO: Index = (0, 0, 0)
AXES: tuple[Index, ...] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def _indices(order: int) -> list[Index]:
    """Return the multi-indices up to an order, lower orders first."""
    return [(i, j, n - i - j) for n in range(order + 1) for i in range(n, -1, -1) for j in range(n - i, -1, -1)]


def _sum(a: Index, b: Index) -> Index:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _difference(a: Index, b: Index) -> Index:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _contains(a: Index, b: Index) -> bool:
    return min(_difference(a, b)) >= 0


_LOCAL = _indices(ORDER)
_POLES = _indices(ORDER - 1)
_PLACE = {n: place for place, n in enumerate(_LOCAL)}  # place of a multi-index in a row

LOCAL = len(_LOCAL)  # number of coefficients in a local expansion
POLES = len(_POLES)  # multipoles of a box
MASS = 0  # column of the mass in multipoles
CENTRE = 1  # first of three columns for the centre of mass in multipoles
assert POLES % LANES == 0  # a row is loaded in whole vectors


# v^n / n! = v^{lower} / lower! · v_axis / n_axis, for each multi-index n but 0, with an axis along which n is not 0
_AXES = [next(axis for axis in range(3) if n[axis]) for n in _LOCAL[1:]]
_FACTORS = [(_difference(n, AXES[axis]), axis) for n, axis in zip(_LOCAL[1:], _AXES, strict=True)]
LOWER = np.array([0, *(_PLACE[lower] for lower, _ in _FACTORS)])
AXIS = np.array([0, *_AXES])
SHARE = np.array([1.0, *(1.0 / n[axis] for n, axis in zip(_LOCAL[1:], _AXES, strict=True))])

X, Y, Z, AX, AY, AZ, PHI = range(7)  # rows of the lanes: positions in m, then the sums Σ m d/R³ and Σ m/R
TO, POWER, FROM = range(3)  # columns of the sums that move multipoles and local expansions by a vector t:
# M'_m = Σ_j t^{m-j}/(m-j)! M_j  and  L'_k = Σ_n t^{n-k}/(n-k)! L_n
MOVE_POLES = np.array(
    [
        (_PLACE[m], _PLACE[_difference(m, j)], _PLACE[j])
        for m in _POLES
        for j in _POLES
        if _contains(m, j) and sum(j) != 1 and sum(m) != 1
    ]
)
MOVE_LOCAL = np.array(
    [(_PLACE[k], _PLACE[_difference(n, k)], _PLACE[n]) for k in _LOCAL for n in _LOCAL if _contains(n, k)]
)


# The plain forms use tables where the instructions write everything out: tables of the sums (k, k + m, m) of a local
# expansion, the steps (s, n; axis, lower, second, factor) to the derivatives D^{(s)}_n, and the multi-indices needed
# for a gradient.
TERMS = np.array(
    [
        (_PLACE[k], _PLACE[_sum(k, m)], _PLACE[m])
        for k in _LOCAL
        for m in _POLES
        if sum(m) != 1 and sum(k) + sum(m) <= ORDER
    ]
)
RAISED = np.array([[_PLACE[_sum(k, axis)] for k in _POLES] for axis in AXES])


def _step(n: Index) -> tuple[int, Index, int]:
    """Return the axis e of the last factor of D_n, the index n lowered by one along e, and the lowered index's n_e."""
    # an axis with n = 1 needs no second term
    axis = next((axis for axis in range(3) if n[axis] == 1), int(np.argmax(n)))
    lower = _difference(n, AXES[axis])
    return axis, lower, lower[axis]


STEPS = np.array(
    [
        (s, _PLACE[n], axis, _PLACE[lower], _PLACE[_difference(lower, AXES[axis])] if factor else -1, factor)
        for n in _LOCAL[1:]
        for axis, lower, factor in [_step(n)]
        for s in range(ORDER - sum(n) + 1)
    ]
)


@kernel
def _attract_one_by_one(
    poles: FloatArray, boxes: IntArray, at: int, point: Vector, unit: float, eps2: float, sums: FloatArray
) -> None:
    x, y, z = point
    D = np.empty((ORDER + 1, LOCAL))
    for lane in range(LANES):
        M = poles[boxes[at + lane]]
        dx, dy, dz = (x - M[CENTRE]) * unit, (y - M[CENTRE + 1]) * unit, (z - M[CENTRE + 2]) * unit
        square = eps2 + dx * dx + dy * dy + dz * dz
        inverse = 1.0 / square
        power = np.sqrt(square) * inverse
        D[0, 0] = power
        for s in range(1, ORDER + 1):
            power = power * inverse * float(1 - 2 * s)
            D[s, 0] = power
        for q in range(len(STEPS)):
            s, axis, factor = STEPS[q, 0], STEPS[q, 2], STEPS[q, 5]
            value = (dx if axis == 0 else (dy if axis == 1 else dz)) * D[s + 1, STEPS[q, 3]]
            if factor > 0:
                value = value + D[s + 1, STEPS[q, 4]] * float(factor)
            D[s, STEPS[q, 1]] = value
        for q in range(len(TERMS)):
            k = LANES * TERMS[q, 0] + lane
            sums[k] = sums[k] + D[0, TERMS[q, 1]] * M[TERMS[q, 2]]


@instruction(_attract_one_by_one, at="int64", unit="float64", eps2="float64")
def attract(code: Code, poles: Any, boxes: Any, at: Any, point: Any, unit: Any, eps2: Any, sums: Any) -> None:
    """Add the local expansions of eight boxes about a point (m), each to its own lane of ``sums``, (LOCAL × LANES,).

    ``poles``, (k, POLES), are the multipoles of all boxes, and ``boxes`` has indices; the eight indices from ``at`` on
    are used. ``unit`` (1/m) multiplies lengths; ``eps2`` is the softening squared in these units.
    """
    builder, chosen, total = code.builder, code.element("boxes", at), code.element("sums", 0)
    rows = [code.element("poles", code.load(chosen, lane), 0) for lane in range(LANES)]
    M: list[Lanes] = []
    for first in range(0, POLES, LANES):
        M += transposed([read_doubles(builder, row, first) for row in rows])
    scale = spread(builder, unit)
    centre = [spread(builder, builder.extract_value(point, axis)) for axis in range(3)]
    d = [(along - M[CENTRE + axis]) * scale for axis, along in enumerate(centre)]
    D = _derivatives(d, spread(builder, eps2))
    for k in _LOCAL:
        s = read_doubles(builder, total, LANES * _PLACE[k])
        for m in _POLES:
            if sum(m) != 1 and sum(k) + sum(m) <= ORDER:
                s = s + D[_sum(k, m)] * M[_PLACE[m]]
        write_doubles(s, total, LANES * _PLACE[k])


def _derivatives(d: list[Lanes], eps2: Lanes) -> dict[Index, Lanes]:
    """Return D_n(d) up to `ORDER`."""
    square = eps2
    for along in d:
        square = square + along * along
    inverse = 1.0 / square
    power = square.sqrt() * inverse
    found = {(0, ZERO): power}
    for s in range(1, ORDER + 1):
        power = power * inverse * float(1 - 2 * s)
        found[s, ZERO] = power
    for n in _LOCAL[1:]:
        axis, lower, factor = _step(n)
        for s in range(ORDER - sum(n) + 1):
            value = d[axis] * found[s + 1, lower]
            if factor:
                value = value + found[s + 1, _difference(lower, AXES[axis])] * float(factor)
            found[s, n] = value
    return {n: found[0, n] for n in _LOCAL}


@kernel
def _evaluate_one_by_one(
    local: FloatArray, at: int, x: float, y: float, z: float, unit: float, lanes: FloatArray
) -> None:
    L, powers = local[at], np.empty(LOCAL)
    for lane in range(LANES):
        ux, uy, uz = (lanes[X, lane] - x) * unit, (lanes[Y, lane] - y) * unit, (lanes[Z, lane] - z) * unit
        powers[0] = 1.0
        for n in range(1, LOCAL):
            power = powers[LOWER[n]] * (ux if AXIS[n] == 0 else (uy if AXIS[n] == 1 else uz))
            powers[n] = power * SHARE[n]
        for axis in range(3):
            slope = 0.0
            for k in range(POLES):
                slope = slope + L[RAISED[axis, k]] * powers[k]
            lanes[AX + axis, lane] = lanes[AX + axis, lane] + slope * unit * unit
        value = 0.0
        for k in range(LOCAL):
            value = value + L[k] * powers[k]
        lanes[PHI, lane] = lanes[PHI, lane] + value * unit


@instruction(_evaluate_one_by_one, at="int64", x="float64", y="float64", z="float64", unit="float64")
def evaluate(code: Code, local: Any, at: Any, x: Any, y: Any, z: Any, unit: Any, lanes: Any) -> None:
    """Evaluate a local expansion, row ``at`` of ``local``, about the point x, y, z (m), at eight bodies.

    ``unit`` (1/m) multiplies lengths. ``lanes``, (7, LANES), has rows `X` to `PHI`; results are added to the sums.
    """
    builder, coefficient = code.builder, code.element("local", at, 0)
    rows = [code.element("lanes", row, 0) for row in range(PHI + 1)]
    scale, centre = spread(builder, unit), [spread(builder, along) for along in (x, y, z)]
    L = {k: spread(builder, code.load(coefficient, _PLACE[k])) for k in _LOCAL}
    u = [(read_doubles(builder, row) - along) * scale for row, along in zip(rows[:AX], centre, strict=True)]
    one = spread(builder, DOUBLE(1.0))
    powers = {ZERO: one}
    for n, (lower, axis) in zip(_LOCAL[1:], _FACTORS, strict=True):
        power = powers[lower] * u[axis]
        powers[n] = power * (1.0 / n[axis]) if n[axis] > 1 else power
    for axis in range(3):
        slope = spread(builder, DOUBLE(0.0))
        for k in _POLES:
            slope = slope + L[_sum(k, AXES[axis])] * powers[k]
        write_doubles(read_doubles(builder, rows[AX + axis]) + slope * scale * scale, rows[AX + axis])
    value = spread(builder, DOUBLE(0.0))
    for k in _LOCAL:
        value = value + L[k] * powers[k]
    write_doubles(read_doubles(builder, rows[PHI]) + value * scale, rows[PHI])


@inner
def _attract_bodies_one_by_one(
    x: FloatArray, m: FloatArray, begin: int, end: int, eps2: float, lanes: FloatArray
) -> None:
    for lane in range(LANES):
        for j in range(begin, end):
            dx, dy, dz = x[X, j] - lanes[X, lane], x[Y, j] - lanes[Y, lane], x[Z, j] - lanes[Z, lane]
            square = eps2 + dx * dx + dy * dy + dz * dz
            s = attraction(m[j], square)
            lanes[AX, lane] = lanes[AX, lane] + s * dx
            lanes[AY, lane] = lanes[AY, lane] + s * dy
            lanes[AZ, lane] = lanes[AZ, lane] + s * dz
            lanes[PHI, lane] = lanes[PHI, lane] + s * square


@instruction(_attract_bodies_one_by_one, begin="int64", end="int64", eps2="float64")
def attract_bodies(code: Code, x: Any, m: Any, begin: Any, end: Any, eps2: Any, lanes: Any) -> None:
    """Add the gravity of the bodies [begin, end) to eight other bodies, pair by pair; a body does not attract itself.

    ``x`` is (3, n) m. ``lanes``, (7, LANES), has rows `X` to `PHI`; results are added to the sums.
    """
    builder = code.builder
    rows = [code.element("lanes", row, 0) for row in range(PHI + 1)]
    targets, soft = [read_doubles(builder, row) for row in rows[:AX]], spread(builder, eps2)
    sums = [Sum(read_doubles(builder, row)) for row in rows[AX:]]
    with code.loop(begin, end) as (j, _):
        sources = [spread(builder, code.load(code.element("x", axis, j))) for axis in range(3)]
        d = [source - target for source, target in zip(sources, targets, strict=True)]
        square = soft
        for along in d:
            square = square + along * along
        s = spread(builder, code.load(code.element("m", j))) / (square * square.sqrt())
        s = s.where(square > 0.0, 0.0)
        for total, term in zip(sums, [*d, square], strict=True):
            total.add(s * term)
    for row, total in zip(rows[AX:], sums, strict=True):
        write_doubles(total.value, row)
