"""Lanes: the same arithmetic on several records at once, in the vector registers of the processor.

`Lanes` is a value of a code generator (see `parallel.intrinsics`): one double for each of `WIDTH` records, and `Mask`
one bit for each. Their operators emit strict IEEE arithmetic, so each lane has the bits that a loop over the records
would give it. Processors with narrower registers take two or four instructions for each operation, with the same bits.

Formulas are written once, for doubles: `in_lanes` makes the same Python code compute with lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from types import FunctionType
from typing import Any

from llvmlite import ir

from carom.physics.jit.decorators import inline

WIDTH = 8  # doubles in a cache line
DOUBLE, WORD, BIT, BYTE, INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(1), ir.IntType(8), ir.IntType(32)
NOTHING = DOUBLE(-0.0)  # adding it keeps all bits, those of -0.0, too
VECTOR, MASK = ir.VectorType(DOUBLE, WIDTH), ir.VectorType(BIT, WIDTH)


class Mask:
    """One bit per lane."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def __and__(self, other: Mask) -> Mask:
        return Mask(self.builder, self.builder.and_(self.value, other.value))

    def __or__(self, other: Mask) -> Mask:
        return Mask(self.builder, self.builder.or_(self.value, other.value))

    def __invert__(self) -> Mask:
        return Mask(self.builder, self.builder.not_(self.value))

    def __bool__(self) -> bool:
        raise TypeError("lanes take no branches: use `where`")

    @property
    def any(self) -> Any:
        """A bit: whether a lane is set."""
        return self.builder.icmp_unsigned("!=", self.builder.bitcast(self.value, BYTE), BYTE(0))

    def bit(self, k: int) -> Any:
        """Return the bit of a lane."""
        return self.builder.extract_element(self.value, INDEX(k))

    def in_each(self, do: Callable[[int], None]) -> None:
        """Do something for each lane that is set. Most often all are, which takes a single branch."""
        builder = self.builder
        every = builder.icmp_unsigned("==", builder.bitcast(self.value, BYTE), BYTE(2**WIDTH - 1))
        with builder.if_else(every, likely=True) as (in_all, in_some):
            with in_all:
                for k in range(WIDTH):
                    do(k)
            with in_some:
                for k in range(WIDTH):
                    with builder.if_then(self.bit(k)):
                        do(k)


class Lanes:
    """One double per lane. An operand may be a number, which all lanes share."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def __add__(self, other: Lanes | float) -> Lanes:
        return self._joined("fadd", other)

    def __sub__(self, other: Lanes | float) -> Lanes:
        return self._joined("fsub", other)

    def __mul__(self, other: Lanes | float) -> Lanes:
        return self._joined("fmul", other)

    def __truediv__(self, other: Lanes | float) -> Lanes:
        return self._joined("fdiv", other)

    def __radd__(self, number: float) -> Lanes:
        return self._alike(number) + self

    def __rmul__(self, number: float) -> Lanes:
        return self._alike(number) * self

    def __rtruediv__(self, number: float) -> Lanes:
        return self._alike(number) / self

    def __neg__(self) -> Lanes:
        return Lanes(self.builder, self.builder.fneg(self.value))

    def __abs__(self) -> Lanes:
        return self._apply("llvm.fabs")

    def __gt__(self, other: Lanes | float) -> Mask:  # NaN is not greater, nor is anything greater than NaN
        return Mask(self.builder, self.builder.fcmp_ordered(">", self.value, self._alike(other).value))

    def __lt__(self, other: Lanes | float) -> Mask:
        return Mask(self.builder, self.builder.fcmp_ordered("<", self.value, self._alike(other).value))

    def __bool__(self) -> bool:
        raise TypeError("lanes take no branches: use `where`")

    def sqrt(self) -> Lanes:
        """Return the square roots; `numpy.sqrt` calls this."""
        return self._apply("llvm.sqrt")

    def where(self, mask: Mask, other: Lanes | float) -> Lanes:
        """Return these lanes where a mask is set, and the other's elsewhere."""
        return Lanes(self.builder, self.builder.select(mask.value, self.value, self._alike(other).value))

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

    def _joined(self, operation: str, other: Lanes | float) -> Lanes:
        return Lanes(self.builder, getattr(self.builder, operation)(self.value, self._alike(other).value))

    def _alike(self, other: Lanes | float) -> Lanes:
        return other if isinstance(other, Lanes) else spread(self.builder, DOUBLE(other))

    def _apply(self, name: str) -> Lanes:
        function = self.builder.module.declare_intrinsic(f"{name}.v{WIDTH}f64", (), ir.FunctionType(VECTOR, [VECTOR]))
        return Lanes(self.builder, self.builder.call(function, [self.value]))


