"""What lets Numba compile a kernel in less time, to the same machine code."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from weakref import WeakKeyDictionary

from numba.core.compiler import Flags
from numba.core.targetconfig import ConfigStack
from numba.core.types import BaseFunction


def hasten(kernel: Any) -> None:
    """Let a kernel be compiled in less time."""
    _remember_signatures()
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


def _remember_signatures() -> None:
    """Let Numba find the types of an operation, such as the sum of two floats, once and not at each place in the code.

    The search takes an eighth of the time of a compilation. Failed searches, and those for kernels of other packages,
    are repeated. Kernels with and without reference counts are remembered apart: neither may call code of the other.
    """
    search: Any = BaseFunction.get_call_type
    if search in _searches:
        return

    def get_call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
        options = _option_stack.top_or_none()
        if kws or not isinstance(options, QuickFlags):
            return search(function, context, args, kws)
        known = _signatures.setdefault(function, {})
        asked = (args, options.nrt)
        if asked not in known:
            known[asked] = search(function, context, args, kws)
        return known[asked]

    _searches.add(get_call_type)
    changed: Any = BaseFunction
    changed.get_call_type = get_call_type


_make_stack: Any = ConfigStack  # without types, too
_option_stack = _make_stack()
_signatures: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()
_searches: set[Any] = set()  # ours, once it is in place
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
