"""The environment of a run: versions, machine, command."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import shlex
import sys
from functools import cache
from pathlib import Path

from carom.runs.revision import git_revision

PACKAGES = ("carom", "rerun-sdk", "numpy", "scipy", "numba")
_ABSOLUTE = re.compile(r"^([\w.-]+=)?/(?:.*/)?")  # a path, or an option or a key with one


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a result depends on."""
    return {"python": platform.python_version(), **{package: _version(package) for package in PACKAGES}}


def environment(threads: int) -> dict[str, str | int]:
    """Return the properties of a recording about its origin."""
    stamped: dict[str, str | int] = {f"version.{package}": version for package, version in versions().items()}
    stamped["command"] = command_line()
    stamped["git"] = _revision()
    stamped["platform"] = platform.platform()
    stamped["cpu"] = _cpu()
    stamped["threads"] = threads
    return stamped


def command_line() -> str:
    """Return the command line without the folders of absolute paths, since recordings are shared."""
    program = Path(sys.argv[0])
    name = "carom" if program.name == "__main__.py" and program.parent.name == "carom" else program.name
    return shlex.join([name, *(_ABSOLUTE.sub(r"\1", word) for word in sys.argv[1:])])


@cache
def _version(package: str) -> str:
    """Return the installed versions, cached: a lookup takes a millisecond or two, and sweeps repeat it every run."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


@cache
def _revision() -> str:
    """Return the commit of the working folder at the first call, cached because a sweep needs it for every run."""
    return git_revision(Path.cwd())


@cache
def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
