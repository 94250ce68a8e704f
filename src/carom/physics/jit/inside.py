"""The parts of Numba and llvmlite that are not documented for users; no other module imports them.

`PLAIN` is true if kernels must do without these parts: with ``CAROM_PLAIN=1`` in the environment, or if the installed
Numba lacks one of these parts. Plain kernels give the same bits and use only documented features of Numba. One thread
does all the work, one contact and one body at a time. Use plain kernels to find out whether a fault is in the code of
this package, and to debug the phases of the contact solver step by step, since plain Python then calls the phases.

`tests/physics/jit/test_numba.py` tries each part, and `tests/physics/jit/test_plain.py` compares the bits.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import warnings
from importlib import import_module
from typing import Any

import numba
import xxhash

from carom.held_signals import signals_held

MISSING: list[str] = []  # parts that the installed Numba lacks


class Absent:
    """Stands for a missing part, so that modules which use it can be imported."""

    def __getattr__(self, name: str) -> Absent:
        if name.startswith("__"):
            raise AttributeError(name)
        return self

    def __call__(self, *arguments: object, **options: object) -> Absent:  # noqa: D102 - as what it stands for
        return self

    def __mul__(self, other: object) -> Absent:
        return self

    __rmul__ = __mul__

    def __mro_entries__(self, bases: tuple[object, ...]) -> tuple[()]:
        return ()


def _has(module: Any, member: str) -> bool:
    """Return whether a module has a member, or a member of a member."""
    first, _, below = member.partition(".")
    return hasattr(module, first) and (not below or _has(getattr(module, first), below))


def _module(name: str, *members: str) -> Any:
    """Return a module, or `Absent` if it is missing or lacks one of these members."""
    try:
        module = import_module(name)
    except ImportError:
        MISSING.append(name)
        return Absent()
    missing = [f"{name}.{member}" for member in members if not _has(module, member)]
    MISSING.extend(missing)
    return Absent() if missing else module


# Numba loads the extensions of all packages once, at the first call of a kernel. The call fails if the metadata of any
# package is damaged, or if an extension calls `sys.exit`.
with signals_held(), contextlib.suppress(BaseException):
    import_module("numba.core.entrypoints").init_all()

ir = _module("llvmlite.ir", "Constant", "Function", "FunctionType", "IRBuilder", "LiteralStructType", "VectorType")
bytecode = _module("numba.core.bytecode", "FunctionIdentity._unique_ids")
callconv = _module("numba.core.callconv", "errcode_t", "excinfo_ptr_t")
cgutils = _module(
    "numba.core.cgutils",
    *("alloca_once", "alloca_once_value", "for_range_slice", "gep_inbounds", "get_item_pointer", "unpack_tuple"),
)
compiler = _module("numba.core.compiler", "CompileResult", "Flags")
config = _module("numba.core.config", "CACHE_DIR")
event = _module("numba.core.event", "Listener", "register", "unregister")
extending = _module("numba.extending", "intrinsic", "lower_getattr_generic", "models", "overload", "register_model")
imputils = _module("numba.core.imputils", "impl_ret_borrowed")
serialize = _module("numba.core.serialize", "dumps")
templates = _module("numba.core.typing.templates", "AttributeTemplate", "infer_getattr")
npytypes = _module("numba.core.types.npytypes", "Record.mangling_args")
types: Any = numba.types  # documented, but without type hints

# Symbols of compiled functions must differ wherever the functions differ. A process may load kernels that several other
# processes compiled, and silently links a symbol to the first function with that name. Numba numbers record layouts and
# functions in the order in which a process meets them. Two processes may therefore give the same name to functions for
# two layouts, or to two functions made by one factory. Here a name contains a digest of the layout, and each process,
# forked ones included, numbers functions from a random start.
RANDOM_BYTES = 8  # bytes of the first number: 10⁵ processes of 10⁴ functions each overlap with a probability of 10⁻⁵


def _name_of_layout(record: Any) -> tuple[str, tuple[str, ...]]:
    """Return the text that identifies a record type in a symbol, instead of Numba's counter."""
    return type(record).__name__, (layout_digest(record),)


def layout_digest(record: Any) -> str:
    """Return a digest of the fields of a record type: their names, types, offsets, and the size."""
    return xxhash.xxh3_128_hexdigest(record.name.encode())


def _number_functions() -> None:
    """Start the numbering of functions in this process at a number that no other process uses."""
    bytecode.FunctionIdentity._unique_ids = itertools.count(int.from_bytes(os.urandom(RANDOM_BYTES), "little"))


npytypes.Record.mangling_args = property(_name_of_layout)
_number_functions()
os.register_at_fork(after_in_child=_number_functions)

# At the start and end of each of its calls, llvmlite calls Numba back to time how long it holds a lock: 86 000 times in
# a first run. Nobody uses these times. Without these calls, compiling and loading kernels takes 5 % less CPU time.
_lock: Any = getattr(getattr(import_module("llvmlite.binding.ffi"), "lib", None), "_lock", None)
for _callbacks in list(getattr(_lock, "_cblist", ())):
    if all(callback.__module__ == "numba.core.base" for callback in _callbacks):
        _lock.unregister(*_callbacks)

PLAIN = bool(MISSING) or os.environ.get("CAROM_PLAIN", "0") not in ("", "0")

if MISSING:
    warnings.warn(
        f"numba {numba.__version__} lacks {', '.join(MISSING)}, so carom uses plain kernels: the results are the "
        "same, but they run on one thread, are slower, and are compiled again in each process",
        RuntimeWarning,
        stacklevel=2,
    )
