"""Instructions: functions of kernels written as LLVM code, each with a plain form.

- *Atomic words* let threads share work inside kernels: pieces of a phase, cells of a grid, branches of a tree. Without
  such words, one thread does all the work; two threads gain a factor of 1.5 to 1.9 (docs/performance.md).
- *Prefetching*. The two bodies of a contact may be anywhere in memory, and the processor cannot predict the bodies of
  the next contacts. If bodies are prefetched sixteen contacts ahead, they arrive in time: with 10⁵ bodies in random
  order, a contact costs 40 ns per iteration instead of 150 ns, as little as in the order of a lattice. Rejected:
  sorting the bodies along a space-filling curve, which gains nothing more.
- `from_front`. Numba's indices may count from the end, as in Python, so each access tests the sign of its index unless
  the compiler knows that it is not negative. With `from_front`, phases of the solver take 8 to 13 % less time. This
  function is its own plain form.
- `lowest_bit` finds a free colour in a set of 64, with one instruction instead of a loop.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from carom.arrays import Records
from carom.physics.aligned import CACHE_LINE
from carom.physics.jit.decorators import inline
from carom.physics.jit.inside import PLAIN, cgutils, extending, ir, types

# number of contacts by which bodies are prefetched ahead; with 8, a contact costs the same if the bodies fit into the
# cache, otherwise 45 ns instead of 38 ns
AHEAD = 16
LARGEST = 2**63 - 1
WORD = ir.IntType(64)


class Code:
    """The code of one instruction in a kernel: Numba's objects, and the type and value of each argument by name."""

    def __init__(self, context: Any, builder: Any, kinds: dict[str, Any], values: dict[str, Any]) -> None:
        self.context, self.builder = context, builder
        self.kinds, self.values = kinds, values

    def element(self, name: str, *indices: Any) -> Any:
        """Return the address of an element of an array argument."""
        return self.element_of(self.kinds[name], self.values[name], *indices)

    def element_of(self, kind: Any, array: Any, *indices: Any) -> Any:
        """Return the address of an element of an array, given the array's type."""
        places = [WORD(index) if isinstance(index, int) else index for index in indices]
        view = self.context.make_array(kind)(self.context, self.builder, array)
        return cgutils.get_item_pointer(self.context, self.builder, kind, view, places)

    def length_of(self, kind: Any, array: Any) -> Any:
        """Return the number of rows of an array, given the array's type."""
        return self.builder.extract_value(self.context.make_array(kind)(self.context, self.builder, array).shape, 0)

    def load(self, address: Any, offset: int = 0) -> Any:
        """Load the value at an address, or ``offset`` values after it."""
        return self.builder.load(self.builder.gep(address, [WORD(offset)]) if offset else address)

    def variable(self, value: Any) -> Any:
        """Return the address of a new variable."""
        return cgutils.alloca_once_value(self.builder, value)

    def loop(self, begin: Any, end: Any) -> Any:
        """Return a context whose code is repeated; it yields the index and an unused value."""
        return cgutils.for_range_slice(self.builder, begin, end, WORD(1))

    def call(self, function: Callable[..., Any], returns: str | tuple[str, ...], *given: tuple[Any, Any]) -> Any:
        """Call a plain Python function or a kernel, compiled here; each argument is a type and a value."""
        function = getattr(function, "py_func", function)  # a kernel has its plain function
        kinds, values = zip(*given, strict=True)
        signature = _type_of(returns, {})(*(_type_of(kind, {}) for kind in kinds))
        return self.context.compile_internal(self.builder, function, signature, values)


