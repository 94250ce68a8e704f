"""Instructions of the processor that Numba does not offer: what the modules that add them share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def instruction(define: Callable[..., Any]) -> Any:
    """Make a function for kernels out of what generates its code; Numba fills in the first argument."""
    return intrinsic(define)


def element_address(context: Any, builder: Any, signature: Any, array: Any, indices: Any) -> Any:
    """Return the address of an element of an array."""
    kind = signature.args[0]
    view = context.make_array(kind)(context, builder, array)
    return cgutils.get_item_pointer(context, builder, kind, view, list(indices))  # type: ignore[no-untyped-call]


@instruction
def lowest_bit(typing: Any, word: Any) -> Any:
    """Return which bit of a uint64 is the lowest that is set, or 64 if none is."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.IntType(1)(0))

    return types.int64(types.uint64), generate
