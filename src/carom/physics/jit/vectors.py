"""Code for vectors of eight float64 numbers, for instructions that are written operation by operation.

A loop over lanes that the compiler vectorises keeps its sums in memory, and a long one compiles slowly. With `Vectors`
an instruction states each operation on eight lanes, and the compiler splits it on processors with shorter registers.
Lanes never mix, and nothing is fused or reassociated: the bits are the same on any processor.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils

LANES = 8  # float64 numbers of a vector

_NUMBER, _WORD, _INDEX = ir.DoubleType(), ir.IntType(32), ir.IntType(64)
_VECTOR = ir.VectorType(_NUMBER, LANES)
_ANY = ir.Constant(_VECTOR, ir.Undefined)


class Vectors:
    """Adds operations on vectors to the code of an instruction; addresses are those of float64 numbers."""

    def __init__(self, builder: Any) -> None:
        self._builder = builder
        self.add, self.subtract = builder.fadd, builder.fsub
        self.multiply, self.divide = builder.fmul, builder.fdiv

    def constant(self, value: float) -> Any:
        """Return a vector of equal numbers that are known to the compiler."""
        return ir.Constant(_VECTOR, [float(value)] * LANES)

    def splat(self, number: Any) -> Any:
        """Return a vector of equal numbers."""
        first = self._builder.insert_element(_ANY, number, _WORD(0))
        return self._builder.shuffle_vector(first, _ANY, ir.Constant(ir.VectorType(_WORD, LANES), [0] * LANES))

    def number(self, address: Any, index: Any = 0) -> Any:
        """Load one number."""
        return self._builder.load(self._at(address, index))

    def load(self, address: Any, index: Any = 0) -> Any:
        """Load eight numbers, which need not be aligned."""
        return self._builder.load(self._vector_at(address, index), align=8)

    def store(self, vector: Any, address: Any, index: Any = 0) -> None:
        """Store eight numbers."""
        self._builder.store(vector, self._vector_at(address, index), align=8)

    def square_root(self, vector: Any) -> Any:
        """Return the square root, rounded correctly as IEEE requires."""
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        module: Any = self._builder.module
        root = cgutils.get_or_insert_function(module, kind, f"llvm.sqrt.v{LANES}f64")  # type: ignore[no-untyped-call]
        return self._builder.call(root, [vector])

    def zero_unless_positive(self, tested: Any, vector: Any) -> Any:
        """Return the lanes of a vector where ``tested`` is positive, and 0 elsewhere."""
        zero = self.constant(0.0)
        return self._builder.select(self._builder.fcmp_ordered(">", tested, zero), vector, zero)

    def variable(self, vector: Any) -> Any:
        """Return a variable with a first value, for sums in a loop."""
        place = cgutils.alloca_once(self._builder, _VECTOR)  # type: ignore[no-untyped-call]
        self._builder.store(vector, place)
        return place

    def value(self, variable: Any) -> Any:
        """Return the value of a variable."""
        return self._builder.load(variable)

    def increase(self, variable: Any, vector: Any) -> None:
        """Add to a variable."""
        self._builder.store(self.add(self._builder.load(variable), vector), variable)

    def transpose(self, rows: list[Any]) -> list[Any]:
        """Return the columns of eight vectors."""
        for step in (1, 2, 4):
            swapped = list(rows)
            for upper in range(LANES):
                if not upper & step:
                    lower = upper | step
                    pair = rows[upper], rows[lower]
                    swapped[upper] = self._picked(*pair, [k ^ step | LANES if k & step else k for k in range(LANES)])
                    swapped[lower] = self._picked(*pair, [k | LANES if k & step else k | step for k in range(LANES)])
            rows = swapped
        return rows

    def _picked(self, first: Any, second: Any, places: list[int]) -> Any:
        mask = ir.Constant(ir.VectorType(_WORD, LANES), places)
        return self._builder.shuffle_vector(first, second, mask)

    def _at(self, address: Any, index: Any) -> Any:
        return self._builder.gep(address, [_INDEX(index) if isinstance(index, int) else index])

    def _vector_at(self, address: Any, index: Any) -> Any:
        return self._builder.bitcast(self._at(address, index), _VECTOR.as_pointer())
