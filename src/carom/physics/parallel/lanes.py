"""Lanes: the same arithmetic on several records at once, in the vector registers of the processor.

`Lanes` is a value of a code generator (see `parallel.intrinsics`): one double for each of `WIDTH` records. Its
operators emit strict IEEE arithmetic, so each lane has the bits that a loop over the records would give it. Processors
with narrower registers take two or four instructions for each operation, with the same bits.

Records are read and written as whole cache lines, which are transposed in registers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir

WIDTH = 8  # doubles in a cache line
DOUBLE, WORD, BIT = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
VECTOR, MASK = ir.VectorType(DOUBLE, WIDTH), ir.VectorType(BIT, WIDTH)
LINE = 64  # bytes


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
        return self.builder.extract_element(self.value, ir.Constant(ir.IntType(32), k))

    def _apply(self, name: str) -> Lanes:
        function = self.builder.module.declare_intrinsic(f"{name}.v{WIDTH}f64", (), ir.FunctionType(VECTOR, [VECTOR]))
        return Lanes(self.builder, self.builder.call(function, [self.value]))


def greater(first: Lanes, *others: Lanes) -> Lanes:
    """Return the largest, like ``max`` of doubles: the first where they are equal or not numbers."""
    for other in others:
        first = other.where(other.exceeds(first), first)
    return first


def spread(builder: Any, value: Any) -> Lanes:
    """Return a double in all lanes."""
    return gathered(builder, [value] * WIDTH)


def gathered(builder: Any, values: Sequence[Any]) -> Lanes:
    """Return doubles as lanes."""
    return Lanes(builder, _collect(builder, VECTOR, values))


def mask_of(builder: Any, bits: Sequence[Any]) -> Any:
    """Return bits as a mask."""
    return _collect(builder, MASK, bits)


def _collect(builder: Any, kind: Any, values: Sequence[Any]) -> Any:
    vector = ir.Constant(kind, ir.Undefined)
    for k, value in enumerate(values):
        vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), k))
    return vector


def read_line(builder: Any, addresses: Sequence[Any], line: int) -> list[Lanes]:
    """Read a cache line of `WIDTH` records; return its eight fields, each with a lane per record."""
    rows = [builder.load(_line_of(builder, address, line), align=LINE) for address in addresses]
    return [Lanes(builder, column) for column in _transposed(builder, rows)]


def write_line(builder: Any, addresses: Sequence[Any], line: int, fields: Sequence[Lanes], bits: Sequence[Any]) -> None:
    """Write eight fields to a cache line of the records whose bit is set."""
    rows = _transposed(builder, [field.value for field in fields])
    for address, row, bit in zip(addresses, rows, bits, strict=True):
        with builder.if_then(bit):
            builder.store(row, _line_of(builder, address, line), align=LINE)


def _line_of(builder: Any, address: Any, line: int) -> Any:
    bytes_ = builder.bitcast(address, ir.IntType(8).as_pointer())
    return builder.bitcast(builder.gep(bytes_, [ir.Constant(WORD, line * LINE)]), VECTOR.as_pointer())


def _transposed(builder: Any, rows: Sequence[Any]) -> list[Any]:
    """Transpose eight vectors in three steps that exchange single lanes, pairs and halves."""
    vectors = list(rows)
    for step in (1, 2, 4):
        firsts = [k - k % (2 * step) + k % step + (WIDTH if k % (2 * step) >= step else 0) for k in range(WIDTH)]
        upper = [ir.Constant(ir.IntType(32), lane) for lane in firsts]
        lower = [ir.Constant(ir.IntType(32), lane + step) for lane in firsts]
        exchanged = list(vectors)
        for k in range(WIDTH):
            if k % (2 * step) < step:
                a, b = vectors[k], vectors[k + step]
                exchanged[k] = _shuffle(builder, a, b, upper)
                exchanged[k + step] = _shuffle(builder, a, b, lower)
        vectors = exchanged
    return vectors


def _shuffle(builder: Any, a: Any, b: Any, lanes: Sequence[Any]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), list(lanes)))


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
