"""Code that computes with lanes has the bits of a loop over the same formula."""

from __future__ import annotations

from typing import Any, Protocol

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from carom.arrays import dtype_of
from carom.physics.aligned import aligned_empty
from carom.physics.jit.decorators import inline
from carom.physics.jit.inside import ir
from carom.physics.jit.instructions import Code, instruction
from carom.physics.jit.vectors import (
    WIDTH,
    WORD,
    RecordLanes,
    added_in_order,
    in_lanes,
    read_doubles,
    read_flags,
    where,
    write_doubles,
)

FloatArray = NDArray[np.float64]

EIGHT = arrays(np.float64, WIDTH, elements=st.floats(width=64))
MASKS = arrays(np.bool_, WIDTH)


class PairRecord(Protocol):
    """Sixteen numbers, in two cache lines."""

    a: float
    b: float
    c: float
    d: float
    e: float
    f: float
    g: float
    h: float
    i: float
    j: float
    k: float
    l: float  # noqa: E741
    m: float
    n: float
    o: float
    p: float


PAIR = dtype_of(PairRecord, size=128)


@inline
def chosen(x: float, y: float) -> float:
    ratio = abs(x) / y
    return where((x > y) & (ratio < 2.0), np.sqrt(ratio), -x * y - 0.5)


@inline
def branching(x: float, y: float) -> float:
    return x if x > y else y


@numba.njit(error_model="numpy")
def choose_in_loop(x: FloatArray, y: FloatArray, found: FloatArray) -> None:
    for k in range(len(x)):
        found[k] = chosen(x[k], y[k])


@instruction(choose_in_loop)
def choose_in_lanes(code: Code, x: Any, y: Any, found: Any) -> None:
    lanes = in_lanes(chosen)(*(read_doubles(code.builder, code.element(name, 0)) for name in ("x", "y")))
    write_doubles(lanes, code.element("found", 0))


@numba.njit(error_model="numpy")
def run_choice(x: FloatArray, y: FloatArray, found: FloatArray) -> None:
    choose_in_lanes(x, y, found)


@numba.njit(error_model="numpy")
def change_each(records: NDArray[np.void], mask: NDArray[np.bool_], total: float) -> float:
    raise NotImplementedError


@instruction(change_each, returns="float64", total="float64")
def change_records(code: Code, records: Any, mask: Any, total: Any) -> Any:
    """Where the mask is set: add the second line's fields to both lines, then double "c"; return Σ a + b in order."""
    builder, addresses = code.builder, [code.element("records", k) for k in range(WIDTH)]
    held = read_flags(builder, code.element("mask", 0))
    lanes = RecordLanes(builder, PAIR, addresses, (0, 1))
    lanes.add((0, 1), [getattr(lanes, name) for name in "ijklmnop"], held)
    again = RecordLanes(builder, PAIR, addresses, (0,))
    again.change(c=again.c * 2.0)
    again.write(0, held)
    return added_in_order(builder, total, again.a, again.b)


@numba.njit(error_model="numpy")
def run_change(records: NDArray[np.void], mask: NDArray[np.bool_], total: float) -> float:
    found: float = change_records(records, mask, total)
    return found


@given(EIGHT, EIGHT)
def test_a_formula_in_lanes_has_the_bits_of_a_loop(x: FloatArray, y: FloatArray) -> None:
    in_vectors, one_by_one = np.empty(WIDTH), np.empty(WIDTH)
    run_choice(x, y, in_vectors)
    choose_in_loop(x, y, one_by_one)
    numbers = ~np.isnan(one_by_one)  # the sign of NaN is not specified
    assert in_vectors[numbers].tobytes() == one_by_one[numbers].tobytes()
    assert np.isnan(in_vectors[~numbers]).all()


@given(arrays(np.float64, (WIDTH, 16), elements=st.floats(-1e9, 1e9)), MASKS)
def test_records_of_a_mask_are_changed_and_the_others_keep_their_bits(
    values: FloatArray, mask: NDArray[np.bool_]
) -> None:
    records = aligned_empty(WIDTH, PAIR)
    numbers = records.view(np.float64).reshape(WIDTH, 16)
    numbers[:] = values
    expected = values.copy()
    expected[mask] += np.tile(values[mask, 8:], 2)
    total = 0.25
    for a, b in expected[:, :2].tolist():
        total += a
        total += b
    assert run_change(records, mask, 0.25) == total
    expected[mask, 2] *= 2.0
    assert numbers.tobytes() == expected.tobytes()


def test_a_formula_that_branches_is_refused_in_lanes() -> None:
    builder = ir.IRBuilder(ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "f").append_basic_block())
    lanes = [read_doubles(builder, ir.Constant(WORD, place).inttoptr(WORD.as_pointer())) for place in (64, 128)]
    with pytest.raises(TypeError, match="lanes cannot branch"):
        in_lanes(branching)(*lanes)
