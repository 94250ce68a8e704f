"""The nodes of Gauss–Radau integration and the tables that follow from them.

Each number of a table is computed in exact arithmetic and rounded once.
"""

from __future__ import annotations

from fractions import Fraction
from math import comb, prod

import numpy as np

from carom.arrays import FloatArray

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