def instruction(
    plain: Callable[..., Any],
    *,
    returns: str | tuple[str, ...] | Callable[[dict[str, Any]], Any] = "none",
    **kinds: str,
) -> Callable[[Callable[..., Any]], Any]:
    """Make an instruction from a function that generates its code, given a `Code` and the arguments.

    ``plain`` is a kernel with the same bits. Types of the result and of arguments have names such as ``"float64"``, or
    ``"words.dtype"`` for the elements of an array. Other arguments keep their types. The type of the result may be a
    function of the types of the arguments.
    """

    def add(generate: Callable[..., Any]) -> Any:
        if PLAIN:
            return plain
        own = list(inspect.signature(generate).parameters.values())[1:]

        def define(typing: Any, *given: Any) -> Any:
            known = {parameter.name: kind for parameter, kind in zip(own, given, strict=True)}
            taken = [_type_of(kinds[name], known) if name in kinds else kind for name, kind in known.items()]

            def emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
                values = dict(zip(known, args, strict=True))
                made = generate(Code(context, builder, dict(zip(known, signature.args, strict=True)), values), *args)
                if returns == "none":
                    return context.get_dummy_value()
                return context.make_tuple(builder, signature.return_type, made) if isinstance(returns, tuple) else made

            return (returns(known) if callable(returns) else _type_of(returns, known))(*taken), emit

        first = inspect.Parameter("typing", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        described: Any = define
        described.__name__, described.__doc__ = generate.__name__, generate.__doc__
        described.__signature__ = inspect.Signature([first, *own])
        return extending.intrinsic(define)

    return add


def _type_of(kind: Any, known: dict[str, Any]) -> Any:
    """Return Numba's type for a name or a tuple of equal names; a type is returned as it is."""
    if isinstance(kind, tuple):
        return types.UniTuple(_type_of(kind[0], known), len(kind))
    if not isinstance(kind, str):
        return kind
    name, _, member = kind.partition(".")
    return known[name].dtype if member else getattr(types, name)


@inline
def from_front(index: int) -> int:
    """Return an index that is not negative, and tell the compiler so: its sign bit is cleared."""
    return index & LARGEST


@inline
def _load(words: Any, word: int) -> Any:
    return words[word]


@inline
def _store(words: Any, word: int, value: int) -> None:
    words[word] = value


@inline
def _add(words: Any, word: int, value: int) -> Any:
    before = words[word]
    words[word] += words.dtype.type(value)
    return before


@inline
def _raise(words: Any, word: int, value: int) -> None:
    words[word] = max(words[word], value)


@inline
def _replace(words: Any, word: int, expected: int, value: int) -> bool:
    if words[word] != expected:
        return False
    words[word] = value
    return True


@instruction(_load, returns="int64", word="intp")
def atomic_load(code: Code, words: Any, word: Any) -> Any:
    """Return a word of an (n,) int64 array; all writes that preceded the write of this word are then visible."""
    return code.builder.load_atomic(code.element("words", word), "seq_cst", 8)


@instruction(_store, word="intp", value="int64")
def atomic_store(code: Code, words: Any, word: Any, value: Any) -> None:
    """Write a word of an (n,) int64 array after all earlier writes."""
    code.builder.store_atomic(value, code.element("words", word), "seq_cst", 8)


@instruction(_add, returns="words.dtype", word="intp", value="words.dtype")
def atomic_add(code: Code, words: Any, word: Any, value: Any) -> Any:
    """Add to a word of an (n,) array of integers and return its previous value."""
    return code.builder.atomic_rmw("add", code.element("words", word), value, "seq_cst")


@instruction(_raise, word="intp", value="int64")
def atomic_max(code: Code, words: Any, word: Any, value: Any) -> None:
    """Raise a word of an (n,) int64 array to a value if it is lower."""
    code.builder.atomic_rmw("max", code.element("words", word), value, "seq_cst")


@instruction(_replace, returns="boolean", word="intp", expected="int64", value="int64")
def atomic_replace(code: Code, words: Any, word: Any, expected: Any, value: Any) -> Any:
    """Write a word of an (n,) int64 array if it has the expected value; return whether it had."""
    replaced = code.builder.cmpxchg(code.element("words", word), expected, value, "seq_cst", "seq_cst")
    return code.builder.extract_value(replaced, 1)


@inline
def _lowest(word: Any) -> int:
    bit = 0
    while bit < 64 and not (word >> np.uint64(bit)) & np.uint64(1):
        bit += 1
    return bit


@instruction(_lowest, returns="int64", word="uint64")
def lowest_bit(code: Code, word: Any) -> Any:
    """Return the position of the lowest set bit of a uint64, or 64 if there is none."""
    return code.builder.cttz(word, ir.IntType(1)(0))


@inline
def _fetch_none(rows: Any, row: int, column: int) -> None:
    pass


@inline
def _fetch_no_record(records: Records, record: int) -> None:
    pass


@instruction(_fetch_none, row="intp", column="intp")
def prefetch(code: Code, rows: Any, row: Any, column: Any) -> None:
    """Prefetch the cache line of an element of a (k, l) array, to be written."""
    fetch_line(code.builder, code.element("rows", row, column), 0, to_write=True)


@instruction(_fetch_no_record, record="intp")
def prefetch_to_read(code: Code, records: Any, record: Any) -> None:
    """Prefetch the first cache line of a record in a (k,) array, to be read; other cores keep their copies."""
    fetch_line(code.builder, code.element("records", record), 0, to_write=False)


@instruction(_fetch_none, record="intp", line="intp")
def prefetch_record(code: Code, records: Any, record: Any, line: Any) -> None:
    """Prefetch a cache line, 0 or 1, of a record in a (k,) array, to be written."""
    fetch_line(code.builder, code.element("records", record), line, to_write=True)


def fetch_line(builder: Any, address: Any, line: Any, *, to_write: bool) -> None:
    """Generate code to prefetch a cache line: ``line``, an int or a value in the code, counts from an address."""
    byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
    offset = WORD(line * CACHE_LINE) if isinstance(line, int) else builder.mul(line, line.type(CACHE_LINE))
    kind = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
    fetch = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
    near, data = word(3), word(1)
    builder.call(fetch, [builder.gep(builder.bitcast(address, byte), [offset]), word(int(to_write)), near, data])
