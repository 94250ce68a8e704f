"""Taylor series of the potential of a pair, between two boxes of bodies, to order `ORDER`.

Let ψ(d) = (d² + ε²)^{-1/2}, and D_n = ∂ⁿψ for the multi-index n = (n_x, n_y, n_z), with |n| = n_x + n_y + n_z and
n! = n_x! n_y! n_z!. Of a box B with the centre of mass X_B, and of a target at u from the centre X_A of box A,

    M_m = Σ m_j (-y_j)^m / m!                            y_j = x_j - X_B      (multipoles, |m| < p)
    L_k = Σ_m D_{k+m}(X_A - X_B) M_m                     |k| + |m| ≤ p        (local expansion)
    Σ_j m_j ψ = Σ_k L_k u^k / k!                         a = G ∇, φ = -G times this sum

The same pairs (k, m) appear in the force of B on A and in that of A on B, so the two are opposite up to rounding
(Dehnen, 2002). M_m = 0 for |m| = 1, because X_B is the centre of mass; a row of multipoles holds X_B there.

D_n follows from ψ^{(s)} = (-1)^s (2s-1)!! (d² + ε²)^{-s-1/2} by D^{(s)}_{n+e} = d_e D^{(s+1)}_n + n_e D^{(s+1)}_{n-e}
(McMurchie & Davidson, 1978).

The instructions compute eight boxes or bodies at a time, one in each lane of a vector, with every operation of the
series written out: 728 products for the pairs (k, m). One pair of boxes takes 54 ns on a core with AVX-512. A loop over
a table of the products would take 1.5 times as long, because it loads and stores each sum for each product.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils

from carom.physics.jit.intrinsics import instruction
from carom.physics.jit.vectors import LANES, Vectors

Index = tuple[int, int, int]

ORDER = 6  # p; at equal error 5 is slower below 1e-3, and 7 as fast only below 1e-4
ZERO: Index = (0, 0, 0)
AXES: tuple[Index, ...] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def _indices(order: int) -> list[Index]:
    """Return the multi-indices up to an order, those of lower orders first."""
    return [(i, j, n - i - j) for n in range(order + 1) for i in range(n, -1, -1) for j in range(n - i, -1, -1)]


def _sum(a: Index, b: Index) -> Index:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _difference(a: Index, b: Index) -> Index:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _contains(a: Index, b: Index) -> bool:
    return min(_difference(a, b)) >= 0


_LOCAL = _indices(ORDER)
_POLES = _indices(ORDER - 1)
_PLACE = {n: place for place, n in enumerate(_LOCAL)}  # of a multi-index in a row

LOCAL = len(_LOCAL)  # coefficients of a local expansion
POLES = len(_POLES)  # multipoles of a box
MASS = 0  # place of the mass in a row of multipoles
CENTRE = 1  # place of the centre of mass in a row of multipoles, three numbers
assert POLES % LANES == 0  # a row is loaded as whole vectors


def _factors() -> list[tuple[Index, int]]:
    """Return for each multi-index but 0 an axis, and the index that is lower by one along it."""
    axes = [next(axis for axis in range(3) if n[axis]) for n in _LOCAL[1:]]
    return [(_difference(n, AXES[axis]), axis) for n, axis in zip(_LOCAL[1:], axes, strict=True)]


# v^n / n! = v^{lower} / lower! · v_axis / n_axis, for each multi-index but 0
LOWER = np.array([0, *(_PLACE[lower] for lower, _ in _factors())])
AXIS = np.array([0, *(axis for _, axis in _factors())])
SHARE = np.array([1.0, *(1.0 / n[axis] for n, (_, axis) in zip(_LOCAL[1:], _factors(), strict=True))])

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


@instruction
def attract(
    typing: Any, poles: Any, boxes: Any, at: Any, x: Any, y: Any, z: Any, unit: Any, eps2: Any, sums: Any
) -> Any:
    """Add the local expansions of eight boxes about a point, each to a lane of its own.

    Parameters
    ----------
    poles
        (k, POLES) multipoles of all boxes.
    boxes, at
        (l,) indices of boxes; those from ``at`` on are taken.
    x, y, z
        m, the point.
    unit
        1/m; lengths are multiplied by it.
    eps2
        The softening squared, in that unit.
    sums
        (LOCAL × LANES,), increased.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vectors = Vectors(builder)
        address = _addresses(context, builder, signature, args)
        chosen = address(1, args[2])
        rows = [address(0, builder.load(builder.gep(chosen, [_word(s)])), _word(0)) for s in range(LANES)]
        M: list[Any] = []
        for first in range(0, POLES, LANES):
            M += vectors.transpose([vectors.load(row, first) for row in rows])
        scale = vectors.splat(args[6])
        d = [
            vectors.multiply(vectors.subtract(vectors.splat(args[3 + axis]), M[CENTRE + axis]), scale)
            for axis in range(3)
        ]
        D = _derivatives(vectors, d, vectors.splat(args[7]))
        total = address(8, _word(0))
        for k in _LOCAL:
            s = vectors.load(total, LANES * _PLACE[k])
            for m in _POLES:
                if sum(m) != 1 and sum(k) + sum(m) <= ORDER:
                    s = vectors.add(s, vectors.multiply(D[_sum(k, m)], M[_PLACE[m]]))
            vectors.store(s, total, LANES * _PLACE[k])
        return context.get_dummy_value()

    number = types.float64
    return types.void(poles, boxes, types.int64, number, number, number, number, number, sums), generate