@inline
def where(condition: bool, then: float, otherwise: float) -> float:
    """Return one of two doubles, for formulas of doubles and of lanes; both are computed."""
    return then if condition else otherwise


@cache
def in_lanes(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Return a formula of kernels as a function of lanes: its operators, and those of formulas in it, emit code.

    A formula has no branches that depend on its doubles, but `where`.
    """
    if formula is where:
        return _where
    plain: FunctionType = formula.py_func  # type: ignore[attr-defined]
    named = {name: plain.__globals__.get(name) for name in plain.__code__.co_names}
    called = {name: in_lanes(value) for name, value in named.items() if hasattr(value, "py_func")}
    return FunctionType(plain.__code__, plain.__globals__ | called)


def _where(condition: Mask, then: Lanes, otherwise: Lanes | float) -> Lanes:
    return then.where(condition, otherwise)


def greater(first: Lanes | float, second: Lanes) -> Lanes:
    """Return the larger, like ``max`` of doubles: the first where they are equal or not numbers."""
    return second.where(second > first, first)


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


def at_least(builder: Any, numbers: Sequence[Any], least: Any) -> Mask:
    """Return the lanes whose integers are no less than another one."""
    kind = ir.VectorType(WORD, WIDTH)
    vectors = (_collected(builder, kind, values) for values in (numbers, [least] * WIDTH))
    return Mask(builder, builder.icmp_signed(">=", *vectors))


def mask_of(builder: Any, bits: Sequence[Any]) -> Mask:
    """Return bits as a mask."""
    return Mask(builder, _collected(builder, MASK, bits))


def _collected(builder: Any, kind: Any, values: Sequence[Any]) -> Any:
    vector = ir.Constant(kind, ir.Undefined)
    for k, value in enumerate(values):
        vector = builder.insert_element(vector, value, INDEX(k))
    return vector


def read_doubles(builder: Any, address: Any) -> Lanes:
    """Read eight doubles of an array, from the one at an address on."""
    return Lanes(builder, builder.load(builder.bitcast(address, VECTOR.as_pointer()), align=8))


def read_flags(builder: Any, address: Any) -> Mask:
    """Read eight flags of an array, from the one at an address on."""
    flags = builder.load(builder.bitcast(address, ir.VectorType(BYTE, WIDTH).as_pointer()), align=1)
    return Mask(builder, builder.icmp_unsigned("!=", flags, ir.Constant(flags.type, None)))


def shuffled(builder: Any, a: Any, b: Any, lanes: Sequence[int]) -> Any:
    """Return the vector of some lanes of two vectors; those of the second are numbered from `WIDTH` on."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INDEX, WIDTH), list(lanes)))


def either(
    builder: Any, condition: Any, then: Callable[[], Sequence[Lanes]], otherwise: Callable[[], Sequence[Lanes]]
) -> list[Lanes]:
    """Return what one of two functions computes, by a condition that is the same for all lanes."""
    found = []
    with builder.if_else(condition) as (if_so, if_not):
        for branch, compute in ((if_so, then), (if_not, otherwise)):
            with branch:
                found.append((compute(), builder.block))
    joined = []
    for choices in zip(*(lanes for lanes, _ in found), strict=True):
        phi = builder.phi(VECTOR)
        for lanes, (_, block) in zip(choices, found, strict=True):
            phi.add_incoming(lanes.value, block)
        joined.append(Lanes(builder, phi))
    return joined
