"""Compiled kernels on disk: verified before they are used, in folders that nobody else can write to.

With them, a run starts within a second instead of after 20 to 60 s of compilation. Without a folder, or if the
installed Numba lacks a required part, each process compiles the kernels again.

Numba's own cache unpickles and links any file in its folder, and identifies a kernel by its source file. Here each file
begins with a checksum of its content, of the kernel and its argument types, and of all sources that the kernel may
depend on. Damaged, exchanged or outdated files are ignored and the kernel is compiled again. There is one file for each
kernel and its argument types, and no index that two processes could write at once. A process that compiles a kernel
claims it, so that others wait for the result, and removes files of the kernel that belong to other sources or versions.

A wheel may carry kernels for all processors of the level `BASELINE` (``.ci/wheel`` makes such a wheel). These kernels
lie beside the sources, are verified like all others, and give the same bits as kernels compiled for this processor.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import re
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
import xxhash

from carom.held_signals import signals_held
from carom.physics.jit.inside import MISSING, PLAIN, compiler, config, serialize
from carom.private_folder import is_own

# bytes of each checksum at the start of a file: a checksum of everything, and a checksum of the sources alone
CHECKSUM = 16
CLAIMS = "claims.lock"  # name of a file in each folder; one of its bytes is locked while a kernel is compiled
PATIENCE = 120.0  # s, longest wait for another process, which usually takes a few seconds
POLL = 0.02  # s, between two checks of a claim
# The sources that kernels of carom are compiled from. Other modules affect a kernel only through its arguments and
# their types. If imports of the scene package counted, a changed message there would outdate all kernels.
SOURCES = (
    *("physics/", "scene/forces.py", "scene/portable_math.py", "scene/rest_speed.py", "contact_table.py", "arrays.py"),
    *("extend.py", "walls/"),
)
_FROM = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+([^\n#]+)", re.MULTILINE)
# The x86-64-v3 level of the psABI for x86-64 (https://gitlab.com/x86-psABIs/x86-64-ABI), by LLVM's names: Intel since
# 2013, AMD since 2015. The next lower level has no AVX2, which kernels of eight contacts are compiled with.
BASELINE = "x86-64-v3"
_BASELINE_FEATURES = (
    *("cx16", "popcnt", "sahf", "sse3", "ssse3", "sse4.1", "sse4.2"),
    *("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"),
)
_VERSIONS = (numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:3], PLAIN)


def cache_of(function: Callable[..., Any]) -> KernelCache | None:
    """Return the cache of a kernel; None if there is no folder for it, or its sources cannot be read.

    A closure has no cache either, since it depends on more than its sources: for instance, on the arguments of the
    outer function.
    """
    if MISSING or function.__closure__:
        return None
    file = Path(function.__code__.co_filename)
    folder = folder_of(file.parent)
    if folder is None:
        return None
    try:
        return KernelCache(function, folder, file.parent / "__pycache__", sources_of(function.__module__, file))
    except (OSError, UnicodeDecodeError):
        return None


@cache
def folder_of(package: Path) -> Path | None:
    """Return the folder for the compiled kernels of a package; None if no folder is writable.

    The folder is the first writable one: below ``NUMBA_CACHE_DIR``; beside the sources, with their byte code; in the
    user's cache; in the system's temporary folder. Except for the folder beside the sources, a folder must belong to
    the user, and nobody else may have write access.
    """
    name = f"{package.name}-{xxhash.xxh3_64_hexdigest(str(package).encode())}"
    chosen = config.CACHE_DIR
    if chosen and _is_own(given := Path(chosen).resolve()) and _is_own(given / name):
        return given / name
    if _is_writable(beside := package / "__pycache__"):
        return beside
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - no error without a home
    for base, own in ((home, "carom-kernels"), (tempfile.gettempdir(), f"carom-kernels-{os.getuid()}")):
        root = Path(base).resolve() / own
        if Path(base).is_absolute() and _is_own(root) and not root.stat().st_mode & 0o077 and _is_writable(root / name):
            return root / name
    return None


def _is_writable(folder: Path) -> bool:
    """Create a folder if it does not exist; return whether it is writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _is_own(folder: Path) -> bool:
    """Create a folder if it does not exist; return whether it belongs to this user, and nobody else can write to it."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError:
        return False
    return is_own(folder) and os.access(folder, os.W_OK | os.X_OK)


class KernelCache:
    """The compiled forms of one kernel, which replace Numba's own cache."""

    def __init__(self, function: Callable[..., Any], folder: Path, shipped: Path, sources: bytes) -> None:
        code = function.__code__
        version = sys.implementation.cache_tag + (".plain" if PLAIN else "")
        self._folder, self._shipped, self._version = folder, shipped, version
        self._kernel = f"{Path(code.co_filename).stem}.{function.__qualname__}"
        self._name = f"{self._kernel}-{code.co_firstlineno}.{version}"
        made_of = repr((function.__module__, function.__qualname__, _VERSIONS)).encode() + sources
        self._made_of = xxhash.xxh3_128_digest(made_of)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature, or None if there is no valid file."""
        with signals_held():
            target_context.refresh()  # imports parts of Numba at the first call
        codegen = target_context.codegen()
        types = _types(sig, codegen)
        path = self._path(types)
        data = self._find(types, sig, codegen)
        if data is None and _claim(path):  # another process may have compiled the kernel meanwhile
            data = self._find(types, sig, codegen)
            if data is not None:
                _release(path)
        if data is None:
            return None
        with signals_held():
            try:
                content = pickle.loads(data)
            # a class named in the data was moved, for instance by an upgrade of a library
            except (ImportError, AttributeError):
                return None
            return compiler.CompileResult._rebuild(target_context, *content)

    def has(self, sig: Any, target_context: Any) -> bool:
        """Return whether there is a valid file for a signature."""
        codegen = target_context.codegen()
        return self._find(_types(sig, codegen), sig, codegen) is not None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the code for a signature; if that fails, the kernel is compiled again next time."""
        types = _types(sig, data.codegen)
        try:
            self._write(types, data)
        finally:
            _release(self._path(types))

    def _find(self, types: bytes, sig: Any, codegen: Any) -> memoryview | None:
        """Return the content of a valid file for a signature and its key ``types``.

        The file was compiled on this machine, or is part of the package.
        """
        data = self._read(self._path(types), types)
        if data is None and _is_baseline_met():
            types = _types(sig, codegen, BASELINE)
            data = self._read(self._shipped / self._path(types).name, types)
        return data

    def _read(self, path: Path, types: bytes) -> memoryview | None:
        """Return the content of a file for some types; None if it does not exist or is not valid."""
        try:
            content = path.read_bytes()
        except OSError:
            return None
        data = memoryview(content)[2 * CHECKSUM :]
        return data if content[:CHECKSUM] == self._checksum(types, data) else None

    def _write(self, types: bytes, data: Any) -> None:
        # such code is useful to this process only
        if data.library.has_dynamic_globals or data.lifted or b" at 0x" in types:
            return
        content: bytes = serialize.dumps(data._reduce())
        path = self._path(types)
        begun = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
        try:
            begun.write_bytes(self._checksum(types, memoryview(content)) + self._made_of + content)
            begun.replace(path)
            self._remove_outdated()
        except OSError:
            with contextlib.suppress(OSError):
                begun.unlink(missing_ok=True)

    def _remove_outdated(self) -> None:
        """Remove the files of this kernel that were compiled from other sources, such as earlier versions."""
        names = re.compile(rf"{re.escape(self._kernel)}-\d+\.{re.escape(self._version)}\.[0-9a-f]{{16}}\.nbc")
        for path in self._folder.iterdir():
            if names.fullmatch(path.name):
                with path.open("rb") as file:
                    made_of = file.read(2 * CHECKSUM)[CHECKSUM:]
                if made_of != self._made_of:
                    path.unlink(missing_ok=True)

    def _path(self, types: bytes) -> Path:
        return self._folder / f"{self._name}.{xxhash.xxh3_64_hexdigest(types)}.nbc"

    def _checksum(self, types: bytes, data: memoryview) -> bytes:
        whole = xxhash.xxh3_128()
        for part in (self._made_of, types, data):
            whole.update(len(part).to_bytes(8, "little"))
            whole.update(part)
        return whole.digest()


