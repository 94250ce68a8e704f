"""Shared code of the modules that add processor instructions to Numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def instruction(define: Callable[..., Any]) -> Any:
    """Make a function for kernels from its code generator; Numba supplies the first argument."""
    return intrinsic(define)


def element_address(context: Any, builder: Any, signature: Any, array: Any, indices: Any) -> Any:
    """Return the address of an element of an array, the first argument of an instruction."""
    return address_in(context, builder, signature.args[0], array, indices)


def address_in(context: Any, builder: Any, kind: Any, array: Any, indices: Any) -> Any:
    """Return the address of an element of an array of a kind."""
    view = context.make_array(kind)(context, builder, array)
    return cgutils.get_item_pointer(context, builder, kind, view, list(indices))  # type: ignore[no-untyped-call]


@instruction
def lowest_bit(typing: Any, word: Any) -> Any:
    """Return the position of the lowest set bit of a uint64, or 64 if there is none."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.IntType(1)(0))

    return types.int64(types.uint64), generate


def pointer_to(kind: Any) -> Any:
    """Make a function for kernels that turns an address, an int64, into a pointer to values of a type, for `carray`."""
    pointer: Any = types.CPointer(kind)  # type: ignore[no-untyped-call]

    def point(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], context.get_value_type(pointer))

        return pointer(types.int64), generate

    return instruction(point)
