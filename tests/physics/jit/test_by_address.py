"""Named tuples that kernels pass by address."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from carom.arrays import FloatArray
from carom.physics.jit.by_address import Located, by_address
from carom.physics.jit.cache import _types
from carom.physics.jit.decorators import inner, long_kernel


class Weights(NamedTuple):
    values: FloatArray
    factor: int
    doubles: bool


class Weighted(NamedTuple):
    weights: Weights
    sums: FloatArray


@inner
def add_up(weighted: Weighted) -> float:
    total, weights = 0.0, weighted.weights
    for k in range(len(weights.values)):
        total += weights.values[k] * weights.factor * (2.0 if weights.doubles else 1.0)
        weighted.sums[k] = total
    return total


@long_kernel
def add_up_in_turn(first: Weighted, second: Weighted) -> tuple[float, float]:
    total = 0.0
    for _ in range(3):
        total = add_up(by_address(first))
    return total, add_up(by_address(second))


def test_kernels_read_the_fields_of_a_located_tuple_and_of_tuples_in_it() -> None:
    first = Weighted(Weights(np.arange(4.0), 3, True), np.zeros(4))
    second = Weighted(Weights(np.arange(2.0), 5, False), np.zeros(2))
    assert add_up_in_turn(first, second) == (36.0, 5.0)
    assert first.sums.tolist() == [0.0, 6.0, 18.0, 36.0]
    assert second.sums.tolist() == [0.0, 5.0]


def test_a_compiled_kernel_is_stored_under_the_fields_of_a_located_tuple() -> None:
    compiled: Any = add_up_in_turn
    type_of: Any = numba.typeof
    kind = type_of(Weights(np.zeros(1), 1, True))
    key = _types((Located(kind),), compiled.targetctx.codegen())
    assert b"'values', 'factor', 'doubles'" in key
