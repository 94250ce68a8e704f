"""Instructions of the processor that Numba has no words for: atomic words in memory, and fetching ahead.

A contact's two bodies lie anywhere in memory, and the processor cannot guess where the next ones do. Told sixteen
contacts ahead it has them in time: 10⁵ bodies of random numbering cost 40 instead of 150 ns a contact and sweep, as
little as bodies in the order of a lattice. To sort the bodies along a space-filling curve would gain nothing more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

AHEAD = 16  # contacts; 8 are as good in the cache, and cost 45 instead of 38 ns where the bodies do not fit into it


def instruction(define: Callable[..., Any]) -> Any:
    """Make a function for kernels out of what generates its code; Numba fills in the first argument."""
    return intrinsic(define)


@instruction
def atomic_load(typing: Any, words: Any, word: Any) -> Any:
    """Return a word of an (n,) int64 array, with all that was written before it was."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load_atomic(_address(context, builder, signature, args[0], args[1:]), "seq_cst", 8)

    return types.int64(words, types.intp), generate


@instruction
def atomic_store(typing: Any, words: Any, word: Any, value: Any) -> Any:
    """Write a word of an (n,) int64 array after all that was to be written before it."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store_atomic(args[2], _address(context, builder, signature, args[0], args[1:2]), "seq_cst", 8)
        return context.get_dummy_value()

    return types.void(words, types.intp, types.int64), generate


@instruction
def atomic_add(typing: Any, words: Any, word: Any, value: Any) -> Any:
    """Add to a word of an (n,) array of integers and return what it was before."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature, args[0], args[1:2])
        return builder.atomic_rmw("add", address, args[2], "seq_cst")

    return words.dtype(words, types.intp, words.dtype), generate


@instruction
def atomic_max(typing: Any, words: Any, word: Any, value: Any) -> Any:
    """Raise a word of an (n,) int64 array to a value, if it is below."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.atomic_rmw("max", _address(context, builder, signature, args[0], args[1:2]), args[2], "seq_cst")
        return context.get_dummy_value()

    return types.void(words, types.intp, types.int64), generate


@instruction
def atomic_replace(typing: Any, words: Any, word: Any, expected: Any, value: Any) -> Any:
    """Write a word of an (n,) int64 array if it is as expected; tell whether it was."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature, args[0], args[1:2])
        return builder.extract_value(builder.cmpxchg(address, args[2], args[3], "seq_cst", "seq_cst"), 1)

    return types.boolean(words, types.intp, types.int64, types.int64), generate


@instruction
def lowest_bit(typing: Any, word: Any) -> Any:
    """Return which bit of a uint64 is the lowest that is set, or 64 if none is."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.IntType(1)(0))

    return types.int64(types.uint64), generate


@instruction
def prefetch(typing: Any, rows: Any, row: Any, column: Any) -> Any:
    """Fetch the cache line of an element of a (k, l) array, which will be written to."""
    return types.void(rows, types.intp, types.intp), _fetch(to_write=True)


@instruction
def prefetch_to_read(typing: Any, rows: Any, row: Any, column: Any) -> Any:
    """Fetch the cache line of an element of a (k, l) array; other cores keep it, too."""
    return types.void(rows, types.intp, types.intp), _fetch(to_write=False)


def _fetch(*, to_write: bool) -> Callable[..., Any]:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature, args[0], args[1:])
        byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
        fetch = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        near, data = word(3), word(1)
        builder.call(fetch, [builder.bitcast(address, byte), word(int(to_write)), near, data])
        return context.get_dummy_value()

    return generate


def _address(context: Any, builder: Any, signature: Any, array: Any, indices: Any) -> Any:
    """Return the address of an element."""
    kind = signature.args[0]
    view = context.make_array(kind)(context, builder, array)
    return cgutils.get_item_pointer(context, builder, kind, view, list(indices))  # type: ignore[no-untyped-call]
