"""Lanes: the same arithmetic on several records at once, in the vector registers of the processor.

`Lanes` is a value of a code generator (see `parallel.intrinsics`): one double for each of `WIDTH` records. Its
operators emit strict IEEE arithmetic, so each lane has the bits that a loop over the records would give it. Processors
with narrower registers take two or four instructions for each operation, with the same bits. A mask has a bit for each
lane.

Formulas are written once, for doubles: `in_lanes` makes the same Python code compute with lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from types import FunctionType
from typing import Any

from llvmlite import ir

WIDTH = 8  # doubles in a cache line
DOUBLE, WORD, BIT, BYTE, INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(1), ir.IntType(8), ir.IntType(32)
VECTOR, MASK = ir.VectorType(DOUBLE, WIDTH), ir.VectorType(BIT, WIDTH)


class Lanes:
    """One double per lane."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def __add__(self, other: Lanes) -> Lanes:
        return Lanes(self.builder, self.builder.fadd(self.value, other.value))

    def __sub__(self, other: Lanes) -> Lanes:
        return Lanes(self.builder, self.builder.fsub(self.value, other.value))

    def __mul__(self, other: Lanes) -> Lanes:
        return Lanes(self.builder, self.builder.fmul(self.value, other.value))

    def __truediv__(self, other: Lanes) -> Lanes:
        return Lanes(self.builder, self.builder.fdiv(self.value, other.value))

    def __neg__(self) -> Lanes:
        return Lanes(self.builder, self.builder.fneg(self.value))

    def __abs__(self) -> Lanes:
        return self._apply("llvm.fabs")

    def __bool__(self) -> bool:
        raise TypeError("lanes take no branches")

    def root(self) -> Lanes:
        """Return the square roots."""
        return self._apply("llvm.sqrt")

    def exceeds(self, other: Lanes) -> Any:
        """Return a mask of the lanes that are greater than those of another; NaN is not."""
        return self.builder.fcmp_ordered(">", self.value, other.value)

    def where(self, mask: Any, other: Lanes) -> Lanes:
        """Return these lanes where a mask is set, and the other's elsewhere."""
        return Lanes(self.builder, self.builder.select(mask, self.value, other.value))

    def lane(self, k: int) -> Any:
        """Return the double of a lane."""
        return self.builder.extract_element(self.value, INDEX(k))

    def largest(self) -> Any:
        """Return the largest double of all lanes, none of which may be NaN."""
        lanes = self
        for apart in (4, 2, 1):
            order = [(k + apart) % WIDTH for k in range(WIDTH)]
            lanes = greater(lanes, Lanes(self.builder, shuffled(self.builder, lanes.value, lanes.value, order)))
        return lanes.lane(0)

    def _apply(self, name: str) -> Lanes:
        function = self.builder.module.declare_intrinsic(f"{name}.v{WIDTH}f64", (), ir.FunctionType(VECTOR, [VECTOR]))
        return Lanes(self.builder, self.builder.call(function, [self.value]))


@cache
def in_lanes(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Return a formula of kernels as a function of lanes: its operators, and those of formulas in it, emit code.

    A formula has no branches that depend on its doubles.
    """
    plain: FunctionType = formula.py_func  # type: ignore[attr-defined]
    named = {name: plain.__globals__.get(name) for name in plain.__code__.co_names}
    inner = {name: in_lanes(value) for name, value in named.items() if hasattr(value, "py_func")}
    return FunctionType(plain.__code__, plain.__globals__ | inner)


def greater(first: Lanes, *others: Lanes) -> Lanes:
    """Return the largest, like ``max`` of doubles: the first where they are equal or not numbers."""
    for other in others:
        first = other.where(other.exceeds(first), first)
    return first


def added_in_order(builder: Any, total: Any, *terms: Lanes) -> Any:
    """Add all terms of the first lane to a double, then those of the next; its bits depend on this order."""
    for k in range(WIDTH):
        for term in terms:
            total = builder.fadd(total, term.lane(k))
    return total


def spread(builder: Any, value: Any) -> Lanes:
    """Return a double in all lanes."""
    return gathered(builder, [value] * WIDTH)


def gathered(builder: Any, values: Sequence[Any]) -> Lanes:
    """Return doubles as lanes."""
    return Lanes(builder, _collected(builder, VECTOR, values))


def mask_of(builder: Any, bits: Sequence[Any]) -> Any:
    """Return bits as a mask."""
    return _collected(builder, MASK, bits)


def _collected(builder: Any, kind: Any, values: Sequence[Any]) -> Any:
    vector = ir.Constant(kind, ir.Undefined)
    for k, value in enumerate(values):
        vector = builder.insert_element(vector, value, INDEX(k))
    return vector


def read_doubles(builder: Any, address: Any) -> Lanes:
    """Read eight doubles of an array, from the one at an address on."""
    return Lanes(builder, builder.load(builder.bitcast(address, VECTOR.as_pointer()), align=8))


def read_flags(builder: Any, address: Any) -> Any:
    """Read eight flags of an array, from the one at an address on, as a mask."""
    flags = builder.load(builder.bitcast(address, ir.VectorType(BYTE, WIDTH).as_pointer()), align=1)
    return builder.icmp_unsigned("!=", flags, ir.Constant(flags.type, None))


def in_each(builder: Any, mask: Any, do: Callable[[int], None]) -> None:
    """Do something for each lane of a mask. Most often all are set, which takes a single branch."""
    every = builder.icmp_unsigned("==", builder.bitcast(mask, BYTE), BYTE(2**WIDTH - 1))
    with builder.if_else(every, likely=True) as (in_all, in_some):
        with in_all:
            for k in range(WIDTH):
                do(k)
        with in_some:
            for k in range(WIDTH):
                with builder.if_then(builder.extract_element(mask, INDEX(k))):
                    do(k)


def shuffled(builder: Any, a: Any, b: Any, lanes: Sequence[int]) -> Any:
    """Return the vector of some lanes of two vectors; those of the second are numbered from `WIDTH` on."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INDEX, WIDTH), list(lanes)))


def computed_if(builder: Any, condition: Any, then: Callable[[], Lanes], otherwise: Lanes) -> Lanes:
    """Return lanes that are computed only if a condition holds."""
    before = builder.block
    with builder.if_then(condition):
        value = then().value
        computed = builder.block
    joined = builder.phi(VECTOR)
    joined.add_incoming(value, computed)
    joined.add_incoming(otherwise.value, before)
    return Lanes(builder, joined)
