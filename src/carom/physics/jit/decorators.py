"""Decorators that compile kernels: strict IEEE arithmetic, cached on disk.

``fastmath`` is not used: reassociated or fused arithmetic would make the bits depend on the processor.

Plain kernels use only options that Numba documents. Other kernels do without atomic reference counts of arrays, and
without wrappers for Python, which take most of the compilation time of a kernel with many arrays.

Functions of installed packages are compiled into carom's kernels, selected by the types of arguments
(`chosen_by_type`). A record passed to kernels names its functions in its type: the name of its first field contains
their `identity_of`. A kernel is therefore compiled once for each set of functions, and `KernelCache` stores each
version under its types.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
import xxhash

from carom.physics.jit.cache import KernelCache, cache_of, folder_of, sources_of
from carom.physics.jit.inside import PLAIN, compiler, event, extending, types

Function = TypeVar("Function", bound=Callable[..., Any])

_OWNS = 4  # NumPy's flag of an array that owns its memory; Numba's types do not depend on this flag
_entries: dict[tuple[Callable[..., Any], Any], Callable[..., Any]] = {}
_compiles_all = False
_typeof: Any = numba.typeof  # the stub lacks the type of this function

# numbers of calls of a kernel, for `entry_if_worthwhile`; each call saves 0.17 ms
WORTH_COMPILING = 100_000  # saves 17 s, while compilation takes 5 s, or 13 s on a busy machine
WORTH_LOADING = 1_000  # saves 0.17 s, while loading takes 0.05 s, or 0.12 s on a busy machine


def kernel(function: Function) -> Function:
    """Compile a short function on its first call, or load it from the cache. The function holds the interpreter lock.

    Releasing the lock for microseconds does not pay: the recorder acquires it, and the physics waits. (When all kernels
    released it, recording every step of 1000 bodies cost 19 % instead of 11 %.)
    """
    return _compiled(function)


def long_kernel(function: Function) -> Function:
    """Compile a function that runs for tens of microseconds or more; it releases the interpreter lock.

    The function must neither create nor store arrays; see `inner`.
    """
    return _compiled(function, nogil=True, _nrt=False)


def long_kernel_with_arrays(function: Function) -> Function:
    """Compile a function like `long_kernel` that creates arrays, of which each thread needs its own."""
    return _compiled(function, nogil=True)


def inner(function: Function) -> Function:
    """Compile a function that only kernels call, without the wrapper that Python needs.

    With many array arguments, that wrapper takes most of the compilation. A call from Python would crash.

    The function neither creates nor stores arrays, so references to arrays are not counted. The counts are atomic: in a
    short function that passes on the arrays of a tuple, they take most of the time. The kernels that the function calls
    must not create arrays either: if they are not yet compiled, Numba also compiles them without counts.
    """
    return _compiled(function, no_cpython_wrapper=True, _nrt=False)


def inline(function: Function) -> Function:
    """Inline a small function into the kernels that call it."""
    return _compiled(function, nogil=True, inline="always")


class QuickFlags(compiler.Flags):  # type: ignore[misc] # untyped, like all of Numba's inside
    """Options of a compilation that can be compared quickly.

    Numba compares options whenever a kernel calls one of Numba's own functions, such as ``max``, and looks up each of
    some 40 options by its name. Without this class, compilations and first runs take 1.2 times as long.
    """

    __slots__ = ()

    def values(self) -> dict[str, Any]:
        """Return the value of each option."""
        values: dict[str, Any] = _DEFAULTS | self._values
        return values

    def __hash__(self) -> int:
        return _HASH


_DEFAULTS: dict[str, Any] = compiler.Flags().values()
_HASH = 0 if PLAIN else hash(compiler.Flags())  # all options of Numba have the same hash, whatever their values are


def _compiled(function: Function, **options: Any) -> Function:
    """Compile a function for calls from Python and kernels, not from C, and only once for all literal arguments."""
    compile_as: Any = numba.njit  # the stub of `njit` lacks some options
    if PLAIN:
        documented = {name: value for name, value in options.items() if name in ("nogil", "inline")}
        compiled = compile_as(error_model="numpy", **documented)(function)
    else:
        compiled = compile_as(error_model="numpy", no_cfunc_wrapper=True, **options)(function)
        compiled._compiler._customize_flags = QuickFlags  # Numba's hook for changes of the options
    kept = cache_of(function)
    if kept is not None:
        compiled._cache = kept
    if not hasattr(compiled, "get_call_template"):
        return cast("Function", compiled)
    template_for = compiled.get_call_template

    def get_call_template(args: Sequence[Any], kws: dict[str, Any]) -> Any:
        """Return a called kernel, compiled at most once; Numba would compile it again for each literal argument."""
        unliteral: Any = types.unliteral
        return template_for([unliteral(arg) for arg in args], kws)

    compiled.get_call_template = get_call_template
    return cast("Function", compiled)


def entry_of(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """Compile a kernel for the types of these arguments, or load it; return it as a function of such arguments only.

    Numba looks up the types of all arguments at each call: 3 to 5 µs for a tuple of 25 arrays. A call of the returned
    function takes 0.5 µs, or 2 µs if it counts references. The returned function misreads arguments of other types. It
    may therefore be used only for arrays whose types are fixed by the owner of the function. Without this shortcut, a
    step of few spheres at rest takes 1.3 times as long. In the plain form, the kernel itself is returned.
    """
    if PLAIN:
        return function
    asked = function, layout_of(arguments)
    if asked not in _entries:
        kernel: Any = function
        kinds = tuple(map(_typeof, arguments))
        kernel.compile(kinds)
        _entries[asked] = kernel.overloads[kinds].entry_point
    return _entries[asked]


def entry_if_worthwhile(function: Callable[..., Any], calls: float, *arguments: Any) -> Callable[..., Any] | None:
    """Return `entry_of` a kernel that replaces others in many calls; None if compilation takes more time than it saves.

    The decision depends on numbers of calls, never on a clock, and must not change bits.
    """
    if not _compiles_all and calls < (WORTH_LOADING if is_compiled(function, *arguments) else WORTH_COMPILING):
        return None
    return entry_of(function, *arguments)


@contextmanager
def compiling_all() -> Iterator[None]:
    """Compile or load even kernels that are not worthwhile."""
    global _compiles_all  # noqa: PLW0603 - a choice for the process, like its kernels
    before, _compiles_all = _compiles_all, True
    try:
        yield
    finally:
        _compiles_all = before


def compiles_all() -> bool:
    """Return whether even kernels that are not worthwhile are compiled."""
    return _compiles_all


def is_compiled(function: Callable[..., Any], *arguments: Any) -> bool:
    """Return whether a kernel is compiled for the types of these arguments, in this process or in the cache."""
    compiled: Any = function
    kinds, kept = tuple(map(_typeof, arguments)), compiled._cache
    return kinds in compiled.overloads or (isinstance(kept, KernelCache) and kept.has(kinds, compiled.targetctx))


def layout_of(argument: Any) -> Any:
    """Return the properties of an argument that determine its Numba type, in 1 % of the time of `numba.typeof`."""
    if isinstance(argument, np.ndarray):
        return argument.dtype, argument.ndim, argument.flags.num & ~_OWNS
    if isinstance(argument, tuple):
        return type(argument), *map(layout_of, argument)
    return type(argument)


def cache_folder() -> str:
    """Return the folder of the compiled kernels of this package; empty if none is writable."""
    return str(folder_of(Path(__file__).parents[1]) or "")


class Compilations(event.Listener):  # type: ignore[misc] # untyped, like all of Numba's inside
    """Counts the kernels that are compiled while it is active, without those loaded from the cache."""

    def __init__(self, at_first: Callable[[], None] = lambda: None) -> None:
        self.count = 0
        self._at_first = at_first

    def __enter__(self) -> Compilations:
        event.register("numba:compile", self)
        return self

    def __exit__(self, *error: object) -> None:
        event.unregister("numba:compile", self)

    def on_start(self, event: object) -> None:
        """Count a compilation, and call back at the first."""
        self.count += 1
        if self.count == 1:
            self._at_first()

    def on_end(self, event: object) -> None:
        """Do nothing; Numba requires this method."""


def on_compilation(callback: Callable[[], None]) -> None:
    """Call back once, before the first kernel is compiled; never if all are loaded from the cache."""
    event.register("numba:compile", Compilations(callback))


def chosen_by_type(stub: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Let kernels that call ``stub`` compile the code that the decorated function returns for the argument types."""
    overload: Any = extending.overload
    decorated: Callable[[Callable[..., Any]], Callable[..., Any]] = overload(
        stub, jit_options={"error_model": "numpy"}, strict=False
    )
    return decorated


