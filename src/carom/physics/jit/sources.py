"""The sources of a kernel: its file, and all files of carom and its package that it imports."""

from __future__ import annotations

import re
import sys
from functools import cache
from pathlib import Path

import xxhash

_FROM = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+([^\n#]+)", re.MULTILINE)
_CAROM = "carom"


@cache
def sources_of(module: str, file: Path) -> bytes:
    """Return a checksum of a module and of all that it imports, directly or not, from its package and carom.

    Raises
    ------
    OSError
        If a file cannot be read, as in a zip.
    """
    known = {str(file)}
    unread = [file]
    while unread:
        for imported in imports_of(unread.pop(), module.partition(".")[0]):
            if str(imported) not in known:
                known.add(str(imported))
                unread.append(imported)
    whole = xxhash.xxh3_128()
    for path in sorted(known):
        whole.update(Path(path).name.encode())
        whole.update(_checksum(Path(path)))
    return whole.digest()


@cache
def imports_of(file: Path, package: str) -> tuple[Path, ...]:
    """Return the files of a package and of carom that a file imports; too many do no harm."""
    text = _text(file)
    names = [name for line in _IMPORT.findall(text) for name in re.findall(r"[\w.]+", line)]
    for name, members in _FROM.findall(text):
        names += [name, *(f"{name}.{member}" for member in re.findall(r"\w+", members))]
    found = {_file_of(name) for name in names if name.partition(".")[0] in (package, _CAROM)}
    return tuple(sorted(path for path in found if path is not None))


@cache
def _file_of(module: str) -> Path | None:
    package, *below = module.split(".")
    start = getattr(sys.modules.get(package), "__file__", None)
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
