"""Atomic words in memory, for threads that share work inside kernels."""

from __future__ import annotations

from typing import Any

from numba import types

from carom.physics.jit.intrinsics import element_address, instruction


@instruction
def atomic_load(typing: Any, words: Any, word: Any) -> Any:
    """Return a word of an (n,) int64 array; all writes before it are then visible."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load_atomic(element_address(context, builder, signature, args[0], args[1:]), "seq_cst", 8)

    return types.int64(words, types.intp), generate


@instruction
def atomic_store(typing: Any, words: Any, word: Any, value: Any) -> Any:
    """Write a word of an (n,) int64 array after all earlier writes."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store_atomic(args[2], element_address(context, builder, signature, args[0], args[1:2]), "seq_cst", 8)
        return context.get_dummy_value()

    return types.void(words, types.intp, types.int64), generate


@instruction
def atomic_add(typing: Any, words: Any, word: Any, value: Any) -> Any:
    """Add to a word of an (n,) array of integers and return what it was before."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = element_address(context, builder, signature, args[0], args[1:2])
        return builder.atomic_rmw("add", address, args[2], "seq_cst")

    return words.dtype(words, types.intp, words.dtype), generate


@instruction
def atomic_max(typing: Any, words: Any, word: Any, value: Any) -> Any:
    """Raise a word of an (n,) int64 array to a value, if it is below."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.atomic_rmw("max", element_address(context, builder, signature, args[0], args[1:2]), args[2], "seq_cst")
        return context.get_dummy_value()

    return types.void(words, types.intp, types.int64), generate


@instruction
def atomic_replace(typing: Any, words: Any, word: Any, expected: Any, value: Any) -> Any:
    """Write a word of an (n,) int64 array if it is as expected; tell whether it was."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = element_address(context, builder, signature, args[0], args[1:2])
        return builder.extract_value(builder.cmpxchg(address, args[2], args[3], "seq_cst", "seq_cst"), 1)

    return types.boolean(words, types.intp, types.int64, types.int64), generate
