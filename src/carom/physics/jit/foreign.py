"""Functions of installed packages in carom's kernels: chosen by the types of arguments, when a kernel is compiled.

A record that is handed to kernels carries in its type which functions belong to it: the name of its first field has
`identity_of` them. A kernel is thus compiled once for each set of functions, with them in it, and `KernelCache` keeps
each under its types. Kernels without such functions are as if there were none.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import xxhash
from numba import extending

from carom.physics.jit.sources import sources_of

Function = TypeVar("Function", bound=Callable[..., Any])


def leaf(function: Function) -> Function:
    """Compile a function into the kernels that call it; it is not kept on disk by itself."""
    compile_as: Any = numba.njit
    return cast("Function", compile_as(error_model="numpy", inline="always")(function))


def chosen_by_type(stub: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Let kernels that call a function compile what the decorated function returns for the types of its arguments."""
    overload: Any = extending.overload
    decorated: Callable[[Callable[..., Any]], Callable[..., Any]] = overload(
        stub, jit_options={"error_model": "numpy"}, strict=False
    )
    return decorated


def identity_of(*functions: Callable[..., Any]) -> str:
    """Return a text that changes with the sources of functions, to stand in the name of a type.

    A function within another one, or whose sources cannot be read, depends on more than its text. Its address is then
    part of the name, so that `KernelCache` keeps no kernel with it.
    """
    whole = xxhash.xxh3_64()
    for function in functions:
        code = function.__code__
        whole.update(f"{function.__module__} {function.__qualname__} {code.co_firstlineno}".encode())
        try:
            whole.update(sources_of(function.__module__, Path(code.co_filename)))
        except (OSError, UnicodeDecodeError):
            return f"{function.__qualname__} at 0x{id(function):x}"
        if function.__closure__:
            return f"{function.__qualname__} at 0x{id(function):x}"
    return whole.hexdigest()
