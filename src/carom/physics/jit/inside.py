"""The parts of Numba and llvmlite that are not documented for users; no other module imports them.

`PLAIN` is true if kernels must do without them: with ``CAROM_PLAIN=1`` in the environment, or if the installed Numba
lacks one of these parts. Plain kernels give the same bits and use only what Numba documents. One thread does all the
work, one contact and one body at a time. Use plain kernels to find out whether a fault is in the code of this package,
and to debug the phases of the contact solver step by step, since plain Python then calls them.

`tests/physics/jit/test_numba.py` tries each part, and `tests/physics/jit/test_plain.py` compares the bits.
"""

from __future__ import annotations

import os
import warnings
from importlib import import_module
from typing import Any

import numba

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


def _module(name: str, *members: str) -> Any:
    """Return a module, or `Absent` if it is missing or lacks one of these members."""
    try:
        module = import_module(name)
    except ImportError:
        MISSING.append(name)
        return Absent()
    missing = [f"{name}.{member}" for member in members if not hasattr(module, member)]
    MISSING.extend(missing)
    return Absent() if missing else module


ir = _module("llvmlite.ir", "Constant", "Function", "FunctionType", "IRBuilder", "LiteralStructType", "VectorType")
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
types: Any = numba.types  # documented, but without type hints

# llvmlite calls Numba back at the start and end of each of its own calls, 86 000 times in a first run, to time how long
# they hold a lock. Nothing listens to these times. Without them, compilations and the loading of kernels take 0.95 of
# the CPU time.
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