def for_first(function: Callable[..., Any], is_meant: Callable[[Any], bool]) -> Callable[[Function], Function]:
    """Let kernels that call a function call the decorated function if ``is_meant`` accepts the first argument's type.

    The decorated function may be the called function itself.
    """

    def decorated(form: Function) -> Function:
        chosen_by_type(function)(lambda kind, *others: form if is_meant(kind) else None)
        return form

    return decorated


def with_field(name: str, chosen: Callable[..., Any], place: int = 0) -> Callable[[Function], Function]:
    """Let kernels call ``chosen`` in place of the decorated function if records have a field.

    Parameters
    ----------
    name
        The name of the field.
    chosen
        The function to call, with the arguments of the decorated function.
    place
        Index of the argument that is the record, or the array of records.
    """

    def decorated(function: Function) -> Function:
        @chosen_by_type(function)
        def by_field(*arguments: Any) -> Any:
            kind = arguments[place]
            fields = getattr(getattr(kind, "dtype", kind), "fields", None) or ()
            return chosen if name in fields else function

        return function

    return decorated


def identity_of(*functions: Callable[..., Any]) -> str:
    """Return a text that changes with the sources of functions, for use in the name of a type.

    A function within another function, or a function whose sources cannot be read, depends on more than its text. The
    text then contains the address of the function, so that `KernelCache` stores no kernel that uses the function.
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
