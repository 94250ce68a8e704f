"""Lanes: the same arithmetic on several records at once, in the vector registers of the processor.

`Lanes` is a value of a code generator (see `parallel.intrinsics`): one double for each of `WIDTH` records. Its
operators emit strict IEEE arithmetic, so each lane has the bits that a loop over the records would give it. Processors
with narrower registers take two or four instructions for each operation, with the same bits. A mask has a bit for each
lane.

Records are read and written as whole cache lines, which are transposed in registers. A transposition takes as long as
24 multiplications, so what several lines gain is transposed once, and added to them in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir

WIDTH = 8  # doubles in a cache line
HALF = WIDTH // 2
DOUBLE, WORD, BIT, BYTE, INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(1), ir.IntType(8), ir.IntType(32)
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
        return self.builder.extract_element(self.value, INDEX(k))

    def largest(self) -> Any:
        """Return the largest double of all lanes, none of which may be NaN."""
        lanes = self
        for apart in (4, 2, 1):
            order = [(k + apart) % WIDTH for k in range(WIDTH)]
            lanes = greater(lanes, Lanes(self.builder, _shuffled(self.builder, lanes.value, lanes.value, order)))
        return lanes.lane(0)

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


def read_line(builder: Any, addresses: Sequence[Any], line: int) -> list[Lanes]:
    """Read a cache line of `WIDTH` records; return its eight fields, each with a lane per record."""
    vectors = []
    for part in range(2):  # halves of two lines make a vector, which saves a step of the transposition
        halves = [builder.load(_half_of(builder, address, line, part), align=LINE // 2) for address in addresses]
        pairs = zip(halves[:HALF], halves[HALF:], strict=True)
        vectors += [_shuffled(builder, *pair, range(WIDTH)) for pair in pairs]
    return [Lanes(builder, column) for column in _exchanged(builder, vectors, (1, 2))]


def write_line(builder: Any, addresses: Sequence[Any], line: int, fields: Sequence[Lanes], mask: Any) -> None:
    """Write eight fields to a cache line of the records in a mask."""
    rows = _rows_of(builder, fields)

    def write(k: int) -> None:
        builder.store(rows[k], _line_of(builder, addresses[k], line), align=LINE)

    _in_lanes(builder, mask, write)


def add_to_lines(builder: Any, addresses: Sequence[Any], count: int, fields: Sequence[Lanes], mask: Any) -> None:
    """Add eight fields to each of the first cache lines of the records in a mask."""
    rows = _rows_of(builder, fields)

    def add(k: int) -> None:
        for line in range(count):
            place = _line_of(builder, addresses[k], line)
            builder.store(builder.fadd(builder.load(place, align=LINE), rows[k]), place, align=LINE)

    _in_lanes(builder, mask, add)


def _in_lanes(builder: Any, mask: Any, do: Callable[[int], None]) -> None:
    """Do something in each lane of a mask. In most blocks it has all lanes, which takes a single branch."""
    every = builder.icmp_unsigned("==", builder.bitcast(mask, BYTE), BYTE(2**WIDTH - 1))
    with builder.if_else(every, likely=True) as (in_all, in_some):
        with in_all:
            for k in range(WIDTH):
                do(k)
        with in_some:
            for k in range(WIDTH):
                with builder.if_then(builder.extract_element(mask, INDEX(k))):
                    do(k)


def _line_of(builder: Any, address: Any, line: int) -> Any:
    return _at(builder, address, line * LINE, VECTOR)


def _half_of(builder: Any, address: Any, line: int, part: int) -> Any:
    return _at(builder, address, line * LINE + part * LINE // 2, ir.VectorType(DOUBLE, HALF))


def _at(builder: Any, address: Any, offset: int, kind: Any) -> Any:
    """Return the address of a value some bytes after another address."""
    moved = builder.gep(builder.bitcast(address, BYTE.as_pointer()), [WORD(offset)])
    return builder.bitcast(moved, kind.as_pointer())


def _rows_of(builder: Any, fields: Sequence[Lanes]) -> list[Any]:
    """Return the cache lines of records with these fields."""
    return _exchanged(builder, [field.value for field in fields], (1, 2, 4))


def _exchanged(builder: Any, vectors: list[Any], steps: Sequence[int]) -> list[Any]:
    """Exchange single lanes, pairs or halves of eight vectors; all three steps transpose them."""
    for step in steps:
        firsts = [k - k % (2 * step) + k % step + (WIDTH if k % (2 * step) >= step else 0) for k in range(WIDTH)]
        exchanged = list(vectors)
        for k in range(WIDTH):
            if k % (2 * step) < step:
                both = vectors[k], vectors[k + step]
                exchanged[k] = _shuffled(builder, *both, firsts)
                exchanged[k + step] = _shuffled(builder, *both, [lane + step for lane in firsts])
        vectors = exchanged
    return vectors


def _shuffled(builder: Any, a: Any, b: Any, lanes: Sequence[int]) -> Any:
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