def _derivatives(vectors: Vectors, d: list[Any], eps2: Any) -> dict[Index, Any]:
    """Return D_n(d) up to `ORDER`."""
    square = eps2
    for axis in range(3):
        square = vectors.add(square, vectors.multiply(d[axis], d[axis]))
    inverse = vectors.divide(vectors.constant(1.0), square)
    power = vectors.multiply(vectors.square_root(square), inverse)
    found = {(0, ZERO): power}
    for s in range(1, ORDER + 1):
        power = vectors.multiply(vectors.multiply(power, inverse), vectors.constant(1 - 2 * s))
        found[s, ZERO] = power
    for n in _LOCAL[1:]:
        axis = next((axis for axis in range(3) if n[axis] == 1), int(np.argmax(n)))  # 1 needs no second term
        lower = _difference(n, AXES[axis])
        for s in range(ORDER - sum(n) + 1):
            value = vectors.multiply(d[axis], found[s + 1, lower])
            if lower[axis]:
                second = found[s + 1, _difference(lower, AXES[axis])]
                value = vectors.add(value, vectors.multiply(second, vectors.constant(lower[axis])))
            found[s, n] = value
    return {n: found[0, n] for n in _LOCAL}


@instruction
def evaluate(typing: Any, local: Any, at: Any, x: Any, y: Any, z: Any, unit: Any, lanes: Any) -> Any:
    """Add a local expansion at eight bodies.

    Parameters
    ----------
    local, at
        (k, l) rows; that of number ``at`` is taken.
    x, y, z
        m, its centre.
    unit
        1/m; lengths were multiplied by it.
    lanes
        (7, LANES): rows `X` to `PHI`; the sums are increased.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vectors = Vectors(builder)
        address = _addresses(context, builder, signature, args)
        rows = [address(6, _word(row), _word(0)) for row in range(PHI + 1)]
        coefficient, scale = address(0, args[1], _word(0)), vectors.splat(args[5])
        L = {k: vectors.splat(vectors.number(coefficient, _PLACE[k])) for k in _LOCAL}
        u = [
            vectors.multiply(vectors.subtract(vectors.load(rows[axis]), vectors.splat(args[2 + axis])), scale)
            for axis in range(3)
        ]
        powers = {ZERO: vectors.constant(1.0)}
        for n, (lower, axis) in zip(_LOCAL[1:], _factors(), strict=True):
            power = vectors.multiply(powers[lower], u[axis])
            powers[n] = vectors.multiply(power, vectors.constant(1.0 / n[axis])) if n[axis] > 1 else power
        for axis in range(3):
            slope = vectors.constant(0.0)
            for k in _POLES:
                slope = vectors.add(slope, vectors.multiply(L[_sum(k, AXES[axis])], powers[k]))
            _increase(vectors, rows[AX + axis], vectors.multiply(vectors.multiply(slope, scale), scale))
        value = vectors.constant(0.0)
        for k in _LOCAL:
            value = vectors.add(value, vectors.multiply(L[k], powers[k]))
        _increase(vectors, rows[PHI], vectors.multiply(value, scale))
        return context.get_dummy_value()

    number = types.float64
    return types.void(local, types.int64, number, number, number, number, lanes), generate


@instruction
def attract_bodies(typing: Any, x: Any, m: Any, begin: Any, end: Any, eps2: Any, lanes: Any) -> Any:
    """Add the gravity of bodies [begin, end) at eight others, pair by pair; a body does not attract itself.

    Parameters
    ----------
    x, m
        (3, n) m and (n,) kg.
    eps2
        m², the softening squared.
    lanes
        (7, LANES): rows `X` to `PHI`; the sums are increased.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vectors = Vectors(builder)
        address = _addresses(context, builder, signature, args)
        rows = [address(5, _word(row), _word(0)) for row in range(PHI + 1)]
        targets, soft = [vectors.load(rows[axis]) for axis in range(3)], vectors.splat(args[4])
        sums = [vectors.variable(vectors.load(row)) for row in rows[AX:]]
        sources = [address(0, _word(axis), _word(0)) for axis in range(3)]
        masses = address(1, _word(0))
        loop: Any = cgutils.for_range_slice
        with loop(builder, args[2], args[3], _word(1)) as (j, _):
            d = [vectors.subtract(vectors.splat(vectors.number(sources[a], j)), targets[a]) for a in range(3)]
            square = soft
            for axis in range(3):
                square = vectors.add(square, vectors.multiply(d[axis], d[axis]))
            cube = vectors.multiply(square, vectors.square_root(square))
            s = vectors.divide(vectors.splat(vectors.number(masses, j)), cube)
            s = vectors.zero_unless_positive(square, s)
            for axis in range(3):
                vectors.increase(sums[axis], vectors.multiply(s, d[axis]))
            vectors.increase(sums[3], vectors.multiply(s, square))
        for row, total in zip(rows[AX:], sums, strict=True):
            vectors.store(vectors.value(total), row)
        return context.get_dummy_value()

    return types.void(x, m, types.int64, types.int64, types.float64, lanes), generate


def _increase(vectors: Vectors, address: Any, vector: Any) -> None:
    vectors.store(vectors.add(vectors.load(address), vector), address)


def _word(value: int) -> Any:
    return cgutils.intp_t(value)


def _addresses(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Return a function from the number of an argument and indices to the address of an element."""

    def address(number: int, *indices: Any) -> Any:
        kind: Any = signature.args[number]
        view = context.make_array(kind)(context, builder, args[number])
        pointer: Any = cgutils.get_item_pointer
        return pointer(context, builder, kind, view, list(indices))

    return address
