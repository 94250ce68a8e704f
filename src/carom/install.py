"""Commands that install missing packages: those of an extra, and those of the system."""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from carom.errors import ExperimentError

_EXTRA = re.compile(r"""extra\s*==\s*["']([\w-]+)["']""")


def install_extra(extra: str) -> str:
    """Return the command that installs the packages of an extra into the environment of this process.

    It lists the packages themselves, because carom may have been installed from a folder or an archive.
    """
    wanted = [package for package, name in map(_parsed, importlib.metadata.requires("carom") or ()) if name == extra]
    packages = shlex.join(wanted or [f"carom[{extra}]"])
    if "pipx" in Path(sys.prefix).parts:
        return f"pipx inject carom {packages}"
    if importlib.util.find_spec("pip") is None:
        return f"uv pip install --python {shlex.quote(sys.executable)} {packages}"
    pip = shutil.which("pip")
    if pip is not None and Path(pip).parent == Path(sys.executable).parent:
        return f"pip install {packages}"
    return f"{shlex.quote(sys.executable)} -m pip install {packages}"


def _parsed(requirement: str) -> tuple[str, str]:
    """Split a requirement into the package and the extra that it belongs to."""
    package, _, marker = requirement.partition(";")
    extra = _EXTRA.search(marker)
    return package.strip(), extra[1] if extra else ""


def install_packages(debian: str, fedora: str) -> str:
    """Return the command that installs packages of the system, by their names in two families of distributions."""
    if shutil.which("apt-get"):
        return f"apt-get install {debian}"
    if shutil.which("dnf"):
        return f"dnf install {fedora}"
    return f"install {debian} (Debian's names) or {fedora} (Fedora's)"


@contextlib.contextmanager
def needing(extra: str, command: str, *packages: str) -> Iterator[None]:
    """Import packages of an extra within this context; raise ExperimentError with the remedy if one is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in packages:
            raise
        raise ExperimentError(f"{command} needs {packages[0]}: {install_extra(extra)}") from None
