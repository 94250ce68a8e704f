"""Decorators that compile kernels: strict IEEE arithmetic, cached on disk.

No ``fastmath``: reassociated or fused arithmetic would make the bits depend on the processor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.core import event

from carom.physics.jit import kernel_cache
from carom.physics.jit.compilation import hasten

Function = TypeVar("Function", bound=Callable[..., Any])

_OWNS = 4  # NumPy's flag of an array that owns its memory; Numba's types do not depend on it
_entries: dict[tuple[Callable[..., Any], Any], Callable[..., Any]] = {}


def kernel(function: Function) -> Function:
    """Compile a short function on its first call, or load it from the cache. It keeps the interpreter's lock.

    Releasing the lock for microseconds does not pay: the recorder takes it, and the physics waits. (When all kernels
    released it, recording every step of 1000 bodies cost 19 % instead of 11 %.)
    """
    return _compiled(function)


def long_kernel(function: Function) -> Function:
    """Compile a function that runs for tens of microseconds or more; it releases the interpreter's lock."""
    return _compiled(function, nogil=True)


def inner(function: Function) -> Function:
    """Compile a function that only kernels call, without the wrapper that Python would need.

    With many array arguments that wrapper takes most of the compilation. A call from Python would crash.
    """
    return _compiled(function, no_cpython_wrapper=True)


def unowned(function: Function) -> Function:
    """Compile a function like `inner` that neither makes nor keeps arrays, without counting references to them.

    Kernels that it calls make no arrays either: Numba compiles them without counts, too, if they are not compiled yet.
    The counts are atomic. In a short function that hands on arrays of a tuple they take most of the time.
    """
    return _compiled(function, no_cpython_wrapper=True, _nrt=False)


def borrowing(function: Function) -> Function:
    """Compile a function like `unowned` that Python calls, too. It releases the interpreter's lock.

    Without the counts it is called faster and compiled in less time.
    """
    return _compiled(function, nogil=True, _nrt=False)


def inline(function: Function) -> Function:
    """Inline a small function into the kernels that call it."""
    return _compiled(function, nogil=True, inline="always")


def _compiled(function: Function, **options: Any) -> Function:
    """Compile for Python and other kernels, not for C; once for all literal arguments."""
    compile_as: Any = numba.njit  # its stub lacks some options
    compiled = compile_as(error_model="numpy", no_cfunc_wrapper=True, **options)(function)
    hasten(compiled)
    kept = kernel_cache.cache_of(function)
    if kept is not None:
        compiled._cache = kept
    template_for = compiled.get_call_template

    def get_call_template(args: Sequence[Any], kws: dict[str, Any]) -> Any:
        """Find or compile a called kernel; Numba would compile it anew for each literal argument."""
        unliteral: Any = types.unliteral
        return template_for([unliteral(arg) for arg in args], kws)

    compiled.get_call_template = get_call_template
    return cast("Function", compiled)


def compile_for(function: Callable[..., Any], *arguments: Any) -> None:
    """Compile a kernel for the types of these arguments, or load it, without calling it."""
    compiled: Any = function
    kind_of: Any = numba.typeof
    compiled.compile(tuple(kind_of(argument) for argument in arguments))


def entry_of(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """Compile a kernel for the types of these arguments, or load it; return it as a function of such arguments only.

    Numba looks up the types of all arguments at each call: 3 to 5 µs for a tuple of 25 arrays. A call of the entry
    takes 0.5 µs, or 2 µs if it counts references. It misreads arguments of other types, so it is only for arrays whose
    types its owner sets.
    """
    asked = function, layout_of(arguments)
    if asked not in _entries:
        kind_of: Any = numba.typeof
        compile_for(function, *arguments)
        kernel: Any = function
        _entries[asked] = kernel.overloads[tuple(kind_of(argument) for argument in arguments)].entry_point
    return _entries[asked]


def layout_of(argument: Any) -> Any:
    """Return what Numba's type of an argument follows from, in 1 % of the time that `numba.typeof` takes."""
    if isinstance(argument, np.ndarray):
        return argument.dtype, argument.ndim, argument.flags.num & ~_OWNS
    if isinstance(argument, tuple):
        return type(argument), *map(layout_of, argument)
    return type(argument)


def cache_folder() -> str:
    """Return the folder of the compiled kernels of this package; empty if none is writable."""
    return str(kernel_cache.cache_folder(Path(__file__).parents[1]) or "")


class Compilations(event.Listener):
    """Counts the kernels that are compiled while it is active; kernels from the cache do not count."""

    def __init__(self) -> None:
        self.count = 0

    def __enter__(self) -> Compilations:
        event.register("numba:compile", self)  # type: ignore[no-untyped-call]
        return self

    def __exit__(self, *error: object) -> None:
        event.unregister("numba:compile", self)  # type: ignore[no-untyped-call]

    def on_start(self, event: object) -> None:
        """Count one."""
        self.count += 1

    def on_end(self, event: object) -> None:
        """Do nothing; Numba requires this method."""


class _FirstCompilation(event.Listener):
    """Calls back once, when the first kernel that is not in the cache is compiled."""

    def __init__(self, callback: Callable[[], None]) -> None:
        self._callback: Callable[[], None] | None = callback

    def on_start(self, event: object) -> None:
        callback, self._callback = self._callback, None
        if callback:
            callback()

    def on_end(self, event: object) -> None:
        pass


def on_compilation(callback: Callable[[], None]) -> None:
    """Call back once, before the first kernel is compiled; never if all are in the cache."""
    event.register("numba:compile", _FirstCompilation(callback))  # type: ignore[no-untyped-call]
