"""How kernels are compiled: strict IEEE arithmetic, cached on disk, without the interpreter's lock.

No ``fastmath``: reassociated or fused arithmetic would make the bits depend on the processor.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

PACKAGE = Path(__file__).parent


def _writable_cache() -> None:
    """Give Numba a folder to cache in where it would find none: it raises at import otherwise."""
    if "NUMBA_CACHE_DIR" in os.environ or os.access(PACKAGE, os.W_OK):
        return
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    nearest = next(folder for folder in (home, *home.parents) if folder.exists())
    if not os.access(nearest, os.W_OK):
        user = os.getuid() if hasattr(os, "getuid") else "any"
        os.environ["NUMBA_CACHE_DIR"] = str(Path(tempfile.gettempdir()) / f"carom-numba-{user}")


_writable_cache()

import numba  # noqa: E402 - reads NUMBA_CACHE_DIR when it is imported

Function = TypeVar("Function", bound=Callable[..., Any])

_kernels: list[Any] = []


def kernel(function: Function) -> Function:
    """Compile a function on its first call, or take it from the cache."""
    compiled: Any = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    _kernels.append(compiled)
    return compiled  # type: ignore[no-any-return]


def inline(function: Function) -> Function:
    """Compile a small function into the kernels that call it."""
    return numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")(function)  # type: ignore[no-any-return]


def in_cache() -> bool:
    """Tell whether the kernels were compiled on this machine before, so that a first run can say that it compiles."""
    return all(_has_index(compiled) for compiled in _kernels)


def _has_index(compiled: Any) -> bool:
    stem = f"{compiled.py_func.__module__.rsplit('.', 1)[-1]}.{compiled.py_func.__qualname__}-"
    folder = Path(compiled.stats.cache_path)
    return folder.is_dir() and any(file.name.startswith(stem) for file in folder.glob("*.nbi"))
