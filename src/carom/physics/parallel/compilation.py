"""What lets Numba compile a kernel in less time, to the same machine code."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.compiler import Flags


def hasten(kernel: Any) -> None:
    """Let a kernel be compiled in less time."""
    compiler = kernel._compiler
    compile_kernel = compiler.compile

    def compile_quickly(args: Any, return_type: Any) -> Any:
        with _uncollected():
            return compile_kernel(args, return_type)

    compiler.compile = compile_quickly
    compiler._customize_flags = QuickFlags  # the hook for changes of the options


class QuickFlags(Flags):
    """Options of a compilation that are quick to compare.

    Numba compares options whenever a kernel calls one of Numba's own functions, such as ``max``. It asks for each of
    some 40 options by its name, which takes a sixth of the time of a compilation.
    """

    __slots__ = ()

    def values(self) -> dict[str, Any]:
        """Return the value of each option."""
        values: dict[str, Any] = _DEFAULTS | self._values
        return values

    def __hash__(self) -> int:
        return _HASH


_plain: Any = Flags  # without types, like all of Numba's inside
_DEFAULTS: dict[str, Any] = _plain().values()
_HASH = hash(_plain())  # Numba's options have one hash, whatever their values are


@contextmanager
def _uncollected() -> Iterator[None]:
    """Keep the garbage collector from looking through all that a compilation allocates, an eighth of its time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