@cache
def _claims(folder: Path) -> int | None:
    """Open the file of claims in a folder, only once, since closing it would release all claims of this process."""
    try:
        return os.open(folder / CLAIMS, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError:
        return None


def _byte_of(path: Path) -> int:
    return xxhash.xxh3_64_intdigest(path.name.encode()) >> 2  # a number within the range of offsets in a file


def _claim(path: Path) -> bool:
    """Claim a kernel, and wait while another process has the claim; return whether this process has it now.

    The claims of a process end with it. Processes cannot wait for each other in a circle: a process holds claims only
    on kernels that call, directly or indirectly, the kernel for which it waits.
    """
    claims = _claims(path.parent)
    if claims is None:
        return False
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            fcntl.lockf(claims, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _byte_of(path))
        except BlockingIOError:
            time.sleep(POLL)
        except OSError:  # the file system has no locks
            return False
        else:
            return True
    return False


def _release(path: Path) -> None:
    claims = _claims(path.parent)
    if claims is not None:
        with contextlib.suppress(OSError):
            fcntl.lockf(claims, fcntl.LOCK_UN, 1, _byte_of(path))


@cache
def _is_baseline_met() -> bool:
    """Return whether kernels for the baseline may run here: False if the user has chosen a processor."""
    chosen = config.CPU_NAME is not None or config.CPU_FEATURES is not None
    has = {} if chosen else llvmlite.binding.get_host_cpu_features()
    return all(has.get(feature, False) for feature in _BASELINE_FEATURES)


def _types(sig: Any, codegen: Any, processor: str = "") -> bytes:
    """Return a key for the types of a kernel's arguments and the processor, by default this one.

    Numba names a named tuple by its class alone. The key therefore contains the module and the fields: compiled code
    reads fields by number, and the module that defines the class need not be among the kernel's sources.
    """
    kinds = getattr(sig, "args", sig)
    target = (codegen.magic_tuple()[0], processor, "") if processor else codegen.magic_tuple()
    return repr((sig, target, *(named for kind in kinds for named in _named_tuples(kind)))).encode()


def _named_tuples(kind: Any) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return module, class and fields of the named tuples in a type."""
    kind = getattr(kind, "of", kind)  # a tuple may be passed by address
    if not isinstance(kind, numba.types.BaseTuple):
        return []
    made_by = getattr(kind, "instance_class", None)
    own = [] if made_by is None else [(made_by.__module__, made_by.__qualname__, tuple(made_by._fields))]
    members: Any = kind  # iteration yields the types of its members
    return own + [named for member in members for named in _named_tuples(member)]


@cache
def sources_of(module: str, file: Path) -> bytes:
    """Return a checksum of a module and of its imports, direct or indirect, from its package and `SOURCES`.

    Raises
    ------
    OSError
        If a file cannot be read, for example in a zip.
    """
    known = {str(file)}
    unread = [file]
    while unread:
        for imported in imports_of(unread.pop(), module.partition(".")[0]):
            if str(imported) not in known and _may_be_compiled(imported):
                known.add(str(imported))
                unread.append(imported)
    whole = xxhash.xxh3_128()
    for path in sorted(known):
        whole.update(Path(path).name.encode())
        whole.update(_checksum(Path(path)))
    return whole.digest()


@cache
def _may_be_compiled(file: Path) -> bool:
    """Return whether a file belongs to `SOURCES`, or to a package other than carom."""
    root = Path(__file__).parents[2]
    return root not in file.parents or file.relative_to(root).as_posix().startswith(SOURCES)


@cache
def imports_of(file: Path, package: str) -> tuple[Path, ...]:
    """Return the files of a package and of carom that a file may import.

    ``from carom import registry`` counts as an import of that module only, since `carom` itself imports nearly
    everything.
    """
    text, among = _text(file), (package, "carom")
    files = {_file_of(name, among) for line in _IMPORT.findall(text) for name in re.findall(r"[\w.]+", line)}
    for name, members in _FROM.findall(text):
        modules = [_file_of(f"{name}.{member}", among) for member in re.findall(r"\w+", members)]
        files.update(modules if all(modules) else [_file_of(name, among), *modules])
    return tuple(sorted(path for path in files if path is not None))


@cache
def _file_of(module: str, packages: tuple[str, ...]) -> Path | None:
    package, *below = module.split(".")
    start = getattr(sys.modules.get(package), "__file__", None) if package in packages else None
    if start is None or Path(start).name != "__init__.py":
        return None
    path = Path(start).parent.joinpath(*below)
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@cache
def _checksum(file: Path) -> bytes:
    return xxhash.xxh3_128_digest(_text(file).encode())


@cache
def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")
